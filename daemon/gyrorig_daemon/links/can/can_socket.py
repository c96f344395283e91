"""Base class of CAN sockets: receive buffer, kernel timestamps, drop counter, records.

The buffer is as large as the system allows. The kernel's count of dropped frames becomes a
record. Every frame is timestamped by the kernel, so that delays of this process do not matter.
Kernel timestamps are on the system clock; each read call pairs that with the raw monotonic
clock. If a timestamp is implausible, the time of reading replaces it. Timestamps never
decrease.
"""

import socket
import struct
import time
from abc import ABC, abstractmethod

from gyrorig_protocol.can.can_frame import RECORD, FrameFlag

BUFFER_BYTES = 4 << 20  # enough for a reader that stalls for 0.5 s (measured)
FRAMES_PER_READ = 512
MAX_FUTURE_NS = 2_000_000  # tolerance, because the two clocks are not read at the same time
MAX_AGE_NS = 10_000_000_000
CLOCK_PAIRS = 3
TIGHT_PAIR_NS = 3_000

_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>
_SO_RXQ_OVFL = 40
_TIMESPEC = struct.Struct("=qq")
_COUNT = struct.Struct("=I")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)


def _read_clocks() -> tuple[int, int]:
    """Return the raw clock, and the offset from the system clock to it.

    The tightest of a few pairs of readings: an interruption between two readings would make all
    timestamps of a read call early, and no arrival can be early.
    """
    best: tuple[int, int, int] | None = None
    for _ in range(CLOCK_PAIRS):
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        width_ns = after_ns - before_ns
        if best is None or width_ns < best[0]:
            best = width_ns, after_ns, before_ns + width_ns // 2 - wall_ns
        if width_ns < TIGHT_PAIR_NS:
            break
    if best is None:  # CLOCK_PAIRS is not zero
        raise AssertionError
    return best[1], best[2]


class CanSocketLine(ABC):
    """Common part of the lines that read a socket."""

    def __init__(self, receiver: socket.socket) -> None:
        self._receiver = receiver
        self._drop_count = 0  # last value of the kernel's counter
        self._last_ns = 0
        self.ignored_sender: tuple[str, int] | None = None  # a sender whose frames are ignored
        receiver.setblocking(False)
        try:
            receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, BUFFER_BYTES)
        except OSError:  # only root can exceed net.core.rmem_max
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        receiver.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)

    @property
    def fd(self) -> int:
        """File descriptor to poll."""
        return self._receiver.fileno()

    def read(self) -> bytes:
        """Return received frames as records. See `Line.read`."""
        records: list[bytes] = []
        raw_ns, wall_to_raw_ns = _read_clocks()
        while len(records) < FRAMES_PER_READ:
            try:
                data, ancillary, _, sender = self._receiver.recvmsg(4096, _ANCILLARY_BYTES)
            except BlockingIOError:
                if not records:
                    raise
                break
            except OSError:
                if not records:
                    raise
                break  # the next read reports it
            if self.ignored_sender is not None and sender == self.ignored_sender:
                continue
            stamp_ns = 0
            for _, kind, value in ancillary:
                if kind == _SO_TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack(value)
                    stamp_ns = seconds * 1_000_000_000 + nanoseconds + wall_to_raw_ns
                elif kind == _SO_RXQ_OVFL:
                    self._count_drops(_COUNT.unpack(value)[0], records)
            if stamp_ns > raw_ns:
                raw_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
            if not raw_ns - MAX_AGE_NS < stamp_ns < raw_ns + MAX_FUTURE_NS:
                stamp_ns = raw_ns  # the system clock was set meanwhile
            # Frames arrive in order, but the clock pairs scatter.
            self._last_ns = stamp_ns = max(stamp_ns, self._last_ns)
            records.append(self.to_record(data, stamp_ns))
        return b"".join(records)

    def write(self, data: bytes) -> int:
        """Send the first of the packed records. See `Line.write`."""
        if len(data) < RECORD.size:
            return len(data)
        identifier, flags, length, content, _ = RECORD.unpack_from(data)
        self.send(identifier, flags, content[:length])
        return RECORD.size

    @abstractmethod
    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """Return the record of one received packet."""

    @abstractmethod
    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """Send one frame.

        Raises:
            OSError: the bus or its queue does not accept it.
        """

    def close(self) -> None:
        """Release the bus."""
        self._receiver.close()

    def _count_drops(self, count: int, records: list[bytes]) -> None:
        before, self._drop_count = self._drop_count, count
        lost = (count - before) & 0xFFFF_FFFF
        if lost:
            records.append(RECORD.pack(lost, int(FrameFlag.LOST), 0, b"", 0))
