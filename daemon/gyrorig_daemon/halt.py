"""Bring a unit to rest with nothing but its port: what `gyrorigd halt` does.

What to use when: `halt_unit` after the program that moved the unit has died, or in its
place. It opens the port itself, needs no acquisition process, no recording and no sound
configuration, and imports little, so that it acts within a blink.

Theory of operation. The order to halt is the first thing that is sent, before anything is
known: whoever is on the port stops sooner, and no device is moved by it. Then, at each
rate in turn, the version is asked for; only a pan-tilt unit answers that. The order is
given again, in step this time, and the axes are asked until both say that they stand.
Every wait has an end, and all of them together have one: `PATIENCE_S`.
"""

import contextlib
import os
import select
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.links.serial_port import RefusedError, make_raw, open_port
from gyrorig_protocol.errors import BusyError, DeviceError, GyrorigError
from gyrorig_protocol.ptu import (
    Axis,
    FrameError,
    PtuCommand,
    PtuReplyParser,
    Quantity,
    Reading,
    Refusal,
    Reply,
    ValueFault,
    Version,
    read,
)
from gyrorig_protocol.ptu.commands import HALT, QUERY_VERSION, query
from gyrorig_protocol.ptu.dialect import Dialect, dialect_from_version, offers
from gyrorig_protocol.ptu.values import Done

# E series up to 115200, D series up to 38400; 9600 from the factory (manual v3.00D, clients)
USUAL_BAUDS = (9600, 19200, 38400, 57600, 115200)
PATIENCE_S = 7.0  # for everything; from 206 deg/s a unit needs 1.5 s to stand (defaults)
BUSY_S = 2.0  # a dying process closes its ports that late
FIRST_ANSWER_S = 0.8  # the slowest: 0.1 s a command, 0.1 s of text at 9600 baud
OTHER_ANSWER_S = 0.4
QUIET_S = 0.15  # so long without a byte, and what was under way is over (0.1 s a command)
DRAIN_S = 0.3  # a port that never falls silent is listened to no longer than this
ATTEMPTS = 3
ROUND_S = 0.1  # between two looks at the axes
STILL_ROUNDS = 3  # equal positions in a row, where speeds are not answered
HEARD_BYTES = 4096
_READ_BYTES = 4096


@dataclass(frozen=True, slots=True)
class Standing:
    """A unit that was told to halt and was seen to stand."""

    port: str
    baud: int
    pan_steps: int
    tilt_steps: int


def halt_unit(port: str, bauds: Sequence[int], patience_s: float = PATIENCE_S) -> Standing:
    """Halt both axes of the unit on `port` and see them stand.

    Args:
        port: the path of the serial port.
        bauds: rates to try, the likeliest first.
        patience_s: the longest time that all of it may take.

    Raises:
        BusyError: another program holds the port and does not let go.
        UsageError: there is no such port.
        MachineError: it may not be opened.
        DeviceError: nothing answers, what answers is no pan-tilt unit, or it still moves.
            The order was sent in each of these.
    """
    end_s = time.monotonic() + patience_s
    fd = _open(port, bauds[0], end_s)
    try:
        line = _Line(fd, port, end_s)
        baud = _find(line, bauds)
        _order(line)
        pan_steps, tilt_steps = _see_it_stand(line)
        return Standing(port, baud, pan_steps, tilt_steps)
    finally:
        with contextlib.suppress(termios.error):
            termios.tcflush(fd, termios.TCIOFLUSH)  # what nobody takes would delay the closing
        os.close(fd)


class _Line:
    """One exchange after another on an open port, each with an end."""

    def __init__(self, fd: int, port: str, end_s: float) -> None:
        self.fd, self.port, self.end_s = fd, port, end_s
        self.heard = bytearray()
        self.interval_s = 0.0
        self._parser = PtuReplyParser()

    def left_s(self) -> float:
        """Return how much patience is left."""
        return self.end_s - time.monotonic()

    def send(self, data: bytes) -> None:
        """Write what the port takes now.

        Raises:
            DeviceError: the port hung up.
        """
        try:
            os.write(self.fd, data)
        except BlockingIOError:
            return  # it takes nothing: the answer will be missing
        except OSError as fault:
            raise self._gone() from fault

    def receive(self, wait_s: float) -> bytes:
        """Return what came, nothing when nothing did.

        Raises:
            DeviceError: the port hung up.
        """
        ready, _, _ = select.select([self.fd], [], [], max(0.0, min(wait_s, self.left_s())))
        if not ready:
            return b""
        try:
            data = os.read(self.fd, _READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as fault:
            raise self._gone() from fault
        if not data:
            raise self._gone()
        self.heard += data[: HEARD_BYTES - len(self.heard)]
        return data

    def drain(self) -> None:
        """Let go by what is still under way."""
        end_s = time.monotonic() + DRAIN_S
        while time.monotonic() < end_s and self.receive(QUIET_S):
            pass
        self._parser.reset()

    def ask(self, command: PtuCommand, wait_s: float) -> Reading | None:
        """Send one command and return what its answer says, None where none came.

        An answer that cannot be this command's is one to an earlier command, perhaps of the
        program that died: it is let go by.
        """
        self._parser.expect(command.text)
        self.send(command.encode())
        end_s = min(time.monotonic() + wait_s, self.end_s)
        garbled = False
        while not garbled and (left_s := end_s - time.monotonic()) > 0.0:
            for event in self._parser.feed(self.receive(left_s), time.monotonic_ns()):
                if isinstance(event, Reply):
                    value = read(command, event)
                    if not isinstance(value, ValueFault):
                        self.pause(self.interval_s)
                        return value
                garbled = garbled or isinstance(event, FrameError)
        self.send(b" ")
        if garbled:
            self.drain()
        return None

    def ask_integer(self, command: PtuCommand) -> int | None:
        """Return what the unit answers, None where that is no number."""
        for _ in range(ATTEMPTS):
            value = self.ask(command, FIRST_ANSWER_S)
            if value is not None:
                return value if isinstance(value, int) else None
        return None

    def pause(self, seconds: float) -> None:
        """Let time pass; what comes meanwhile belongs to nothing."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0 and self.left_s() > 0.0:
            self._parser.feed(self.receive(left_s), time.monotonic_ns())

    def _gone(self) -> DeviceError:
        return DeviceError(f"{self.port} hung up", "look whether the unit stands; check the cable")


def _open(port: str, baud: int, end_s: float) -> int:
    """Open the port; wait a moment for a holder that is about to die."""
    busy_end_s = min(time.monotonic() + BUSY_S, end_s)
    while True:
        try:
            return open_port(port, baud)
        except RefusedError as fault:
            if fault.reason != "busy" or time.monotonic() > busy_end_s:
                raise _refusal(port, fault) from fault
        select.select([], [], [], 0.05)


def _refusal(port: str, fault: RefusedError) -> GyrorigError:
    from gyrorig_daemon.links.process_hub import refusal  # noqa: PLC0415 - seldom needed

    error = refusal("ptu", port, fault.reason, str(fault))
    if fault.reason == "busy":
        holder = _holder(port)
        who = f" ({holder})" if holder else ""
        remedy = f"end that program{who}: it halts the unit itself; or cut the unit's power"
        return BusyError(f"not halted: {error.what}", remedy)
    return type(error)(f"not halted: {error.what}", error.remedy)


def _holder(port: str) -> str:
    """Return which process has locked the port, "" where that cannot be seen."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        inode = str(Path(port).stat().st_ino)
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            words = line.split()  # 1: FLOCK ADVISORY WRITE 4711 00:05:88 0 EOF
            if words[1] == "FLOCK" and words[5].split(":")[2] == inode:
                name = Path(f"/proc/{words[4]}/comm").read_text(encoding="utf-8").strip()
                return f"process {words[4]}, {name}"
    return ""


def _find(line: _Line, bauds: Sequence[int]) -> int:
    """Send the order at each rate until a pan-tilt unit answers; return that rate.

    Raises:
        DeviceError: none does.
    """
    first = bauds[0]
    for baud in bauds:
        if baud != first:
            with contextlib.suppress(RefusedError):
                make_raw(line.fd, baud)
        line.send(b"   " + HALT.encode())  # spaces end what was cut short
        line.drain()
        for _ in range(2 if baud == first else 1):
            wait_s = FIRST_ANSWER_S if baud == first else OTHER_ANSWER_S
            version = line.ask(QUERY_VERSION, wait_s)
            if isinstance(version, Version):
                line.drain()
                dialect = dialect_from_version(version.text) or Dialect.D46
                line.interval_s = offers(dialect).min_command_interval_s
                return baud
    raise _nobody(line, bauds)


def _nobody(line: _Line, bauds: Sequence[int]) -> DeviceError:
    """Return the error for a port on which no pan-tilt unit answers."""
    heard = bytes(line.heard)
    tried = ", ".join(str(baud) for baud in bauds)
    if not heard:
        return DeviceError(
            f"told to halt, but nothing answers on {line.port} at {tried} baud",
            "look whether the unit stands; check its power, the cable and the port",
        )
    ours = set(f" {HALT.text}{QUERY_VERSION.text}".encode("ascii"))
    if set(heard) <= ours:
        return DeviceError(
            f"told to halt, but what is on {line.port} only sends back what it is sent",
            "a unit that homes does so until it stands: look at it; otherwise check the port",
        )
    return DeviceError(
        f"told to halt, but what is on {line.port} is no pan-tilt unit: it says {heard[:24]!r}",
        "look whether the unit stands; check the ports in the rig's configuration",
    )


def _order(line: _Line) -> None:
    """Give the order in step with the unit.

    Raises:
        DeviceError: it is not acknowledged.
    """
    said = "nothing"
    for _ in range(ATTEMPTS):
        answer = line.ask(HALT, FIRST_ANSWER_S)
        if isinstance(answer, Done):
            return
        said = repr(answer.text[:40]) if isinstance(answer, Refusal) else said
    raise DeviceError(
        f"the unit on {line.port} does not acknowledge the halt: it says {said}",
        "look whether it stands; cut its power if it does not",
    )


def _see_it_stand(line: _Line) -> tuple[int, int]:
    """Ask until both axes stand; return where.

    Raises:
        DeviceError: they do not, or it is not answered.
    """
    speeds = [query(axis, Quantity.SPEED_CHANGE) for axis in Axis]
    places = [query(axis, Quantity.POSITION) for axis in Axis]
    known: list[int | None] = []
    equal = 0
    while line.left_s() > 0.0:
        rates = [line.ask_integer(command) for command in speeds]
        steps = [line.ask_integer(command) for command in places]
        equal = equal + 1 if steps == known else 1
        known = steps
        enough = STILL_ROUNDS if None in rates else 2
        pan_steps, tilt_steps = steps
        if equal >= enough and not any(rates) and pan_steps is not None and tilt_steps is not None:
            return pan_steps, tilt_steps
        line.pause(ROUND_S)
    raise DeviceError(
        f"the unit on {line.port} took the order to halt and was not seen to stand",
        "look at it; cut its power if it still turns",
    )
