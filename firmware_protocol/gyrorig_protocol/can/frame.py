"""A CAN frame, and how frames travel through a pipe: packed records of one size.

What to use when: `CanFrame` wherever frames are looked at; `pack_frames` and
`unpack_frames` where they go through the acquisition process's pipe, which carries bytes.

    record, little-endian, 24 bytes
    I   identifier, 11 or 29 bits; of a LOST record: how many frames the kernel dropped
    B   flags, see `FrameFlag`
    B   length of the data, 0 to 8
    2x
    8s  data, filled up with zeros
    q   when it was on the bus, raw monotonic ns of the host, as well as the interface knows;
        0 where it does not: then the stamp of the read call holds

Only classical frames: no board here sends CAN FD. A frame longer than 8 bytes is counted as
foreign by whoever reads the bus.
"""

import struct
from collections.abc import Iterable
from enum import IntFlag

import msgspec

from gyrorig_protocol.errors import UsageError

RECORD = struct.Struct("<IBBxx8sq")
MAX_DATA_BYTES = 8
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFF_FFFF


class FrameFlag(IntFlag):
    """What kind of frame a record holds."""

    EXTENDED = 1  # 29-bit identifier
    REMOTE = 2
    ERROR = 4  # no frame but the controller's report, see `bus_errors`
    LOST = 8  # no frame but the count of frames that the kernel had no room for
    FOREIGN = 16  # bytes on the bus that are no classical frame


class CanFrame(msgspec.Struct, frozen=True, gc=False):
    """One frame on a bus, or a report about the bus."""

    identifier: int
    data: bytes
    flags: int = 0
    stamp_ns: int = 0  # raw monotonic; 0 where the interface does not know

    @property
    def is_data(self) -> bool:
        """True for a frame that carries data: no request, no report."""
        return not self.flags & ~int(FrameFlag.EXTENDED)

    @property
    def key(self) -> int:
        """The identifier, with bit 31 for the extended kind, as in DBC files."""
        return self.identifier | (self.flags & 1) << 31


def pack_frames(frames: Iterable[CanFrame]) -> bytes:
    """Return frames as records, one after the other.

    Raises:
        UsageError: a frame has more than 8 bytes, or an identifier that no frame can have.
    """
    packed: list[bytes] = []
    for frame in frames:
        if len(frame.data) > MAX_DATA_BYTES:
            raise UsageError(f"a CAN frame of {len(frame.data)} bytes", "8 fit")
        try:
            record = RECORD.pack(
                frame.identifier, frame.flags, len(frame.data), frame.data, frame.stamp_ns
            )
        except struct.error as fault:
            raise UsageError("a value does not fit into a CAN frame", str(fault)) from fault
        packed.append(record)
    return b"".join(packed)


def unpack_frames(records: bytes, received_ns: int) -> list[CanFrame]:
    """Return the frames of whole records.

    Args:
        records: whole records; a last one that is cut is left out.
        received_ns: raw monotonic stamp of the read call, for frames without one of their own.
    """
    whole = len(records) - len(records) % RECORD.size
    return [
        CanFrame(identifier, data[:length], flags, stamp_ns or received_ns)
        for identifier, flags, length, data, stamp_ns in RECORD.iter_unpack(records[:whole])
    ]
