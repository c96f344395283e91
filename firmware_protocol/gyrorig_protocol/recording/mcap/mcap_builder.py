"""MCAP builder: write the records around chunks, the indexes and the summary of a file.

What to use when: in `part_file`, which writes new chunks, and in `salvage`, which copies packed
chunks without change. Values that follow from a chunk (times, indexes, statistics) are computed
here, because they have no checksum in a file.

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

from gyrorig_protocol.recording.mcap.disk_file import DiskFile
from gyrorig_protocol.recording.mcap.mcap_summary import MAGIC
from gyrorig_protocol.recording.recording_metadata import Attachment

_INDEX_HEAD_LAYOUT = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries

IndexEntries = npt.NDArray[np.uint64]  # (n, 2): log time, offset in the unpacked chunk


@dataclass(frozen=True, slots=True)
class PackedChunk:
    """One compressed chunk to be written."""

    compression: str
    compressed: bytes
    unpacked_size: int
    crc: int
    index: Mapping[int, IndexEntries]  # by channel


class McapBuilder:
    """An MCAP file that is being written.

    Raises:
        OSError: from every method, as the disk reports it.
    """

    def __init__(self, file: DiskFile) -> None:
        self._file = file
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        # Encoded as they will be written: with 45 channels an object has 4 kB, this has 0.5 kB.
        self._chunk_indexes = bytearray()
        self._chunk_count = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._message_counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0

    def write_header(self, library: str) -> None:
        """Write the magic and the header."""
        self._file.write(MAGIC)
        self._write_record(Header("ros2", library))

    def add_metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset = self._file.tell()
        length = self._write_record(Metadata(name, dict(record)))
        self._metadata.append(MetadataIndex(offset, length, name))

    def add_attachment(self, attachment: Attachment) -> None:
        """Write an attachment."""
        offset, time_ns = self._file.tell(), attachment.log_time_ns
        record = AttachmentRecord(
            time_ns, time_ns, attachment.name, attachment.media_type, attachment.data
        )
        length = self._write_record(record)
        self._attachments.append(
            AttachmentIndex(
                offset,
                length,
                time_ns,
                time_ns,
                len(attachment.data),
                attachment.name,
                attachment.media_type,
            )
        )

    def register_channel(self, schema: Schema, channel: Channel) -> None:
        """Register a channel that a chunk declares."""
        self._schemas.setdefault(schema.id, schema)
        self._channels.setdefault(channel.id, channel)

    @staticmethod
    def encode_declaration(schema: Schema, channel: Channel) -> bytes:
        """Return the records that declare a channel, for a chunk that is being filled."""
        return _encode_record(schema) + _encode_record(channel)

    def add_schema(self, schema: Schema) -> None:
        """Write a schema that no chunk declares."""
        self._write_record(schema)

    def add_channel(self, schema: Schema, channel: Channel) -> None:
        """Write a channel and its schema that no chunk declares."""
        self.add_schema(schema)
        self._write_record(channel)
        self.register_channel(schema, channel)

    def is_declared(self, channel: int) -> bool:
        """Return whether a channel is declared."""
        return channel in self._channels

    def add_chunk(self, chunk: PackedChunk) -> None:
        """Write a chunk with at least one message, and its indexes."""
        log_times = np.concatenate([entries[:, 0] for entries in chunk.index.values()])
        first_ns, last_ns = int(log_times.min()), int(log_times.max())
        start = self._file.tell()
        record = Chunk(
            compression=chunk.compression,
            data=chunk.compressed,
            message_end_time=last_ns,
            message_start_time=first_ns,
            uncompressed_crc=chunk.crc,
            uncompressed_size=chunk.unpacked_size,
        )
        written = bytearray(_encode_record(record))
        length = len(written)
        offsets: dict[int, int] = {}
        for channel, entries in chunk.index.items():
            offsets[channel] = start + len(written)
            content = entries.astype("<u8", copy=False).tobytes()
            written += _INDEX_HEAD_LAYOUT.pack(
                Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)
            )
            written += content
            self._message_counts[channel] = self._message_counts.get(channel, 0) + len(entries)
        self._file.write(bytes(written))
        index = ChunkIndex(
            chunk_length=length,
            chunk_start_offset=start,
            compression=chunk.compression,
            compressed_size=len(chunk.compressed),
            message_end_time=last_ns,
            message_index_length=len(written) - length,
            message_index_offsets=offsets,
            message_start_time=first_ns,
            uncompressed_size=chunk.unpacked_size,
        )
        self._chunk_indexes += _encode_record(index)
        self._chunk_count += 1
        self._first_ns = first_ns if self._first_ns is None else min(self._first_ns, first_ns)
        self._last_ns = max(self._last_ns, last_ns)

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._write_record(DataEnd(0))
        summary_start = self._file.tell()
        groups: list[tuple[int, bytes | bytearray]] = [
            (Opcode.SCHEMA, _encode_records(self._schemas.values())),
            (Opcode.CHANNEL, _encode_records(self._channels.values())),
            (Opcode.STATISTICS, _encode_record(self._statistics())),
            (Opcode.CHUNK_INDEX, self._chunk_indexes),
            (Opcode.ATTACHMENT_INDEX, _encode_records(self._attachments)),
            (Opcode.METADATA_INDEX, _encode_records(self._metadata)),
        ]
        summary = bytearray()
        offsets: list[SummaryOffset] = []
        for opcode, records in groups:
            offsets.append(SummaryOffset(opcode, summary_start + len(summary), len(records)))
            summary += records
        offsets_start = summary_start + len(summary)
        summary += _encode_records(offsets)
        footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._file.write(bytes(summary))
        self._write_record(
            Footer(summary_start=summary_start, summary_offset_start=offsets_start, summary_crc=crc)
        )
        self._file.write(MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._message_counts),
            chunk_count=self._chunk_count,
            message_count=sum(self._message_counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _write_record(self, record: McapRecord) -> int:
        data = _encode_record(record)
        self._file.write(data)
        return len(data)


def _encode_records(records: Iterable[McapRecord]) -> bytes:
    return b"".join(_encode_record(record) for record in records)


def _encode_record(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
