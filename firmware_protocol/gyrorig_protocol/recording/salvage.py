"""Make a finished recording of one that was never finished.

What to use when: `salvage` writes everything that is sound in a `.part` into a new file;
`read_strictly` has a reader that is not ours, mcap's own, go through the result with all
checksums on, because a file must not be called recovered on the word of its maker;
`is_finished` and `metadata_of` look at a file without reading its messages into memory.

Chunks are copied packed, as they are, so that no message can change on the way.

Source: reliability.md section 1: `mcap recover` can exit 0 and leave an unreadable file.
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
from gyrorig_protocol.recording.assembly import Assembly, IndexEntries, ReadyChunk
from gyrorig_protocol.recording.chunks import (
    ChunkError,
    Offsets,
    Unpacker,
    gather,
    open_chunk,
)
from gyrorig_protocol.recording.copies import (
    MEDIA_TYPE,
    METADATA_COPY,
    Metadata,
    metadata_copy,
    read_channels,
    read_metadata,
)
from gyrorig_protocol.recording.definitions import Channel, Declared, Schema
from gyrorig_protocol.recording.disk_file import DISK, Disk, DiskFile
from gyrorig_protocol.recording.fields import Buffer
from gyrorig_protocol.recording.framing import AttachmentRecord, ChunkRecord, Walk, walk
from gyrorig_protocol.recording.head import FORMAT, Attachment, software
from gyrorig_protocol.recording.losses import Loss, LossCause
from gyrorig_protocol.recording.mapped import Passage, map_file
from gyrorig_protocol.recording.summary import MAGIC, read_summary

RECOVERED = "gyrorig.recovered"  # the metadata record that links a file to what it was made of
_LOG_TIME_AT = 15  # in a message record: behind opcode, length, channel and sequence
_FRAME_BYTES = 9
_AGAIN = "the disk may be failing: copy its folder elsewhere and run gyrorigd recover there"
_QOS = {"offered_qos_profiles": ""}
_FREE_NUMBERS = 60_000  # of schemas that no chunk declares: above all that a writer gives


@dataclass(frozen=True, slots=True)
class Salvaged:
    """What was found in the unfinished file, and is in the new one."""

    messages: Mapping[str, int]  # by topic
    chunks: int
    lost_bytes: int
    losses: tuple[Loss, ...]


def salvage(source: Path, target: Path, about: Mapping[str, str], disk: Disk = DISK) -> Salvaged:
    """Write everything sound in `source` into the new file `target`, and sync it.

    Args:
        source: a recording that may be cut or damaged anywhere.
        target: must not exist; it is deleted again where anything goes wrong.
        about: goes into the metadata record `gyrorig.recovered`, beside the counts.
        disk: where `target` is.

    Raises:
        InputError: there is nothing to recover in `source`.
        MachineError: this computer cannot read or write.
    """
    data = map_file(source)
    if data[: len(MAGIC)] != MAGIC:
        raise InputError(
            f"{source} is no MCAP file, so nothing in it can be recovered", "move it away"
        )
    found = walk(data, read_summary(data))
    metadata = read_metadata(found.attachments) or dict(found.metadata)
    if metadata.get("gyrorig", {}).get("format") != FORMAT:
        raise InputError(
            f"{source} holds no metadata of format {FORMAT}, so it cannot be used", "record again"
        )
    worker = Copying(source, data, found)
    if not any(True for _ in worker.sound_chunks()):
        raise InputError(
            f"{source} holds no whole message, so there is nothing to recover in it", "record again"
        )
    worker = Copying(source, data, found)
    try:
        file = disk.create(target)
        try:
            result = worker.write(file, metadata, about)
            file.sync()
        except BaseException:
            disk.unlink(target)
            raise
        finally:
            file.close()
    except OSError as fault:
        raise MachineError(
            f"cannot write {target}: {fault.strerror}",
            f"make room, or look at the disk, and recover again: {source.name} is as it was",
        ) from fault
    return result


class Copying:
    """One way through a file, whose sound chunks go into another as they are."""

    def __init__(self, source: Path, data: memoryview, found: Walk) -> None:
        self._source, self._data, self._found = source, data, found
        self._known = read_channels(found.attachments)
        self._known.fill_from(found.declared)
        self.losses = list(found.losses)
        self.messages: Counter[str] = Counter()
        self._schemas: dict[int, Schema] = {}  # declared in what has been copied

    def write(self, file: DiskFile, metadata: Metadata, about: Mapping[str, str]) -> Salvaged:
        """Write the new file."""
        out = Assembly(file)
        out.start(software())
        chunks = 0
        for name, record in metadata.items():
            out.add_metadata(name, record)
        for one in self._found.attachments:
            if one.name != METADATA_COPY:
                out.add_attachment(_again(one))
        for ready, declared in self.sound_chunks():
            self.declare(out, ready, declared)
            out.add_chunk(ready)
            chunks += 1
        lost_bytes = sum(loss.bytes for loss in self.losses)
        recovered = dict(about) | {
            "messages": str(sum(self.messages.values())),
            "original_bytes": str(len(self._data)),
            "lost_bytes": str(lost_bytes),
            "software": software(),
        }
        out.add_metadata(RECOVERED, recovered)
        copy = metadata_copy({**metadata, RECOVERED: recovered})
        out.add_attachment(Attachment(METADATA_COPY, MEDIA_TYPE, copy))
        out.finish()
        return Salvaged(dict(self.messages), chunks, lost_bytes, tuple(self.losses))

    def sound_chunks(self) -> Iterator[tuple[ReadyChunk, Declared]]:
        """Every chunk that can be used, in order, and what it declares; states what cannot."""
        unpacker, passage = Unpacker(), Passage(self._data)
        for chunk in self._found.chunks:
            passage.reached(chunk.offset)
            try:
                unpacked = unpacker.unpack(chunk, self._data)
                content = open_chunk(chunk, unpacked, self._data)
            except ChunkError as fault:
                self._lose(chunk, fault)
                continue
            offsets = {number: at for number, at in content.offsets.items() if len(at)}
            if not offsets:
                continue
            self._known.fill_from(content.declared)
            ready = ReadyChunk(
                chunk.compression,
                bytes(self._data[chunk.data_start : chunk.data_end]),
                chunk.unpacked_size,
                chunk.crc,
                {number: _entries(unpacked, at) for number, at in offsets.items()},
            )
            declared = content.declared
            used = offsets.keys() | declared.channels.keys()
            if unknown := {number for number in used if not self._is_known(number)}:
                ready, declared = self._without(chunk, ready, unpacked, unknown), Declared()
            for number, entries in ready.index.items():
                self.messages[self._known.channels[number].topic] += len(entries)
            if ready.index:
                yield ready, declared

    def _without(
        self, chunk: ChunkRecord, ready: ReadyChunk, unpacked: Buffer, unknown: set[int]
    ) -> ReadyChunk:
        """The chunk anew, without the messages of channels that nothing declares any more."""
        index: dict[int, IndexEntries] = {}
        content = bytearray()
        for number, entries in ready.index.items():
            if number in unknown:
                text = f"{len(entries)} messages of channel {number}, which nothing declares"
                self.losses.append(Loss(LossCause.DAMAGED, chunk.offset, 0, len(entries), text))
                continue
            moved = entries.copy()
            for place, at in enumerate(int(offset) for offset in entries[:, 1]):
                moved[place, 1] = len(content)
                length = int.from_bytes(unpacked[at + 1 : at + _FRAME_BYTES], "little")
                content += unpacked[at : at + _FRAME_BYTES + length]
            index[number] = moved
        packed = zstandard.compress(bytes(content))
        return ReadyChunk("zstd", packed, len(content), zlib.crc32(content), index)

    def _is_known(self, number: int) -> bool:
        channel = self._known.channels.get(number)
        return channel is not None and channel.schema_id in self._known.schemas

    def _lose(self, chunk: ChunkRecord, fault: ChunkError) -> None:
        text = f"the chunk at byte {chunk.offset} cannot be used: {fault}"
        self.losses.append(
            Loss(fault.cause, chunk.offset, chunk.size, chunk.indexed_messages, text)
        )

    def declare(self, out: Assembly, ready: ReadyChunk, declared: Declared) -> None:
        """Make sure that every channel of a chunk, and its schema, stands at it or before it."""
        self._schemas |= declared.schemas
        for number, channel in declared.channels.items():
            if channel.schema_id not in self._schemas:  # it stood in a chunk that is lost
                copy = self._known.schemas[self._known.channels[number].schema_id]
                self._schemas[channel.schema_id] = copy
                out.declare_schema(_schema_record(channel.schema_id, copy))
            schema = _schema_record(channel.schema_id, self._schemas[channel.schema_id])
            out.know(schema, _channel_record(number, channel, channel.schema_id))
        for number in ready.index:
            if not out.knows(number):
                self._declare_from_copy(out, number)

    def _declare_from_copy(self, out: Assembly, number: int) -> None:
        channel = self._known.channels[number]
        schema = self._known.schemas[channel.schema_id]
        # Copies of channels carry no number of their schema: ours is below zero there.
        schema_id = channel.schema_id if channel.schema_id > 0 else _FREE_NUMBERS + number
        out.declare(_schema_record(schema_id, schema), _channel_record(number, channel, schema_id))


def _schema_record(number: int, schema: Schema) -> SchemaRecord:
    return SchemaRecord(number, schema.data, schema.encoding, schema.name)


def _channel_record(number: int, channel: Channel, schema_id: int) -> ChannelRecord:
    return ChannelRecord(number, channel.topic, channel.encoding, _QOS, schema_id)


def is_finished(path: Path) -> bool:
    """Whether a file has a summary, and neither our reader nor mcap's finds anything wrong.

    Both, because mcap's looks only at what the summary points to: behind a power cut the
    end may be on the disk and pages in the middle not.

    Raises:
        MachineError: this computer cannot read it.
    """
    try:
        data = map_file(path)
        summary = read_summary(data)
        if not summary.sound:
            return False
        found = walk(data, summary)
        worker = Copying(path, data, found)
        for _ in worker.sound_chunks():
            pass
        if worker.losses or sum(worker.messages.values()) != summary.messages:
            return False
        if read_metadata(found.attachments) != dict(found.metadata):
            return False
        read_strictly(path)
    except InputError:
        return False
    return True


def metadata_of(path: Path) -> Metadata:
    """The metadata of a recording; empty where there is none.

    Raises:
        InputError: there is no such file.
        MachineError: this computer cannot read it.
    """
    data = map_file(path)
    found = walk(data, read_summary(data))
    return read_metadata(found.attachments) or dict(found.metadata)


def read_strictly(path: Path) -> dict[str, int]:
    """Go through a finished file with mcap's own reader, every checksum on.

    Returns:
        How many messages each topic holds.

    Raises:
        InputError: the reader finds anything wrong, or its counts differ from the summary.
    """
    counts: Counter[str] = Counter()
    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            summary = reader.get_summary()
            if summary is None or summary.statistics is None or not summary.chunk_indexes:
                raise InputError(f"{path} has no summary: it was not finished", _AGAIN)
            for _, channel, _ in reader.iter_messages(log_time_order=False):
                counts[channel.topic] += 1
            attached = sum(1 for _ in reader.iter_attachments())
            records = sum(1 for _ in reader.iter_metadata())
    except (McapError, struct.error, ValueError, zstandard.ZstdError, RuntimeError) as fault:
        raise InputError(f"{path} is not sound: {fault}", _AGAIN) from fault
    except OSError as fault:
        raise MachineError(
            f"cannot read {path}: {fault.strerror}", "mend its rights, or look at its disk"
        ) from fault
    told = summary.statistics
    said = (told.message_count, told.attachment_count, told.metadata_count)
    if said != (sum(counts.values()), attached, records):
        raise InputError(f"{path} holds not what its summary counts", _AGAIN)
    return dict(counts)


def _again(one: AttachmentRecord) -> Attachment:
    return Attachment(one.name, one.media_type, one.data, one.log_time_ns)


def _entries(unpacked: Buffer, offsets: Offsets) -> IndexEntries:
    times = gather(unpacked, 8, offsets + _LOG_TIME_AT).view("<u8")
    return np.column_stack([times, offsets.astype(np.uint64)])
