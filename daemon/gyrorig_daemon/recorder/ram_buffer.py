"""A bounded first-in, first-out buffer in memory for messages, while the disk fails.

What to use when: under `part_writer`. Beyond its limits the buffer drops the oldest messages, a
block at a time, and counts them. Full blocks are compressed: 64 MiB hold about 100 s of 16
boards at 800 Hz.
"""

import struct
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import zstandard

BLOCK_BYTES = 256 * 1024
_HEADER = struct.Struct("<HqqII")  # topic's number, log time, publish time, sequence, length


class Record(NamedTuple):
    """One message on its way to a file."""

    topic: str
    type: str
    payload: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(frozen=True, slots=True)
class _Block:
    packed: bytes
    count: int
    last_log_ns: int


class RamBuffer:
    """A bounded first-in, first-out buffer of messages."""

    def __init__(self, max_bytes: int, max_s: float) -> None:
        self._max_bytes = max_bytes
        self._max_ns = int(max_s * 1e9)
        self._topics: dict[tuple[str, str], int] = {}
        self._names: list[tuple[str, str]] = []
        self._front_records: deque[Record] = deque()  # oldest: pushed back, or unpacked
        self._blocks: deque[_Block] = deque()
        self._packed_bytes = 0
        self._open_block = bytearray()
        self._open_count = 0
        self._latest_ns = 0
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._decompressor = zstandard.ZstdDecompressor()
        self._count = 0
        self.dropped = 0

    def __len__(self) -> int:
        """Number of messages."""
        return self._count

    @property
    def bytes(self) -> int:
        """Memory of the packed messages; an unpacked block is not counted."""
        return self._packed_bytes + len(self._open_block)

    def append(self, record: Record) -> None:
        """Add the newest message."""
        key = (record.topic, record.type)
        number = self._topics.get(key)
        if number is None:
            number = self._topics[key] = len(self._names)
            self._names.append(key)
        payload = record.payload
        self._open_block += _HEADER.pack(
            number, record.log_ns, record.publish_ns, record.sequence, len(payload)
        )
        self._open_block += payload
        self._open_count += 1
        self._count += 1
        self._latest_ns = max(self._latest_ns, record.log_ns)
        if len(self._open_block) >= BLOCK_BYTES:
            self._compress_block()
            self._drop_oldest()

    def push_front(self, records: deque[Record]) -> None:
        """Put messages in front that were taken out, or never added; oldest first."""
        self._front_records.extendleft(reversed(records))
        self._count += len(records)

    def pop(self) -> Record | None:
        """Remove and return the oldest message, None if there is none."""
        if not self._front_records:
            self._unpack()
            if not self._front_records:
                return None
        self._count -= 1
        return self._front_records.popleft()

    def _unpack(self) -> None:
        if self._blocks:
            block = self._blocks.popleft()
            self._packed_bytes -= len(block.packed)
            data = self._decompressor.decompress(block.packed)
        else:
            data = bytes(self._open_block)
            self._open_block.clear()
            self._open_count = 0
        offset = 0
        while offset < len(data):
            number, log_ns, publish_ns, sequence, size = _HEADER.unpack_from(data, offset)
            offset += _HEADER.size
            payload = data[offset : offset + size]
            offset += size
            topic, kind = self._names[number]
            self._front_records.append(Record(topic, kind, payload, log_ns, publish_ns, sequence))

    def _compress_block(self) -> None:
        packed = self._compressor.compress(bytes(self._open_block))
        self._blocks.append(_Block(packed, self._open_count, self._latest_ns))
        self._packed_bytes += len(packed)
        self._open_block.clear()
        self._open_count = 0

    def _drop_oldest(self) -> None:
        """Enforce the limits; what is in front is older than every block and is dropped first."""
        while self._blocks and self._exceeds_limits():
            if self._front_records:
                self._count_dropped(len(self._front_records))
                self._front_records.clear()
                continue
            block = self._blocks.popleft()
            self._packed_bytes -= len(block.packed)
            self._count_dropped(block.count)

    def _exceeds_limits(self) -> bool:
        oldest_ns = (
            self._front_records[-1].log_ns if self._front_records else self._blocks[0].last_log_ns
        )
        return self.bytes > self._max_bytes or self._latest_ns - oldest_ns > self._max_ns

    def _count_dropped(self, count: int) -> None:
        self._count -= count
        self.dropped += count
