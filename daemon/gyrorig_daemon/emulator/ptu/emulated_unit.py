"""Emulated unit on its line: characters in, replies out, each at its own time.

Theory of operation. A received character is echoed when it arrives. A delimiter (space, CR, LF)
ends a command; the controller executes one command at a time. A command starts when its delimiter
has arrived and the one before has been answered. It acts (the count is read, a move starts) after
`sample_fraction` of the command time, and its reply starts to leave after the whole command time,
or later if it waits for a move or a table. All of this is known when the character arrives, so
that everything is computed at once and sent when it is due.
"""

import re

import numpy as np

from gyrorig_daemon.emulator.emulated_line import ReceiveLine, TransmitQueue, byte_ns
from gyrorig_daemon.emulator.emulator_settings import PtuSettings
from gyrorig_daemon.emulator.physics.device_clock import DeviceClock
from gyrorig_daemon.emulator.physics.stage_motion import Stage
from gyrorig_daemon.emulator.ptu.axis_commands import ILLEGAL, Reply
from gyrorig_daemon.emulator.ptu.unit_answers import VERSIONS
from gyrorig_daemon.emulator.ptu.unit_commands import run_command, run_homing
from gyrorig_daemon.emulator.ptu.unit_controller import UnitController, make_axis_state

_DELIMITERS = b" \r\n"
_MAX_COMMAND_BYTES = 100  # what a unit buffers
_SELECT = re.compile(r"_(\d{1,3})")


class EmulatedPtu:
    """A pan-tilt unit; see `emulated_rig.EmulatedDevice`."""

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
        self._receive_line = ReceiveLine(settings.baud)
        self._transmit_queue = TransmitQueue(settings.baud)
        self.unit = UnitController(
            settings=settings,
            axes={
                "P": make_axis_state("P", settings, stage.pan),
                "T": make_axis_state("T", settings, stage.tilt),
            },
            clock=clock,
            origin_ns=origin_ns,
            transmit_queue=self._transmit_queue,
            echo=settings.echo,
            verbose=settings.verbose,
            unit_id=settings.unit_id,
            selected=settings.unit_id == 0,
        )
        for state in self.unit.axes.values():
            state.axis.law = state.law()
        self._origin_ns = origin_ns
        self._busy_until_ns = origin_ns
        self._input = bytearray()
        self._command_count = 0
        self._reply_count = 0
        self._power_up()
        if settings.faults.lose_steps_at_s is not None:
            stage.pan.shift(settings.faults.lose_steps_at_s, settings.faults.lost_steps)

    def receive(self, data: bytes, at_ns: int) -> None:
        """Accept bytes that arrive from `at_ns` on."""
        self._transmit_queue.advance(at_ns)
        for byte, arrived_ns in zip(
            data, self._receive_line.arrivals(len(data), at_ns), strict=True
        ):
            if self.unit.echo and self.unit.selected and not self.settings.faults.silent:
                self._transmit_queue.send(arrived_ns, bytes([byte]))
            if byte in _DELIMITERS:
                command, self._input = bytes(self._input), bytearray()
                if command:
                    self._handle_command(command, byte, arrived_ns)
            elif len(self._input) <= _MAX_COMMAND_BYTES:
                self._input.append(byte)

    def next_output_ns(self) -> int | None:
        """Return when the next bytes have left the line."""
        return self._transmit_queue.next_ns()

    def take_output(self, until_ns: int) -> list[tuple[int, bytes]]:
        """Return the bytes that have left the line up to a time."""
        return self._transmit_queue.take(until_ns)

    def _power_up(self) -> None:
        if self.settings.sweep_at_power_up:
            done_s = run_homing(self.unit, 0.0, ("T", "P"))
            self._busy_until_ns = self.unit.to_ns(done_s)
        if self.settings.banner:
            banner = f"\r\n### {VERSIONS[self.settings.dialect].upper()}\r\n*"
            self._transmit_queue.send(self._busy_until_ns, banner.encode())

    def _handle_command(self, command: bytes, delimiter: int, arrived_ns: int) -> None:
        self._command_count += 1
        command_ns = round(self.settings.command_time_ms * 1e6)
        start_ns = max(arrived_ns, self._busy_until_ns)
        act_ns = start_ns + round(command_ns * self.settings.sample_fraction)
        text = command.decode("ascii", errors="replace").upper()
        select = _SELECT.fullmatch(text)
        if select is not None:
            self._select(int(select[1]))
            answer: Reply | None = Reply() if self.unit.selected else None
        elif self.unit.selected or self.unit.broadcast:
            answer = self._run_command(text, (act_ns - self._origin_ns) * 1e-9)
        else:
            return
        ready_ns = start_ns + command_ns
        if answer is not None and answer.done_s is not None:
            # A waiting command is answered after its motion is done.
            ready_ns = max(
                ready_ns, self.unit.to_ns(answer.done_s) + command_ns - (act_ns - start_ns)
            )
        self._busy_until_ns = ready_ns
        if answer is not None and self.unit.selected:
            self._reply(answer, delimiter, ready_ns)
        if self.unit.new_baud is not None:
            self._change_baud(self.unit.new_baud, ready_ns)

    def _run_command(self, text: str, time_s: float) -> Reply:
        every = self.settings.faults.error_every
        if every and self._command_count % every == 0:
            return ILLEGAL
        if len(text) > _MAX_COMMAND_BYTES:
            return ILLEGAL
        return run_command(self.unit, text, time_s)

    def _select(self, number: int) -> None:
        self.unit.broadcast = number == 0
        self.unit.selected = number == self.unit.unit_id and number != 0

    def _reply(self, answer: Reply, delimiter: int, ready_ns: int) -> None:
        faults = self.settings.faults
        if faults.silent:
            return
        text = answer.verbose if self.unit.verbose or answer.terse is None else answer.terse
        mark = "*" if answer.ok else "!"
        data = f"{mark} {text}\r\n".encode() if text else f"{mark}\r\n".encode()
        if delimiter == ord("\r") and not self.unit.echo and self.settings.leading_lf_on_cr:
            data = b"\n" + data
        self._reply_count += 1
        if faults.lose_byte_every and self._reply_count % faults.lose_byte_every == 0:
            lost_index = int(self._rng.integers(len(data)))
            data = data[:lost_index] + data[lost_index + 1 :]
        if faults.garbage_every and self._reply_count % faults.garbage_every == 0:
            data = self._rng.integers(0, 256, 7, dtype=np.uint8).tobytes() + data
        self._transmit_queue.send(ready_ns, data, split_first=True)

    def _change_baud(self, baud: int, ready_ns: int) -> None:
        """Change the baud rate from the reply on; queued bytes leave at the old rate."""
        self.unit.new_baud = None
        old_end_ns = self._transmit_queue.change_speed(ready_ns, byte_ns(baud))
        self._receive_line.byte_ns = byte_ns(baud)
        self._busy_until_ns = max(self._busy_until_ns, old_end_ns)
