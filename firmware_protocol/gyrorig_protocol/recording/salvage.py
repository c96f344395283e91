"""Salvage: make a finished recording of an unfinished or damaged one.

What to use when: `salvage` writes all valid data of a `.part` file into a new file.
`read_strictly` reads the result with mcap's own reader and verifies all checksums, because an
independent reader must confirm a recovery. `is_finished` and `read_file_metadata` examine a file
without reading its messages into memory.

Chunks are copied in compressed form, so that no message can change.

Reason for the check: `mcap recover` can exit with status 0 and leave an unreadable file
(foxglove/mcap, issue 1474).
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema as SchemaRecord

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_protocol.recording.backup_copies import (
    COPY_MEDIA_TYPE,
    METADATA_COPY,
    Metadata,
    encode_metadata_copy,
    read_channels_copy,
    read_metadata_copy,
)
from gyrorig_protocol.recording.mcap.chunk_reader import (
    ChunkDecompressor,
    ChunkError,
    Offsets,
    gather_records,
    locate_messages,
)
from gyrorig_protocol.recording.mcap.declarations import (
    ChannelDeclaration,
    Declarations,
    SchemaDeclaration,
)
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk, DiskFile
from gyrorig_protocol.recording.mcap.losses import Loss, LossCause
from gyrorig_protocol.recording.mcap.mapped_file import PageReleaser, map_file, map_mcap_file
from gyrorig_protocol.recording.mcap.mcap_builder import IndexEntries, McapBuilder, PackedChunk
from gyrorig_protocol.recording.mcap.mcap_summary import read_summary
from gyrorig_protocol.recording.mcap.record_cursor import Buffer
from gyrorig_protocol.recording.mcap.record_scan import (
    AttachmentRecord,
    ChunkRecord,
    FileScan,
    scan_records,
)
from gyrorig_protocol.recording.recording_metadata import (
    FORMAT_VERSION,
    Attachment,
    software_version,
)

RECOVERED_RECORD = "gyrorig.recovered"  # the metadata record that names the original file
_LOG_TIME_OFFSET = 15  # in a message record: after opcode, length, channel and sequence
_FRAME_BYTES = 9
_DISK_REMEDY = (
    "copy the folder to another disk and run gyrorigd recover there, because the present "
    "disk can be failing"
)
_QOS = {"offered_qos_profiles": ""}
_FREE_SCHEMA_NUMBERS = (
    60_000  # for schemas that no chunk declares; larger than the numbers of a writer
)


@dataclass(frozen=True, slots=True)
class SalvageResult:
    """The content of the new file, and the losses."""

    messages: Mapping[str, int]  # by topic
    chunks: int
    lost_bytes: int
    losses: tuple[Loss, ...]


def salvage(
    source: Path, target: Path, recovery_details: Mapping[str, str], disk: Disk = DISK
) -> SalvageResult:
    """Write all valid data of `source` into the new file `target`, and sync it.

    Args:
        source: a recording that can be cut or damaged anywhere.
        target: must not exist; it is deleted again after an error.
        recovery_details: added to the counts in the metadata record `gyrorig.recovered`.
        disk: where `target` is.

    Raises:
        InputError: nothing in `source` can be recovered.
        MachineError: this computer cannot read or write.
    """
    data = map_mcap_file(source)
    scan = scan_records(data, read_summary(data))
    metadata = read_metadata_copy(scan.attachments) or dict(scan.metadata)
    if "gyrorig" not in metadata:
        raise InputError(
            f"{source} cannot be recovered, because it does not contain the settings of a Gyrorig "
            "session",
            "give a recording that the daemon wrote, or record the session again",
        )
    found_format = metadata["gyrorig"].get("format")
    if found_format != FORMAT_VERSION:
        raise InputError(
            f"{source} cannot be recovered, because it has the recording format {found_format}, "
            f"but this version of Gyrorig reads only format {FORMAT_VERSION}",
            "use the version of Gyrorig that wrote the file, or a newer one",
        )
    copier = ChunkCopier(data, scan)
    if not any(True for _ in copier.valid_chunks()):
        raise InputError(
            f"{source} cannot be recovered, because it contains no complete message", "record again"
        )
    copier = ChunkCopier(data, scan)
    try:
        file = disk.create(target)
        try:
            result = copier.write(file, metadata, recovery_details)
            file.sync()
        except BaseException:
            disk.unlink(target)
            raise
        finally:
            file.close()
    except OSError as fault:
        raise MachineError(
            f"the recovered recording {target} cannot be written ({fault.strerror})",
            "free disk space or check the disk, and recover the recording again. "
            f"{source.name} was not changed",
        ) from fault
    return result


class ChunkCopier:
    """One pass through a file, whose valid chunks are copied in compressed form."""

    def __init__(self, data: memoryview, scan: FileScan) -> None:
        self._data, self._scan = data, scan
        self._declarations = read_channels_copy(scan.attachments)
        self._declarations.add_missing_from(scan.declarations)
        self.losses = list(scan.losses)
        self.message_counts: Counter[str] = Counter()
        self._copied_schemas: dict[
            int, SchemaDeclaration
        ] = {}  # declared in the chunks copied so far

    def write(
        self, file: DiskFile, metadata: Metadata, recovery_details: Mapping[str, str]
    ) -> SalvageResult:
        """Write the new file."""
        builder = McapBuilder(file)
        builder.write_header(software_version())
        chunks = 0
        for name, record in metadata.items():
            builder.add_metadata(name, record)
        for attachment in self._scan.attachments:
            if attachment.name != METADATA_COPY:
                builder.add_attachment(to_attachment(attachment))
        for chunk, declarations in self.valid_chunks():
            self.declare_channels(builder, chunk, declarations)
            builder.add_chunk(chunk)
            chunks += 1
        lost_bytes = sum(loss.bytes for loss in self.losses)
        recovered = dict(recovery_details) | {
            "messages": str(sum(self.message_counts.values())),
            "original_bytes": str(len(self._data)),
            "lost_bytes": str(lost_bytes),
            "software": software_version(),
        }
        builder.add_metadata(RECOVERED_RECORD, recovered)
        copy = encode_metadata_copy({**metadata, RECOVERED_RECORD: recovered})
        builder.add_attachment(Attachment(METADATA_COPY, COPY_MEDIA_TYPE, copy))
        builder.finish()
        return SalvageResult(dict(self.message_counts), chunks, lost_bytes, tuple(self.losses))

    def valid_chunks(self) -> Iterator[tuple[PackedChunk, Declarations]]:
        """Yield every valid chunk in order with its declarations; report the others."""
        decompressor, page_releaser = ChunkDecompressor(), PageReleaser(self._data)
        for chunk in self._scan.chunks:
            page_releaser.release_before(chunk.offset)
            try:
                unpacked = decompressor.decompress_chunk(chunk, self._data)
                content = locate_messages(chunk, unpacked, self._data)
            except ChunkError as fault:
                self._report_lost_chunk(chunk, fault)
                continue
            offsets = {
                number: channel_offsets
                for number, channel_offsets in content.offsets.items()
                if len(channel_offsets)
            }
            if not offsets:
                continue
            self._declarations.add_missing_from(content.declarations)
            packed_chunk = PackedChunk(
                chunk.compression,
                bytes(self._data[chunk.data_start : chunk.data_end]),
                chunk.unpacked_size,
                chunk.crc,
                {
                    number: _index_entries(unpacked, channel_offsets)
                    for number, channel_offsets in offsets.items()
                },
            )
            declarations = content.declarations
            used_channels = offsets.keys() | declarations.channels.keys()
            if undeclared := {number for number in used_channels if not self._is_declared(number)}:
                packed_chunk, declarations = (
                    self._drop_channels(chunk, packed_chunk, unpacked, undeclared),
                    Declarations(),
                )
            for number, entries in packed_chunk.index.items():
                self.message_counts[self._declarations.channels[number].topic] += len(entries)
            if packed_chunk.index:
                yield packed_chunk, declarations

    def _drop_channels(
        self, chunk: ChunkRecord, packed_chunk: PackedChunk, unpacked: Buffer, undeclared: set[int]
    ) -> PackedChunk:
        """Rebuild a chunk without the messages of undeclared channels."""
        index: dict[int, IndexEntries] = {}
        content = bytearray()
        for number, entries in packed_chunk.index.items():
            if number in undeclared:
                text = f"{len(entries)} messages of channel {number}, which is not declared"
                self.losses.append(Loss(LossCause.DAMAGED, chunk.offset, 0, len(entries), text))
                continue
            new_entries = entries.copy()
            for row, message_offset in enumerate(int(offset) for offset in entries[:, 1]):
                new_entries[row, 1] = len(content)
                length = int.from_bytes(
                    unpacked[message_offset + 1 : message_offset + _FRAME_BYTES], "little"
                )
                content += unpacked[message_offset : message_offset + _FRAME_BYTES + length]
            index[number] = new_entries
        compressed = zstandard.compress(bytes(content))
        return PackedChunk("zstd", compressed, len(content), zlib.crc32(content), index)

    def _is_declared(self, number: int) -> bool:
        channel = self._declarations.channels.get(number)
        return channel is not None and channel.schema_id in self._declarations.schemas

    def _report_lost_chunk(self, chunk: ChunkRecord, fault: ChunkError) -> None:
        text = f"the chunk at byte {chunk.offset} cannot be used: {fault}"
        self.losses.append(
            Loss(fault.cause, chunk.offset, chunk.size, chunk.indexed_messages, text)
        )

    def declare_channels(
        self, builder: McapBuilder, packed_chunk: PackedChunk, declarations: Declarations
    ) -> None:
        """Write the declarations of a chunk's channels that neither it nor earlier ones have."""
        self._copied_schemas |= declarations.schemas
        for number, channel in declarations.channels.items():
            if channel.schema_id not in self._copied_schemas:  # it was in a lost chunk
                backup = self._declarations.schemas[self._declarations.channels[number].schema_id]
                self._copied_schemas[channel.schema_id] = backup
                builder.add_schema(_schema_record(channel.schema_id, backup))
            schema = _schema_record(channel.schema_id, self._copied_schemas[channel.schema_id])
            builder.register_channel(schema, _channel_record(number, channel, channel.schema_id))
        for number in packed_chunk.index:
            if not builder.is_declared(number):
                self._declare_from_copy(builder, number)

    def _declare_from_copy(self, builder: McapBuilder, number: int) -> None:
        channel = self._declarations.channels[number]
        schema = self._declarations.schemas[channel.schema_id]
        # Copies of channels have no schema number; there it is our negative number.
        schema_id = channel.schema_id if channel.schema_id > 0 else _FREE_SCHEMA_NUMBERS + number
        builder.add_channel(
            _schema_record(schema_id, schema), _channel_record(number, channel, schema_id)
        )


def _schema_record(number: int, schema: SchemaDeclaration) -> SchemaRecord:
    return SchemaRecord(number, schema.data, schema.encoding, schema.name)


def _channel_record(number: int, channel: ChannelDeclaration, schema_id: int) -> ChannelRecord:
    return ChannelRecord(number, channel.topic, channel.encoding, _QOS, schema_id)


def is_finished(path: Path) -> bool:
    """Return whether a file has a summary and is valid for both our reader and mcap's.

    Both are needed, because mcap's reader looks only at the data that the summary points to. After
    a power cut the end of a file can be on the disk without pages in the middle.

    Raises:
        MachineError: this computer cannot read it.
    """
    try:
        data = map_file(path)
        summary = read_summary(data)
        if not summary.is_valid:
            return False
        scan = scan_records(data, summary)
        copier = ChunkCopier(data, scan)
        for _ in copier.valid_chunks():
            pass
        if copier.losses or sum(copier.message_counts.values()) != summary.message_count:
            return False
        if read_metadata_copy(scan.attachments) != dict(scan.metadata):
            return False
        read_strictly(path)
    except InputError:
        return False
    return True


def read_file_metadata(path: Path) -> Metadata:
    """Return the metadata of a recording; empty if it has none.

    Raises:
        InputError: the file does not exist.
        MachineError: this computer cannot read it.
    """
    data = map_file(path)
    scan = scan_records(data, read_summary(data))
    return read_metadata_copy(scan.attachments) or dict(scan.metadata)


def read_strictly(path: Path) -> dict[str, int]:
    """Read a finished file with mcap's own reader and verify all checksums.

    Returns:
        The number of messages of each topic.

    Raises:
        InputError: the file is invalid, or its counts differ from the summary.
    """
    counts: Counter[str] = Counter()
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            if summary is None or summary.statistics is None or not summary.chunk_indexes:
                raise InputError(
                    f"the recording {path} has no summary, because its writer did not finish it",
                    _DISK_REMEDY,
                )
            for _, channel, _ in reader.iter_messages(log_time_order=False):
                counts[channel.topic] += 1
            attachment_count = sum(1 for _ in reader.iter_attachments())
            metadata_count = sum(1 for _ in reader.iter_metadata())
    except (McapError, struct.error, ValueError, zstandard.ZstdError, RuntimeError) as fault:
        raise InputError(f"the recording {path} is damaged ({fault})", _DISK_REMEDY) from fault
    except OSError as fault:
        raise MachineError(
            f"the recording {path} cannot be read ({fault.strerror})",
            "correct the permissions of the file, or check its disk",
        ) from fault
    statistics = summary.statistics
    expected_counts = (
        statistics.message_count,
        statistics.attachment_count,
        statistics.metadata_count,
    )
    if expected_counts != (sum(counts.values()), attachment_count, metadata_count):
        raise InputError(
            f"the recording {path} is damaged: it does not contain as many messages, attachments "
            "and metadata records as its summary states",
            _DISK_REMEDY,
        )
    return dict(counts)


def to_attachment(record: AttachmentRecord) -> Attachment:
    """Convert an attachment that was read to one that can be written."""
    return Attachment(record.name, record.media_type, record.data, record.log_time_ns)


def _index_entries(unpacked: Buffer, offsets: Offsets) -> IndexEntries:
    times = gather_records(unpacked, 8, offsets + _LOG_TIME_OFFSET).view("<u8")
    return np.column_stack([times, offsets.astype(np.uint64)])
