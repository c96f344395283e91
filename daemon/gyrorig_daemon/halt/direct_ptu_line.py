"""Half-duplex exchanges with a pan-tilt unit on an open file descriptor, without the daemon.

What to use when: `DirectPtuLine` in `gyrorigd halt` and in the doctor. Everything else talks
to a unit through `PtuClient`, which records the exchanges. Every wait here has a timeout.
"""

import os
import select
import time

from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    InvalidLine,
    PtuCommand,
    PtuReplyParser,
    Reading,
    Reply,
    ValueFault,
    read_value,
)

SILENCE_S = 0.15  # after this time without a byte a reply is complete (0.1 s per command)
DRAIN_S = 0.3  # limit for a port that never falls silent
MAX_RECEIVED_BYTES = 4096
_READ_BYTES = 4096


class DirectPtuLine:
    """One command and its reply at a time on an open port, until a common deadline."""

    def __init__(self, fd: int, port: str, end_s: float) -> None:
        self.fd, self.port, self.end_s = fd, port, end_s
        self.received_bytes = bytearray()
        self.min_interval_s = 0.0
        self._parser = PtuReplyParser()

    def remaining_s(self) -> float:
        """Return the time until the deadline."""
        return self.end_s - time.monotonic()

    def send(self, data: bytes) -> None:
        """Write as much as the port takes now.

        Raises:
            DeviceError: the port is gone.
        """
        try:
            os.write(self.fd, data)
        except BlockingIOError:
            return  # the port takes nothing: there will be no reply
        except OSError as fault:
            raise self._hung_up_error() from fault

    def receive(self, wait_s: float) -> bytes:
        """Return the bytes that arrive within `wait_s`, empty if none do.

        Raises:
            DeviceError: the port is gone.
        """
        ready, _, _ = select.select([self.fd], [], [], max(0.0, min(wait_s, self.remaining_s())))
        if not ready:
            return b""
        try:
            data = os.read(self.fd, _READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError as fault:
            raise self._hung_up_error() from fault
        if not data:
            raise self._hung_up_error()
        self.received_bytes += data[: MAX_RECEIVED_BYTES - len(self.received_bytes)]
        return data

    def drain(self) -> None:
        """Discard bytes that are still being received."""
        end_s = time.monotonic() + DRAIN_S
        while time.monotonic() < end_s and self.receive(SILENCE_S):
            pass
        self._parser.reset()

    def ask(self, command: PtuCommand, wait_s: float) -> Reading | None:
        """Send one command and return the value of its reply, None without a reply.

        A reply that does not fit the command belongs to an earlier one, perhaps of a program that
        died, and is discarded.
        """
        self._parser.expect(command.text)
        self.send(command.encode())
        end_s = min(time.monotonic() + wait_s, self.end_s)
        is_garbled = False
        while not is_garbled and (left_s := end_s - time.monotonic()) > 0.0:
            for event in self._parser.feed(self.receive(left_s), time.monotonic_ns()):
                if isinstance(event, Reply):
                    value = read_value(command, event)
                    if not isinstance(value, ValueFault):
                        self.pause(self.min_interval_s)
                        return value
                is_garbled = is_garbled or isinstance(event, InvalidLine)
        self.send(b" ")
        if is_garbled:
            self.drain()
        return None

    def pause(self, seconds: float) -> None:
        """Wait, and discard what arrives meanwhile."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0 and self.remaining_s() > 0.0:
            self._parser.feed(self.receive(left_s), time.monotonic_ns())

    def _hung_up_error(self) -> DeviceError:
        return DeviceError(
            f"the port {self.port} of the pan-tilt unit was unplugged",
            "check that the unit has stopped. Then check its cable",
        )
