"""Reports of the acquisition process that wait for room in a pipe to the daemon."""

import os
import select

from gyrorig_daemon.links.ports import acquisition_pipe
from gyrorig_daemon.links.ports.raw_clock import raw_ns

PIPE_BYTES = 1 << 20
# Chunks are collected for this time before they are sent. They have their timestamps already,
# and each transfer wakes the daemon up. Urgent reports are sent at once.
GATHER_NS = 4_000_000
GATHER_BYTES = 1 << 16


class ReportQueue:
    """The reports on their way into one pipe."""

    def __init__(self, fd: int, poll: "select.epoll") -> None:
        """Send to `fd`, which is registered in `poll` while it is full."""
        self.fd = fd
        self._poll = poll
        self._buffer = bytearray()
        self._is_urgent = False
        self.is_full = False  # the pipe
        self.batch_start_ns = 0  # since when reports or readable frames wait

    def __len__(self) -> int:
        """Number of bytes that wait."""
        return len(self._buffer)

    def add(self, kind: int, index: int, first_ns: int, second_ns: int, data: bytes) -> None:
        """Queue one report."""
        self._is_urgent = self._is_urgent or kind != acquisition_pipe.CHUNK
        self._buffer += (
            acquisition_pipe.REPORT_HEADER.pack(kind, index, len(data), first_ns, second_ns) + data
        )

    def begin_batch(self) -> None:
        """Note that something waits from now on."""
        self.batch_start_ns = raw_ns()

    def is_flush_due(self, now_ns: int, has_other_data: bool) -> bool:
        """Return whether something has waited long enough."""
        if self._is_urgent or len(self._buffer) >= GATHER_BYTES:
            return bool(self._buffer)
        has_data = bool(self._buffer) or has_other_data
        return has_data and now_ns - self.batch_start_ns >= GATHER_NS

    def flush(self) -> None:
        """Send as much as the pipe takes, and wait for room only if something is left."""
        try:
            while self._buffer:
                sent = os.write(self.fd, self._buffer[:PIPE_BYTES])
                del self._buffer[:sent]
        except BlockingIOError:
            if not self.is_full:
                self._poll.register(self.fd, select.EPOLLOUT)
            self.is_full = True
            return
        except OSError:
            self._buffer.clear()  # nobody reads; the pipe of commands will report the same
        if self.is_full:
            self._poll.unregister(self.fd)
        self._is_urgent = self.is_full = False
