"""Copy of a recording with additional topics.

What to use when: `copy_with_topics` to add computed messages to a recording. The chunks of the
recording are copied in compressed form, so that no message can change. New messages are in separate
chunks, each after the chunk of the same time, so that a player finds them quickly.
"""

import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.records import Channel, Schema

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.recording.backup_copies import (
    COPY_MEDIA_TYPE,
    METADATA_COPY,
    encode_metadata_copy,
    read_metadata_copy,
)
from gyrorig_protocol.recording.mcap.declarations import Declarations
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk, DiskFile
from gyrorig_protocol.recording.mcap.losses import Loss
from gyrorig_protocol.recording.mcap.mapped_file import map_mcap_file
from gyrorig_protocol.recording.mcap.mcap_builder import McapBuilder, PackedChunk
from gyrorig_protocol.recording.mcap.mcap_summary import read_summary
from gyrorig_protocol.recording.mcap.record_scan import FileScan, scan_records
from gyrorig_protocol.recording.recording_metadata import (
    FORMAT_VERSION,
    Attachment,
    software_version,
)
from gyrorig_protocol.recording.salvage import ChunkCopier, to_attachment

_QOS = {"offered_qos_profiles": ""}
_RECORD_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
_MESSAGE_OPCODE = 0x05
_MESSAGE_FIELDS_BYTES = 22  # of a message record, between length and payload
MESSAGES_PER_CHUNK = 3000  # about 1 MiB of `sensor_msgs/msg/Imu`


@dataclass(frozen=True, slots=True, eq=False)
class MessageBatch:
    """Messages of one topic, in the order of their log times."""

    log_time_ns: npt.NDArray[np.int64]  # (n,)
    publish_time_ns: npt.NDArray[np.int64]  # (n,)
    payloads: npt.NDArray[np.uint8]  # (n, bytes of one payload with its header)


@dataclass(frozen=True, slots=True)
class NewTopic:
    """A topic to add."""

    topic: str
    type: str
    schema: str  # ros2msg text with its dependencies
    batches: Iterator[MessageBatch]  # in the order of log times, none empty


@dataclass(frozen=True, slots=True)
class CopyResult:
    """The content of a copy."""

    chunks: int  # of the original
    added: Mapping[str, int]  # messages by topic
    losses: tuple[Loss, ...]  # damaged data of the original, not in the copy


def copy_with_topics(
    source: Path,
    target: Path,
    metadata: Mapping[str, Mapping[str, str]],
    topics: Sequence[NewTopic],
    disk: Disk = DISK,
) -> CopyResult:
    """Write a copy of `source` with additional topics and metadata, completely or not at all.

    Args:
        source: a recording, finished or not.
        target: ends in `.mcap`; must not exist.
        metadata: records to add.
        topics: topics to add.
        disk: where `target` is.

    Raises:
        InputError: `source` is not a recording, or has a topic of that name.
        UsageError: `target` exists, or is not named `.mcap`.
        MachineError: this computer cannot read or write.
    """
    if target.suffix != ".mcap":
        raise UsageError(
            f"the output file {target.name} does not have the name of a recording",
            "choose a name that ends in .mcap",
        )
    part = target.with_name(target.name + ".part")
    for path in (target, part):
        if disk.exists(path):
            raise UsageError(
                f"the output file {path} already exists",
                "choose another name, because a recording is never overwritten",
            )
    data = map_mcap_file(source)
    summary = read_summary(data)
    scan = scan_records(data, summary)
    declarations = summary.declarations if summary.is_valid else _find_declarations(data, scan)
    for channel in declarations.channels.values():
        if channel.topic in {topic.topic for topic in topics}:
            raise InputError(
                f"{source.name} already contains calibrated data (topic {channel.topic})",
                "apply the calibration to the original recording",
            )
    copier = _RecordingCopier(ChunkCopier(data, scan), scan, declarations)
    try:
        file = disk.create(part)
        try:
            result = copier.write(file, source, metadata, topics)
            file.sync()
            disk.rename(part, target)
        except BaseException:
            with suppress(OSError):
                disk.unlink(part)
            raise
        finally:
            file.close()
        disk.sync_directory(target.parent)
    except OSError as fault:
        raise MachineError(
            f"the recording {target} cannot be written ({fault.strerror})",
            "free disk space, or choose another file",
        ) from fault
    return result


def _find_declarations(data: memoryview, scan: FileScan) -> Declarations:
    """Return all declarations in a file without a summary."""
    declarations = Declarations()
    declarations.add_missing_from(scan.declarations)
    for _, chunk_declarations in ChunkCopier(data, scan).valid_chunks():
        declarations.add_missing_from(chunk_declarations)
    return declarations


class _RecordingCopier:
    """Write one copy."""

    def __init__(
        self, chunk_copier: ChunkCopier, scan: FileScan, declarations: Declarations
    ) -> None:
        self._chunk_copier, self._scan = chunk_copier, scan
        self._schema_numbers = count(max(declarations.schemas, default=0) + 1)
        self._channel_numbers = count(max(declarations.channels, default=0) + 1)
        # Level 1 is twice as fast as level 3 and gives 3 % more bytes.
        self._compressor = zstandard.ZstdCompressor(level=1)

    def write(
        self,
        file: DiskFile,
        source: Path,
        metadata: Mapping[str, Mapping[str, str]],
        topics: Sequence[NewTopic],
    ) -> CopyResult:
        records = read_metadata_copy(self._scan.attachments) or dict(self._scan.metadata)
        if records.get("gyrorig", {}).get("format") != FORMAT_VERSION:
            raise InputError(
                f"the MCAP file {source} is not a Gyrorig recording of format {FORMAT_VERSION}",
                "convert its data to a recording with `gyrorig import`",
            )
        records |= {name: dict(record) for name, record in metadata.items()}
        builder = McapBuilder(file)
        builder.write_header(software_version())
        for name, metadata_record in records.items():
            builder.add_metadata(name, metadata_record)
        for record in self._scan.attachments:
            if record.name != METADATA_COPY:
                builder.add_attachment(to_attachment(record))
        builder.add_attachment(
            Attachment(METADATA_COPY, COPY_MEDIA_TYPE, encode_metadata_copy(records))
        )
        writers = [
            _TopicWriter(
                builder,
                topic,
                next(self._schema_numbers),
                next(self._channel_numbers),
                self._compressor,
            )
            for topic in topics
        ]
        chunks = 0
        for packed_chunk, declarations in self._chunk_copier.valid_chunks():
            self._chunk_copier.declare_channels(builder, packed_chunk, declarations)
            builder.add_chunk(packed_chunk)
            chunks += 1
            last_ns = max(int(entries[:, 0].max()) for entries in packed_chunk.index.values())
            for writer in writers:
                writer.write_until(last_ns)
        for writer in writers:
            writer.write_until(None)
        if not chunks:
            raise InputError(
                f"the recording {source} contains no complete message",
                "copy the file from the rig again, or record again",
            )
        builder.finish()
        added = {
            topic.topic: writer.written_count for topic, writer in zip(topics, writers, strict=True)
        }
        return CopyResult(chunks, added, tuple(self._chunk_copier.losses))


class _TopicWriter:
    """Write one added topic: split its batches at the recording's chunks and compress them."""

    def __init__(
        self,
        builder: McapBuilder,
        topic: NewTopic,
        schema: int,
        channel: int,
        compressor: zstandard.ZstdCompressor,
    ) -> None:
        self._builder, self._batches, self._compressor = builder, topic.batches, compressor
        self._schema = Schema(schema, topic.schema.encode(), "ros2msg", topic.type)
        self._channel = Channel(channel, topic.topic, "cdr", _QOS, schema)
        self._current_batch: MessageBatch | None = next(self._batches, None)
        self._next_row = 0  # in the current batch
        self.written_count = 0

    def write_until(self, last_ns: int | None) -> None:
        """Write the messages up to a log time, or all remaining ones if it is None."""
        while self._current_batch is not None:
            log_times_ns = self._current_batch.log_time_ns
            end_row = log_times_ns.size
            if last_ns is not None:
                end_row = int(np.searchsorted(log_times_ns, last_ns, side="right"))
            while self._next_row < end_row:
                chunk_end = min(end_row, self._next_row + MESSAGES_PER_CHUNK)
                self._write_chunk(self._current_batch, slice(self._next_row, chunk_end))
                self._next_row = chunk_end
            if self._next_row < log_times_ns.size:
                return
            self._current_batch, self._next_row = next(self._batches, None), 0

    def _write_chunk(self, batch: MessageBatch, rows: slice) -> None:
        declaration = b""
        if not self.written_count:
            declaration = self._builder.encode_declaration(self._schema, self._channel)
            self._builder.register_channel(self._schema, self._channel)
        payloads = batch.payloads[rows]
        size = payloads.shape[1]
        record_heads = np.zeros(len(payloads), dtype=_RECORD_DTYPE)
        record_heads["opcode"], record_heads["length"] = (
            _MESSAGE_OPCODE,
            _MESSAGE_FIELDS_BYTES + size,
        )
        record_heads["channel"] = self._channel.id
        record_heads["sequence"] = (self.written_count + np.arange(len(payloads))) & 0xFFFFFFFF
        record_heads["log_time"] = batch.log_time_ns[rows]
        record_heads["publish_time"] = batch.publish_time_ns[rows]
        records = np.empty((len(payloads), _RECORD_DTYPE.itemsize + size), dtype=np.uint8)
        records[:, : _RECORD_DTYPE.itemsize] = record_heads.view(np.uint8).reshape(
            len(payloads), -1
        )
        records[:, _RECORD_DTYPE.itemsize :] = payloads
        content = declaration + records.tobytes()
        index = np.empty((len(payloads), 2), dtype=np.uint64)
        index[:, 0] = record_heads["log_time"]
        index[:, 1] = len(declaration) + np.arange(len(payloads)) * records.shape[1]
        compressed, crc = self._compressor.compress(content), zlib.crc32(content)
        self._builder.add_chunk(
            PackedChunk("zstd", compressed, len(content), crc, {self._channel.id: index})
        )
        self.written_count += len(payloads)
