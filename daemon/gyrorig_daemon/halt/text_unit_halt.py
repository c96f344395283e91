"""Halt a unit of text lines through its serial port alone; `standalone_halt` has the theory.

What to use when: `halt_text_unit` for a unit whose driver has a `TextLanguage`. The halt bytes of
the driver are the first bytes on the line, at each baud rate.
"""

import contextlib
import os
import termios
import time
from collections.abc import Sequence

from gyrorig_daemon.halt.direct_ptu_line import DirectPtuLine
from gyrorig_daemon.halt.standalone_halt import (
    ATTEMPTS,
    FIRST_ANSWER_S,
    OTHER_BAUD_ANSWER_S,
    POLL_INTERVAL_S,
    STANDSTILL_POLLS,
    TIMEOUT_S,
    HaltResult,
    open_unit_port,
)
from gyrorig_daemon.links.ports.serial_port import PortRefusedError, configure_raw
from gyrorig_daemon.motion.framing import decode_replies
from gyrorig_daemon.motion.text_language import TextLanguage
from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import Axis


class DirectTextLine(DirectPtuLine):
    """One command in words and its reply at a time on an open port."""

    def __init__(self, fd: int, port: str, end_s: float, language: TextLanguage) -> None:
        super().__init__(fd, port, end_s)
        self.language = language
        self._framing = language.make_framing()

    def ask_line(self, text: str, wait_s: float) -> str | None:
        """Send one command and return the next reply that arrives, None without one."""
        received = bytearray()
        self.send(self._framing.encode(text))
        end_s = min(time.monotonic() + wait_s, self.end_s)
        while (left_s := end_s - time.monotonic()) > 0.0:
            received += self.receive(left_s)
            replies, _ = decode_replies(self._framing, received)
            if replies:
                return replies[0]
        return None

    def find_identity(self, wait_s: float) -> dict[str, str] | None:
        """Return the identity of the unit, None if no such unit answers."""
        reply = self.ask_line(self.language.identify, wait_s)
        return None if reply is None else self.language.read_identity(reply)


def halt_text_unit(port: str, bauds: Sequence[int], language: TextLanguage) -> HaltResult:
    """Halt all axes of the unit on `port` and confirm that they have stopped.

    Raises:
        BusyError: another program holds the port and does not release it.
        UsageError: the path is not a serial port.
        MachineError: there is no permission to open it.
        DeviceError: there is no such port, nothing answers, the device is not the unit, or it
            still moves. If the port could be opened, the command was sent.
    """
    end_s = time.monotonic() + TIMEOUT_S
    fd = open_unit_port(port, bauds[0], end_s)
    try:
        line = DirectTextLine(fd, port, end_s, language)
        baud = _find_unit(line, bauds)
        _send_halt(line)
        steps = _confirm_standstill(line)
        return HaltResult(port, baud, steps.get(Axis.PAN, 0), steps.get(Axis.TILT, 0))
    finally:
        with contextlib.suppress(termios.error):
            termios.tcflush(fd, termios.TCIOFLUSH)
        os.close(fd)


def send_halt_bytes(port: str, bauds: Sequence[int], halt_bytes: bytes) -> None:
    """Send the halt bytes of a driver without a `TextLanguage` at each baud rate.

    Raises:
        BusyError, UsageError, MachineError, DeviceError: the port cannot be opened.
    """
    end_s = time.monotonic() + TIMEOUT_S
    fd = open_unit_port(port, bauds[0], end_s)
    try:
        line = DirectPtuLine(fd, port, end_s)
        for baud in bauds:
            if baud != bauds[0]:
                with contextlib.suppress(PortRefusedError):
                    configure_raw(fd, baud)
            line.send(halt_bytes)
            line.drain()
    finally:
        os.close(fd)


def _find_unit(line: DirectTextLine, bauds: Sequence[int]) -> int:
    """Send the halt bytes at each baud rate until the unit answers; return the rate."""
    for baud in bauds:
        is_first = baud == bauds[0]
        if not is_first:
            with contextlib.suppress(PortRefusedError):
                configure_raw(line.fd, baud)
        line.send(line.language.halt_bytes)
        line.drain()
        for _ in range(2 if is_first else 1):
            if line.find_identity(FIRST_ANSWER_S if is_first else OTHER_BAUD_ANSWER_S) is not None:
                return baud
    received = bytes(line.received_bytes[:24])
    what = f"answers {received!r}" if received else "does not answer"
    raise DeviceError(
        f"the halt command was sent, but the device on {line.port} {what}, unlike a unit of the "
        f"driver {line.language.name}",
        "make sure that the unit has stopped. Then check its power, its cable and its port",
    )


def _send_halt(line: DirectTextLine) -> None:
    for _ in range(ATTEMPTS):
        reply = line.ask_line(line.language.halt, FIRST_ANSWER_S)
        if reply is not None and line.language.is_accepted(reply):
            return
    raise DeviceError(
        f"the unit on {line.port} does not acknowledge the halt command",
        "check that the unit has stopped. If it has not, switch off its power",
    )


def _confirm_standstill(line: DirectTextLine) -> dict[Axis, int]:
    """Poll all axes until they are at standstill; return their positions."""
    language, previous, equal_count = line.language, None, 0
    while line.remaining_s() > 0.0:
        steps: dict[Axis, int] = {}
        is_moving = False
        for axis in language.axes:
            query = language.format(language.position, axis)
            answered, is_still = language.read_positions(
                line.ask_line(query, FIRST_ANSWER_S) or "", axis
            )
            steps |= answered
            is_moving = is_moving or is_still is False
        equal_count = equal_count + 1 if steps == previous else 1
        previous = steps
        if len(steps) == len(language.axes) and equal_count >= STANDSTILL_POLLS and not is_moving:
            return steps
        line.pause(POLL_INTERVAL_S)
    raise DeviceError(
        f"the unit on {line.port} acknowledged the halt command, but its positions do not show "
        "that it stopped",
        "check the unit. If it still turns, switch off its power",
    )
