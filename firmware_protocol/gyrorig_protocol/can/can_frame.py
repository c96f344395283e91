"""CAN frames, and their encoding as records of fixed size for a pipe.

What to use when: `CanFrame` for one frame; `pack_frames` and `unpack_frames` for the pipe of the
acquisition process, which carries bytes.

    record, little-endian, 24 bytes
    I   identifier, 11 or 29 bits; in a LOST record: number of frames that the kernel dropped
    B   flags, see `FrameFlag`
    B   length of the data, 0 to 8
    2x
    8s  data, padded with zeros
    q   time on the bus, raw monotonic ns of the host, as precise as the interface reports it;
        0 if it does not: then the timestamp of the read call is used

Only classical frames, because no board here sends CAN FD. The reader of the bus counts frames with
more than 8 bytes as foreign.
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
    """The kind of frame in a record."""

    EXTENDED = 1  # 29-bit identifier
    REMOTE = 2
    ERROR = 4  # a report of the controller, see `bus_errors`
    LOST = 8  # a count of frames that the kernel dropped because its buffer was full
    FOREIGN = 16  # not a classical frame


class CanFrame(msgspec.Struct, frozen=True, gc=False):
    """One frame on a bus, or a report about the bus."""

    identifier: int
    data: bytes
    flags: int = 0
    timestamp_ns: int = 0  # raw monotonic; 0 if the interface does not report it

    @property
    def is_data_frame(self) -> bool:
        """True for a frame with data; False for a request or a report."""
        return not self.flags & ~int(FrameFlag.EXTENDED)

    @property
    def key(self) -> int:
        """The identifier with bit 31 set for an extended identifier, as in DBC files."""
        return self.identifier | (self.flags & 1) << 31


def pack_frames(frames: Iterable[CanFrame]) -> bytes:
    """Return frames as records, one after the other.

    Raises:
        UsageError: a frame has more than 8 bytes, or its identifier is out of range.
    """
    records: list[bytes] = []
    for frame in frames:
        if len(frame.data) > MAX_DATA_BYTES:
            raise UsageError(
                f"the CAN frame is too long: it has {len(frame.data)} data bytes",
                "send at most 8 data bytes in one frame",
            )
        try:
            record = RECORD.pack(
                frame.identifier, frame.flags, len(frame.data), frame.data, frame.timestamp_ns
            )
        except struct.error as fault:
            raise UsageError(
                f"a value does not fit into its field of the CAN frame ({fault})",
                "give a value within the range of the field",
            ) from fault
        records.append(record)
    return b"".join(records)


def unpack_frames(records: bytes, received_ns: int) -> list[CanFrame]:
    """Return the frames of whole records.

    Args:
        records: complete records; an incomplete last one is ignored.
        received_ns: raw monotonic timestamp of the read call, for frames without a timestamp.
    """
    whole_bytes = len(records) - len(records) % RECORD.size
    return [
        CanFrame(identifier, data[:length], flags, timestamp_ns or received_ns)
        for identifier, flags, length, data, timestamp_ns in RECORD.iter_unpack(
            records[:whole_bytes]
        )
    ]
