"""The last minutes in memory, while the disk does not take them.

What to use when: under `spool`. Messages come out in the order in which they went in;
beyond its limits the ring forgets the oldest, a block at a time, and counts them. Full
blocks are compressed: 64 MiB hold about 100 s of 16 boards at 800 Hz.
"""

import struct
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import zstandard

BLOCK_BYTES = 256 * 1024
_HEAD = struct.Struct("<HqqII")  # topic's number, log time, publish time, sequence, length


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


class RamRing:
    """A bounded first-in, first-out store of messages."""

    def __init__(self, max_bytes: int, max_s: float) -> None:
        self._max_bytes = max_bytes
        self._max_ns = int(max_s * 1e9)
        self._topics: dict[tuple[str, str], int] = {}
        self._names: list[tuple[str, str]] = []
        self._front: deque[Record] = deque()  # oldest: given back, or a block taken apart
        self._blocks: deque[_Block] = deque()
        self._packed_bytes = 0
        self._open = bytearray()
        self._open_count = 0
        self._latest_ns = 0
        self._zip = zstandard.ZstdCompressor(level=1)
        self._unzip = zstandard.ZstdDecompressor()
        self._count = 0
        self.dropped = 0

    def __len__(self) -> int:
        """How many messages are in it."""
        return self._count

    @property
    def bytes(self) -> int:
        """Memory taken by what is packed; a block taken apart is not counted."""
        return self._packed_bytes + len(self._open)

    def append(self, record: Record) -> None:
        """Take in the newest message."""
        key = (record.topic, record.type)
        number = self._topics.get(key)
        if number is None:
            number = self._topics[key] = len(self._names)
            self._names.append(key)
        payload = record.payload
        self._open += _HEAD.pack(
            number, record.log_ns, record.publish_ns, record.sequence, len(payload)
        )
        self._open += payload
        self._open_count += 1
        self._count += 1
        self._latest_ns = max(self._latest_ns, record.log_ns)
        if len(self._open) >= BLOCK_BYTES:
            self._seal()
            self._forget()

    def give_back(self, records: deque[Record]) -> None:
        """Put messages in front again that were taken out, or never came in; oldest first."""
        self._front.extendleft(reversed(records))
        self._count += len(records)

    def pop(self) -> Record | None:
        """Take out the oldest message, None when there is none."""
        if not self._front:
            self._unpack()
            if not self._front:
                return None
        self._count -= 1
        return self._front.popleft()

    def _unpack(self) -> None:
        if self._blocks:
            block = self._blocks.popleft()
            self._packed_bytes -= len(block.packed)
            data = self._unzip.decompress(block.packed)
        else:
            data = bytes(self._open)
            self._open.clear()
            self._open_count = 0
        at = 0
        while at < len(data):
            number, log_ns, publish_ns, sequence, size = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            payload = data[at : at + size]
            at += size
            topic, kind = self._names[number]
            self._front.append(Record(topic, kind, payload, log_ns, publish_ns, sequence))

    def _seal(self) -> None:
        packed = self._zip.compress(bytes(self._open))
        self._blocks.append(_Block(packed, self._open_count, self._latest_ns))
        self._packed_bytes += len(packed)
        self._open.clear()
        self._open_count = 0

    def _forget(self) -> None:
        """Keep to the limits; what is in front is older than every block and goes first."""
        while self._blocks and self._is_over():
            if self._front:
                self._drop(len(self._front))
                self._front.clear()
                continue
            block = self._blocks.popleft()
            self._packed_bytes -= len(block.packed)
            self._drop(block.count)

    def _is_over(self) -> bool:
        oldest_ns = self._front[-1].log_ns if self._front else self._blocks[0].last_log_ns
        return self.bytes > self._max_bytes or self._latest_ns - oldest_ns > self._max_ns

    def _drop(self, count: int) -> None:
        self._count -= count
        self.dropped += count
