"""Halt a pan-tilt unit through its serial port alone: the work of `gyrorigd halt`.

What to use when: `halt_unit` after the program that moved the unit has died, or instead of
it. It opens the port itself and needs no acquisition process, no recording and no valid
configuration. It imports little, so that it acts at once.

Theory of operation. The halt command is sent first, before anything is known. This stops the
unit soonest, and it moves no other device. Then the firmware version is requested at each
baud rate in turn; only a pan-tilt unit answers that. The halt command is sent again, this
time with its acknowledgement, and the axes are polled until both are at standstill. Every
wait ends, and `TIMEOUT_S` limits the sum.
"""

import contextlib
import os
import select
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass

from gyrorig_daemon.halt.direct_ptu_line import DirectPtuLine
from gyrorig_daemon.links.ports.serial_port import PortRefusedError, configure_raw, open_port
from gyrorig_protocol.errors import BusyError, DeviceError, GyrorigError
from gyrorig_protocol.ptu import Axis, FirmwareVersion, PtuCommand, Quantity, Refusal
from gyrorig_protocol.ptu.dialect import Dialect, dialect_features, dialect_from_version
from gyrorig_protocol.ptu.ptu_commands import HALT_BOTH_AXES, QUERY_VERSION, query_quantity
from gyrorig_protocol.ptu.reply_values import Acknowledgement

# E series up to 115200, D series up to 38400; 9600 from the factory (manual v3.00D, clients)
USUAL_BAUDS = (9600, 19200, 38400, 57600, 115200)
TIMEOUT_S = 7.0  # in total; a unit needs 1.5 s to stop from 206 deg/s (factory settings)
BUSY_TIMEOUT_S = 2.0  # a process that ends closes its ports that late
FIRST_ANSWER_S = 0.8  # at most 0.1 s per command and 0.1 s of text at 9600 baud
OTHER_BAUD_ANSWER_S = 0.4
ATTEMPTS = 3
POLL_INTERVAL_S = 0.1  # between two polls of the axes
STANDSTILL_POLLS = 3  # consecutive equal positions, if the unit does not report speeds


@dataclass(frozen=True, slots=True)
class HaltResult:
    """A unit that has acknowledged the halt and is at standstill."""

    port: str
    baud: int
    pan_steps: int
    tilt_steps: int


def halt_unit(port: str, bauds: Sequence[int], timeout_s: float = TIMEOUT_S) -> HaltResult:
    """Halt both axes of the unit on `port` and confirm that they have stopped.

    Args:
        port: the path of the serial port.
        bauds: baud rates to try, the most likely first.
        timeout_s: limit for everything together.

    Raises:
        BusyError: another program holds the port and does not release it.
        UsageError: the path is not a serial port.
        MachineError: there is no permission to open it.
        DeviceError: there is no such port, nothing answers, the device is not a pan-tilt unit,
            or it still moves. If the port could be opened, the command was sent.
    """
    end_s = time.monotonic() + timeout_s
    fd = open_unit_port(port, bauds[0], end_s)
    try:
        line = DirectPtuLine(fd, port, end_s)
        baud = _find_unit(line, bauds)
        _send_halt(line)
        pan_steps, tilt_steps = _confirm_standstill(line)
        return HaltResult(port, baud, pan_steps, tilt_steps)
    finally:
        with contextlib.suppress(termios.error):
            termios.tcflush(fd, termios.TCIOFLUSH)  # bytes that were not sent would delay the close
        os.close(fd)


def open_unit_port(port: str, baud: int, end_s: float) -> int:
    """Open the port; wait a moment for a program that is about to release it.

    Raises:
        GyrorigError: it cannot be opened; the class says who must act.
    """
    busy_end_s = min(time.monotonic() + BUSY_TIMEOUT_S, end_s)
    while True:
        try:
            return open_port(port, baud)
        except PortRefusedError as fault:
            if fault.reason != "busy" or time.monotonic() > busy_end_s:
                raise _port_refused_error(port, fault) from fault
        select.select([], [], [], 0.05)


def _port_refused_error(port: str, fault: PortRefusedError) -> GyrorigError:
    from gyrorig_daemon.links.ports.port_errors import port_error  # noqa: PLC0415
    from gyrorig_daemon.links.ports.port_holder import lock_holder  # noqa: PLC0415 - rarely needed

    error = port_error("ptu", port, fault.reason, str(fault))
    if fault.reason == "busy":
        holder = lock_holder(port)
        holder_text = f" ({holder})" if holder else ""
        is_ours = holder is not None and holder.is_ours
        next_step = (
            "The program halts the unit when it ends"
            if is_ours
            else ("Then run the halt command again")
        )
        remedy = (
            f"end the program that uses the port{holder_text}. {next_step}, or switch off the "
            "power of the unit"
        )
        return BusyError(f"the unit was not halted, because {error.problem}", remedy)
    return type(error)(f"the unit was not halted, because {error.problem}", error.remedy)


def _find_unit(line: DirectPtuLine, bauds: Sequence[int]) -> int:
    """Send the halt command at each baud rate until a pan-tilt unit answers; return the rate.

    Raises:
        DeviceError: no pan-tilt unit answers.
    """
    for baud in bauds:
        is_first = baud == bauds[0]
        if not is_first:
            with contextlib.suppress(PortRefusedError):
                configure_raw(line.fd, baud)
        line.send(b"   " + HALT_BOTH_AXES.encode())  # spaces end a truncated command
        line.drain()
        for _ in range(2 if is_first else 1):
            wait_s = FIRST_ANSWER_S if is_first else OTHER_BAUD_ANSWER_S
            version = line.ask(QUERY_VERSION, wait_s)
            if isinstance(version, FirmwareVersion):
                line.drain()
                dialect = dialect_from_version(version.text) or Dialect.D46
                line.min_interval_s = dialect_features(dialect).min_command_interval_s
                return baud
    raise _no_unit_error(line, bauds)


def _no_unit_error(line: DirectPtuLine, bauds: Sequence[int]) -> DeviceError:
    received = bytes(line.received_bytes)
    tried = ", ".join(map(str, bauds))
    if not received:
        return DeviceError(
            f"the halt command was sent, but nothing answers on {line.port} at {tried} baud",
            "check that the unit has stopped. Then check its power, its cable and its port",
        )
    echo_bytes = set(f" {HALT_BOTH_AXES.text}{QUERY_VERSION.text}".encode("ascii"))
    if set(received) <= echo_bytes:
        return DeviceError(
            f"the halt command was sent, but the device on {line.port} only returns the "
            "bytes that it receives",
            "check whether the unit is homing: it then returns all bytes until it stops. If the "
            "unit is not homing, check which device is connected to this port",
        )
    return DeviceError(
        f"the halt command was sent to {line.port}, but the device there does not answer like a "
        f"pan-tilt unit (answer: {received[:24]!r}). The pan-tilt unit may still move",
        "make sure that the unit has stopped. Then correct the ports in the rig file",
    )


def _send_halt(line: DirectPtuLine) -> None:
    """Send the halt command and wait for its acknowledgement.

    Raises:
        DeviceError: it is not acknowledged.
    """
    answer_text = "nothing"
    for _ in range(ATTEMPTS):
        answer = line.ask(HALT_BOTH_AXES, FIRST_ANSWER_S)
        if isinstance(answer, Acknowledgement):
            return
        answer_text = repr(answer.text[:40]) if isinstance(answer, Refusal) else answer_text
    raise DeviceError(
        f"the pan-tilt unit on {line.port} does not acknowledge the halt command, but "
        f"answers {answer_text}",
        "check that the unit has stopped. If it has not, switch off its power",
    )


def _confirm_standstill(line: DirectPtuLine) -> tuple[int, int]:
    """Poll both axes until they are at standstill; return their positions.

    Raises:
        DeviceError: they do not stop, or they do not answer.
    """
    speed_queries = [query_quantity(axis, Quantity.SPEED_CHANGE) for axis in Axis]
    position_queries = [query_quantity(axis, Quantity.POSITION) for axis in Axis]
    previous_steps: list[int | None] = []
    equal_count = 0
    while line.remaining_s() > 0.0:
        rates = [_ask_integer(line, command) for command in speed_queries]
        steps = [_ask_integer(line, command) for command in position_queries]
        equal_count = equal_count + 1 if steps == previous_steps else 1
        previous_steps = steps
        required_count = STANDSTILL_POLLS if None in rates else 2
        pan_steps, tilt_steps = steps
        if (
            equal_count >= required_count
            and not any(rates)
            and pan_steps is not None
            and tilt_steps is not None
        ):
            return pan_steps, tilt_steps
        line.pause(POLL_INTERVAL_S)
    raise DeviceError(
        f"the pan-tilt unit on {line.port} acknowledged the halt command, but its positions "
        "do not show that it stopped",
        "check the unit. If it still turns, switch off its power",
    )


def _ask_integer(line: DirectPtuLine, command: PtuCommand) -> int | None:
    for _ in range(ATTEMPTS):
        value = line.ask(command, FIRST_ANSWER_S)
        if value is not None:
            return value if isinstance(value, int) else None
    return None
