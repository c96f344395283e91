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

from gyrorig_daemon.halt_line import HaltLine
from gyrorig_daemon.links.serial_port import RefusedError, make_raw, open_port
from gyrorig_protocol.errors import BusyError, DeviceError, GyrorigError
from gyrorig_protocol.ptu import Axis, PtuCommand, Quantity, Refusal, Version
from gyrorig_protocol.ptu.commands import HALT, QUERY_VERSION, query
from gyrorig_protocol.ptu.dialect import Dialect, dialect_from_version, offers
from gyrorig_protocol.ptu.values import Done

# E series up to 115200, D series up to 38400; 9600 from the factory (manual v3.00D, clients)
USUAL_BAUDS = (9600, 19200, 38400, 57600, 115200)
PATIENCE_S = 7.0  # for everything; from 206 deg/s a unit needs 1.5 s to stand (defaults)
BUSY_S = 2.0  # a dying process closes its ports that late
FIRST_ANSWER_S = 0.8  # the slowest: 0.1 s a command, 0.1 s of text at 9600 baud
OTHER_ANSWER_S = 0.4
ATTEMPTS = 3
ROUND_S = 0.1  # between two looks at the axes
STILL_ROUNDS = 3  # equal positions in a row, where speeds are not answered


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
        line = HaltLine(fd, port, end_s)
        baud = _find(line, bauds)
        _order(line)
        pan_steps, tilt_steps = _see_it_stand(line)
        return Standing(port, baud, pan_steps, tilt_steps)
    finally:
        with contextlib.suppress(termios.error):
            termios.tcflush(fd, termios.TCIOFLUSH)  # what nobody takes would delay the closing
        os.close(fd)


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
    from gyrorig_daemon.links.holder import lock_holder  # noqa: PLC0415 - seldom needed
    from gyrorig_daemon.links.process_hub import refusal  # noqa: PLC0415

    error = refusal("ptu", port, fault.reason, str(fault))
    if fault.reason == "busy":
        holder = lock_holder(port)
        who = f" ({holder})" if holder else ""
        ours = holder is not None and holder.is_ours
        then = "it halts the unit itself" if ours else "then halt again"
        remedy = f"end that program{who}: {then}; or cut the unit's power"
        return BusyError(f"not halted: {error.what}", remedy)
    return type(error)(f"not halted: {error.what}", error.remedy)


def _find(line: HaltLine, bauds: Sequence[int]) -> int:
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


def _nobody(line: HaltLine, bauds: Sequence[int]) -> DeviceError:
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


def _order(line: HaltLine) -> None:
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


def _see_it_stand(line: HaltLine) -> tuple[int, int]:
    """Ask until both axes stand; return where.

    Raises:
        DeviceError: they do not, or it is not answered.
    """
    speeds = [query(axis, Quantity.SPEED_CHANGE) for axis in Axis]
    places = [query(axis, Quantity.POSITION) for axis in Axis]
    known: list[int | None] = []
    equal = 0
    while line.left_s() > 0.0:
        rates = [_ask_integer(line, command) for command in speeds]
        steps = [_ask_integer(line, command) for command in places]
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


def _ask_integer(line: HaltLine, command: PtuCommand) -> int | None:
    """Return what the unit answers, None where that is no number."""
    for _ in range(ATTEMPTS):
        value = line.ask(command, FIRST_ANSWER_S)
        if value is not None:
            return value if isinstance(value, int) else None
    return None
