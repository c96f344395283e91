"""What every CAN socket of the acquisition process shares: buffer, stamps, drops, records.

What to use when: `can_line.open_line` opens any bus; here is the reading itself. The buffer is as
large as the system allows, the kernel's count of dropped frames becomes a record of its own,
and every frame is stamped by the kernel: what delays this process does not delay the stamps.
Kernel stamps are of the wall clock; each read call pairs it with the raw monotonic clock. Where
a stamp cannot be so, the moment of reading stands in; stamps never go back.
"""

import socket
import struct
import time
from abc import ABC, abstractmethod

from gyrorig_protocol.can.frame import RECORD, FrameFlag

BUFFER_BYTES = 4 << 20  # 0.5 s of a stalled reader, measured
FRAMES_PER_READ = 512
NEWEST_NS = 2_000_000  # a stamp cannot be from the future, but both clocks are read in turn
OLDEST_NS = 10_000_000_000
CLOCK_PAIRS = 3
TIGHT_NS = 3_000

_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35  # <asm-generic/socket.h>
_SO_RXQ_OVFL = 40
_TIMESPEC = struct.Struct("=qq")
_COUNT = struct.Struct("=I")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(_COUNT.size)


def _read_clocks() -> tuple[int, int]:
    """Return the raw clock, and what to add to the wall clock to have it.

    The tightest of a few pairs: an interruption between two readings would make every stamp
    of a read call early by as much, and no arrival can be early.
    """
    best: tuple[int, int, int] | None = None
    for _ in range(CLOCK_PAIRS):
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        width_ns = after_ns - before_ns
        if best is None or width_ns < best[0]:
            best = width_ns, after_ns, before_ns + width_ns // 2 - wall_ns
        if width_ns < TIGHT_NS:
            break
    if best is None:  # CLOCK_PAIRS is not zero
        raise AssertionError
    return best[1], best[2]


class CanLine(ABC):
    """What both kinds share: stamps, drops, records."""

    def __init__(self, receiver: socket.socket) -> None:
        self._receiver = receiver
        self._dropped = 0  # the kernel's count when it was last seen
        self._last_ns = 0
        self.deaf_to: tuple[str, int] | None = None  # a sender whose frames are passed over
        receiver.setblocking(False)
        try:
            receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, BUFFER_BYTES)
        except OSError:  # only root may have more than net.core.rmem_max
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        receiver.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)

    @property
    def fd(self) -> int:
        """What to poll."""
        return self._receiver.fileno()

    def read(self) -> bytes:
        """Return what has come as records; see `Line.read`."""
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
                break  # the next read says it again
            if self.deaf_to is not None and sender == self.deaf_to:
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
            if not raw_ns - OLDEST_NS < stamp_ns < raw_ns + NEWEST_NS:
                stamp_ns = raw_ns  # the wall clock was set meanwhile
            # Frames come in order; the pairs of clocks scatter.
            self._last_ns = stamp_ns = max(stamp_ns, self._last_ns)
            records.append(self.to_record(data, stamp_ns))
        return b"".join(records)

    def write(self, data: bytes) -> int:
        """Send the first of the packed records; see `Line.write`."""
        if len(data) < RECORD.size:
            return len(data)
        identifier, flags, length, content, _ = RECORD.unpack_from(data)
        self.send(identifier, flags, content[:length])
        return RECORD.size

    @abstractmethod
    def to_record(self, data: bytes, stamp_ns: int) -> bytes:
        """Return the record of what one receive call returned."""

    @abstractmethod
    def send(self, identifier: int, flags: int, data: bytes) -> None:
        """Send one frame.

        Raises:
            OSError: the bus, or its queue, does not take it.
        """

    def close(self) -> None:
        """Let go of the bus."""
        self._receiver.close()

    def _count_drops(self, count: int, records: list[bytes]) -> None:
        before, self._dropped = self._dropped, count
        lost = (count - before) & 0xFFFF_FFFF
        if lost:
            records.append(RECORD.pack(lost, int(FrameFlag.LOST), 0, b"", 0))
