"""One port of the acquisition process: open, gone, or waiting to be tried again.

Theory of operation. A port is UP while its line is open. It goes down when the line hangs
up, when opening was refused, or when the daemon wants it opened anew; from then on it is
tried every two seconds, jittered, for ever (gpsd's `DEVICE_RECONNECT`; reference:
reliability.md sections 1 and 3), by its path: a device that is plugged in again
has the same link and another node. What is under way when it goes down fails at once.
"""

import os
from dataclasses import dataclass, field

from gyrorig_daemon.links.port_kinds import STAMPED, Line, PortSettings, open_line
from gyrorig_daemon.links.raw_clock import raw_ns
from gyrorig_daemon.links.serial_port import RefusedError

RETRY_NS = 2_000_000_000
_JITTER = 0.25  # of the time between two attempts, to both sides
MAX_EMPTY_READS = 100  # in a row, though the port is readable and has not hung up


@dataclass(slots=True)
class Write:
    """A write under way."""

    data: bytes
    deadline_ns: int
    before_ns: int = 0


@dataclass(slots=True)
class SupervisedPort:
    """One port and what is to be written to it."""

    index: int
    settings: PortSettings
    pause_ns: int = RETRY_NS
    line: Line | None = None
    retry_ns: int = 0  # when to try again; of no meaning while the line is open
    empty_reads: int = 0
    refusal: str = ""  # why the last attempt failed
    writes: list[Write] = field(default_factory=list)

    @property
    def farewell(self) -> bytes:
        """What to say when the daemon is gone."""
        return self.settings.farewell.encode("ascii")

    @property
    def is_awaited(self) -> bool:
        """True where somebody waits for each answer: on the unit's port."""
        return bool(self.settings.farewell)

    @property
    def stamps_itself(self) -> bool:
        """True where each frame that is read has a stamp of its own: it may be read later."""
        return self.settings.kind in STAMPED

    def open(self) -> None:
        """Open the line.

        Raises:
            RefusedError: it cannot be opened; the next attempt is scheduled.
        """
        try:
            self.line = open_line(self.settings)
        except RefusedError as fault:
            self.refusal = str(fault)
            self.retry_ns = raw_ns() + _jittered_ns(self.pause_ns)
            raise
        self.refusal, self.empty_reads = "", 0

    def shut(self, now: bool = False) -> None:
        """Let go of the line; `now` asks for an attempt to open it at once."""
        line, self.line = self.line, None
        self.retry_ns = 0 if now else raw_ns() + _jittered_ns(self.pause_ns)
        if line is not None:
            line.close()

    def read(self, has_hung_up: bool) -> bytes | None:
        """Return what is there, "" where the port is gone, None where there is nothing.

        A readable port without bytes has not hung up as long as the kernel does not say so:
        another program may have read them.
        """
        if self.line is None:
            return None
        try:
            data = self.line.read()
        except BlockingIOError:
            return None
        except OSError:
            return b""
        if data:
            self.empty_reads = 0
            return data
        self.empty_reads += 1
        return b"" if has_hung_up or self.empty_reads > MAX_EMPTY_READS else None


def _jittered_ns(pause_ns: int) -> int:
    """Return how long to wait: a rig's ports, and a house's rigs, not all at once."""
    share = 2.0 * os.urandom(1)[0] / 255.0 - 1.0
    return int(pause_ns * (1.0 + _JITTER * share))
