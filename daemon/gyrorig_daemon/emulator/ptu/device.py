"""The emulated unit on its line: characters in, replies out, each at its own time.

Theory of operation. A received character is echoed as it arrives. A delimiter (space, CR,
LF) ends a command; the controller takes commands one by one. A command begins when its
delimiter has arrived and the one before is answered; it acts (the count is taken, a move
starts) after `sample_fraction` of the command time, and its reply begins to leave after the
whole command time, or later where it waits for a move or a table. All of this is known
when the character arrives, so everything is worked out at once and sent when it is due.
"""

import re

import numpy as np

from gyrorig_daemon.emulator.line import InLine, Outbox, byte_ns
from gyrorig_daemon.emulator.physics.clock import DeviceClock
from gyrorig_daemon.emulator.physics.stage import Stage
from gyrorig_daemon.emulator.ptu.language import ILLEGAL, Answer
from gyrorig_daemon.emulator.ptu.unit import PtuUnit, make_axis_state
from gyrorig_daemon.emulator.ptu.unit_answers import VERSIONS
from gyrorig_daemon.emulator.ptu.unit_commands import run_command, run_homing
from gyrorig_daemon.emulator.settings import PtuSettings

_DELIMITERS = b" \r\n"
_MAX_COMMAND_BYTES = 100  # what a unit buffers
_SELECT = re.compile(r"_(\d{1,3})")


class EmulatedPtu:
    """A pan-tilt unit; see `device.EmulatedDevice`."""

    def __init__(
        self,
        settings: PtuSettings,
        stage: Stage,
        clock: DeviceClock,
        origin_ns: int,
        rng: np.random.Generator,
    ) -> None:
        """Power the unit up at `origin_ns`."""
        self.settings = settings
        self._rng = rng
        self._in = InLine(settings.baud)
        self._out = Outbox(settings.baud)
        self.unit = PtuUnit(
            settings=settings,
            axes={
                "P": make_axis_state("P", settings, stage.pan),
                "T": make_axis_state("T", settings, stage.tilt),
            },
            clock=clock,
            origin_ns=origin_ns,
            outbox=self._out,
            echo=settings.echo,
            verbose=settings.verbose,
            unit_id=settings.unit_id,
            selected=settings.unit_id == 0,
        )
        for state in self.unit.axes.values():
            state.axis.law = state.law()
        self._origin_ns = origin_ns
        self._busy_ns = origin_ns
        self._line = bytearray()
        self._commands = 0
        self._replies = 0
        self._power_up()
        if settings.faults.lose_steps_at_s is not None:
            stage.pan.shift(settings.faults.lose_steps_at_s, settings.faults.lost_steps)

    def receive(self, data: bytes, at_ns: int) -> None:
        """Take bytes whose first one begins to arrive at `at_ns`."""
        self._out.advance(at_ns)
        for byte, arrived_ns in zip(data, self._in.arrivals(len(data), at_ns), strict=True):
            if self.unit.echo and self.unit.selected and not self.settings.faults.silent:
                self._out.send(arrived_ns, bytes([byte]))
            if byte in _DELIMITERS:
                command, self._line = bytes(self._line), bytearray()
                if command:
                    self._command(command, byte, arrived_ns)
            elif len(self._line) <= _MAX_COMMAND_BYTES:
                self._line.append(byte)

    def next_output_ns(self) -> int | None:
        """Return when the next bytes will have left the line."""
        return self._out.next_ns()

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return what left the line up to a time."""
        return self._out.take(until_ns)

    def _power_up(self) -> None:
        if self.settings.sweep_at_power_up:
            done_s = run_homing(self.unit, 0.0, ("T", "P"))
            self._busy_ns = self.unit.to_ns(done_s)
        if self.settings.banner:
            banner = f"\r\n### {VERSIONS[self.settings.dialect].upper()}\r\n*"
            self._out.send(self._busy_ns, banner.encode())

    def _command(self, command: bytes, delimiter: int, arrived_ns: int) -> None:
        self._commands += 1
        command_ns = round(self.settings.command_time_ms * 1e6)
        begun_ns = max(arrived_ns, self._busy_ns)
        act_ns = begun_ns + round(command_ns * self.settings.sample_fraction)
        text = command.decode("ascii", errors="replace").upper()
        select = _SELECT.fullmatch(text)
        if select is not None:
            self._select(int(select[1]))
            answer: Answer | None = Answer() if self.unit.selected else None
        elif self.unit.selected or self.unit.broadcast:
            answer = self._run(text, (act_ns - self._origin_ns) * 1e-9)
        else:
            return
        ready_ns = begun_ns + command_ns
        if answer is not None and answer.done_s is not None:
            # What waits is looked at once a millisecond at best: answered after it is done.
            ready_ns = max(
                ready_ns, self.unit.to_ns(answer.done_s) + command_ns - (act_ns - begun_ns)
            )
        self._busy_ns = ready_ns
        if answer is not None and self.unit.selected:
            self._reply(answer, delimiter, ready_ns)
        if self.unit.new_baud is not None:
            self._change_baud(self.unit.new_baud, ready_ns)

    def _run(self, text: str, time_s: float) -> Answer:
        every = self.settings.faults.error_every
        if every and self._commands % every == 0:
            return ILLEGAL
        if len(text) > _MAX_COMMAND_BYTES:
            return ILLEGAL
        return run_command(self.unit, text, time_s)

    def _select(self, number: int) -> None:
        self.unit.broadcast = number == 0
        self.unit.selected = number == self.unit.unit_id and number != 0

    def _reply(self, answer: Answer, delimiter: int, ready_ns: int) -> None:
        faults = self.settings.faults
        if faults.silent:
            return
        text = answer.words if self.unit.verbose or answer.terse is None else answer.terse
        mark = "*" if answer.ok else "!"
        data = f"{mark} {text}\r\n".encode() if text else f"{mark}\r\n".encode()
        if delimiter == ord("\r") and not self.unit.echo and self.settings.leading_lf_on_cr:
            data = b"\n" + data
        self._replies += 1
        if faults.lose_byte_every and self._replies % faults.lose_byte_every == 0:
            lost = int(self._rng.integers(len(data)))
            data = data[:lost] + data[lost + 1 :]
        if faults.garbage_every and self._replies % faults.garbage_every == 0:
            data = self._rng.integers(0, 256, 7, dtype=np.uint8).tobytes() + data
        self._out.send(ready_ns, data, split_first=True)

    def _change_baud(self, baud: int, ready_ns: int) -> None:
        """From the reply on; what is queued still leaves at the old rate."""
        self.unit.new_baud = None
        old_end_ns = self._out.change_speed(ready_ns, byte_ns(baud))
        self._in.byte_ns = byte_ns(baud)
        self._busy_ns = max(self._busy_ns, old_end_ns)
