"""Put an MCAP file together from chunks: the records around them, indexes, the summary.

What to use when: under `part_file`, whose chunks are new, and under `salvage`, whose chunks
are copied packed as they are; what can be derived from a chunk (times, indexes, statistics)
is made here, because in a file it carries no checksum.

Source: the MCAP format specification, sections "Records" and "Summary Section".
"""

import struct
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment as AttachmentRecord,
)
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from gyrorig_protocol.recording.disk_file import DiskFile
from gyrorig_protocol.recording.head import Attachment
from gyrorig_protocol.recording.summary import MAGIC

_INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries

IndexEntries = npt.NDArray[np.uint64]  # (n, 2): log time, offset in the unpacked chunk


@dataclass(frozen=True, slots=True)
class ReadyChunk:
    """One chunk as it goes into the file."""

    compression: str
    packed: bytes
    unpacked_size: int
    crc: int
    index: Mapping[int, IndexEntries]  # by channel


class Assembly:
    """An MCAP file in the making.

    Raises:
        OSError: from every method, as the disk reports it.
    """

    def __init__(self, file: DiskFile) -> None:
        self._file = file
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        # Packed as they will be written: of 45 channels an object takes 4 kB, this 0.5 kB.
        self._chunk_indexes = bytearray()
        self._chunks = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0

    def start(self, library: str) -> None:
        """Write the beginning."""
        self._file.write(MAGIC)
        self._put(Header("ros2", library))

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset = self._file.tell()
        length = self._put(Metadata(name, dict(record)))
        self._metadata.append(MetadataIndex(offset, length, name))

    def add_attachment(self, one: Attachment) -> None:
        """Write an attachment."""
        offset, time_ns = self._file.tell(), one.log_time_ns
        record = AttachmentRecord(time_ns, time_ns, one.name, one.media_type, one.data)
        length = self._put(record)
        self._attachments.append(
            AttachmentIndex(
                offset, length, time_ns, time_ns, len(one.data), one.name, one.media_type
            )
        )

    def know(self, schema: Schema, channel: Channel) -> None:
        """Take note of a channel that a chunk declares."""
        self._schemas.setdefault(schema.id, schema)
        self._channels.setdefault(channel.id, channel)

    @staticmethod
    def declaration(schema: Schema, channel: Channel) -> bytes:
        """The records that declare a channel, for a chunk that is being filled."""
        return _bytes_of(schema) + _bytes_of(channel)

    def declare_schema(self, schema: Schema) -> None:
        """Write a schema that no chunk declares any more."""
        self._put(schema)

    def declare(self, schema: Schema, channel: Channel) -> None:
        """Write a channel that no chunk declares any more."""
        self.declare_schema(schema)
        self._put(channel)
        self.know(schema, channel)

    def knows(self, channel: int) -> bool:
        """Whether a channel has been declared."""
        return channel in self._channels

    def add_chunk(self, chunk: ReadyChunk) -> None:
        """Write a chunk that holds at least one message, and its indexes."""
        times = np.concatenate([entries[:, 0] for entries in chunk.index.values()])
        first_ns, last_ns = int(times.min()), int(times.max())
        start = self._file.tell()
        record = Chunk(
            compression=chunk.compression,
            data=chunk.packed,
            message_end_time=last_ns,
            message_start_time=first_ns,
            uncompressed_crc=chunk.crc,
            uncompressed_size=chunk.unpacked_size,
        )
        written = bytearray(_bytes_of(record))
        length = len(written)
        offsets: dict[int, int] = {}
        for channel, entries in chunk.index.items():
            offsets[channel] = start + len(written)
            content = entries.astype("<u8", copy=False).tobytes()
            written += _INDEX_HEAD.pack(
                Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)
            )
            written += content
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
        self._file.write(bytes(written))
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=chunk.compression,
            compressed_size=len(chunk.packed),
            message_end_time=last_ns,
            message_index_length=len(written) - length,
            message_index_offsets=offsets,
            message_start_time=first_ns,
            uncompressed_size=chunk.unpacked_size,
        )
        self._chunk_indexes += _bytes_of(index)
        self._chunks += 1
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)

    def finish(self) -> None:
        """Write the summary and the end."""
        self._put(DataEnd(0))
        start = self._file.tell()
        groups: list[tuple[int, bytes | bytearray]] = [
            (Opcode.SCHEMA, _all_of(self._schemas.values())),
            (Opcode.CHANNEL, _all_of(self._channels.values())),
            (Opcode.STATISTICS, _bytes_of(self._statistics())),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, _all_of(self._attachments)),
            (Opcode.METADATA_INDEX, _all_of(self._metadata)),
        ]
        summary = bytearray()
        offsets: list[SummaryOffset] = []
        for opcode, records in groups:
            offsets.append(SummaryOffset(opcode, start + len(summary), len(records)))
            summary += records
        offsets_start = start + len(summary)
        summary += _all_of(offsets)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._file.write(bytes(summary))
        self._put(Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=crc))
        self._file.write(MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, record: McapRecord) -> int:
        data = _bytes_of(record)
        self._file.write(data)
        return len(data)


def _all_of(records: Iterable[McapRecord]) -> bytes:
    return b"".join(_bytes_of(record) for record in records)


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
