"""One exchange after another on an open port: the unit's line without the daemon.

What to use when: `HaltLine` in `halt` and in `doctor`; everything else talks to a unit by
`PtuClient`, which records what is said. No wait here is without an end.
"""

import os
import select
import time

from gyrorig_protocol.errors import DeviceError
from gyrorig_protocol.ptu import (
    FrameError,
    PtuCommand,
    PtuReplyParser,
    Reading,
    Reply,
    ValueFault,
    read,
)

QUIET_S = 0.15  # so long without a byte, and what was under way is over (0.1 s a command)
DRAIN_S = 0.3  # a port that never falls silent is listened to no longer than this
HEARD_BYTES = 4096
_READ_BYTES = 4096


class HaltLine:
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

    def pause(self, seconds: float) -> None:
        """Let time pass; what comes meanwhile belongs to nothing."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0 and self.left_s() > 0.0:
            self._parser.feed(self.receive(left_s), time.monotonic_ns())

    def _gone(self) -> DeviceError:
        return DeviceError(f"{self.port} hung up", "look whether the unit stands; check the cable")
