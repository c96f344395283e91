"""Topic collector: collect the messages of a file's chunks by topic.

What to use when: only in `reader`, one `TopicCollector` per pass through a file.

Samples are kept as complete records, whose fields are views, if the chunks of the file are small
enough together. Otherwise they are kept as columns (`imu_columns`).
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.channel_arrays import (
    FixedSizeChannel,
    StoredMessage,
    VariableSizeChannel,
)
from gyrorig_protocol.recording.encoding.message_layouts import FIXED_LAYOUTS, has_fields_of_format
from gyrorig_protocol.recording.imu_columns import SOLVER_FIELDS, ImuColumnsChannel
from gyrorig_protocol.recording.mcap.chunk_reader import (
    MAX_UNPACKED_BYTES,
    RECORD_BYTES,
    ChunkDecompressor,
    ChunkError,
    Offsets,
    locate_messages,
    locate_messages_in_group,
)
from gyrorig_protocol.recording.mcap.declarations import (
    ChannelDeclaration,
    Declarations,
    SchemaDeclaration,
)
from gyrorig_protocol.recording.mcap.losses import Loss, LossCause
from gyrorig_protocol.recording.mcap.mapped_file import PageReleaser
from gyrorig_protocol.recording.mcap.record_cursor import Buffer, MalformedError
from gyrorig_protocol.recording.mcap.record_scan import ChunkRecord, FileScan
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.recording import MESSAGE_TYPES, TimedMessage, Topic

_FOREIGN_FILE_REMEDY = "read the file with the program that wrote it, or record again"
MAX_RECORD_BYTES = 160 << 20  # of unpacked chunks; half an hour of a board at 800 Hz
# All chunks of a file together. Sensor data with noise are packed by 2 to 10 times.
MAX_FILE_RATIO = 20
MIN_UNPACKED_LIMIT_BYTES = 64 << 20
# Messages with text are Python objects of about 450 bytes each.
MIN_TEXT_MESSAGE_LIMIT = 100_000
FILE_BYTES_PER_TEXT_MESSAGE = 30
MAX_UNREAD_NOTES = 64  # for topics that recording format 1 does not define
MAX_GROUP_BYTES = 1 << 19  # of unpacked chunks read together; they fit into the processor's cache


class MultipleChannelsError(Exception):
    """Columns of several channels on one topic; never raised out of this package."""


@dataclass(slots=True)
class _ChannelStore:
    """The store of one channel's messages; None if they are not read."""

    topic: str
    type: str
    store: FixedSizeChannel | ImuColumnsChannel | VariableSizeChannel | None


@dataclass(slots=True)
class _InvalidMessages:
    """Messages of one channel that do not match its schema, or are too many."""

    count: int = 0
    offset: int = 0  # of the chunk of the first such message
    reason: str = ""


@dataclass(slots=True)
class _ChunkGroup:
    """Unpacked chunks that are read together: first one, then more and more.

    Channels are usually declared in the first chunks, and those must be read one by one.
    """

    limit_bytes: int = 1
    size_bytes: int = 0
    waiting: list[tuple[ChunkRecord, Buffer]] = field(default_factory=list)

    @property
    def is_full(self) -> bool:
        return self.size_bytes >= self.limit_bytes

    def add(self, chunk: ChunkRecord, content: Buffer) -> None:
        self.waiting.append((chunk, content))
        self.size_bytes += len(content)

    def take_chunks(self) -> list[tuple[ChunkRecord, Buffer]]:
        """Return the chunks of the group and start a new one."""
        self.limit_bytes = min(max(2 * self.limit_bytes, 2 * self.size_bytes), MAX_GROUP_BYTES)
        group, self.waiting, self.size_bytes = self.waiting, [], 0
        return group


@dataclass(slots=True)
class TopicCollector:
    """Read chunks in order and keep their messages."""

    path: Path
    file: memoryview
    scan: FileScan
    declarations: Declarations  # of the summary and of the chunks read so far
    only_topic: str | None = None  # read only this topic
    field_names: tuple[str, ...] = ()  # keep these fields of samples instead of records
    all_records: bool = False  # keep records of any number of samples
    message_count: int = 0  # in valid chunks
    _channel_stores: dict[int, _ChannelStore] = field(default_factory=dict)
    _invalid_messages: dict[int, _InvalidMessages] = field(
        default_factory=lambda: defaultdict(_InvalidMessages)
    )
    _expected_counts: Counter[int] = field(default_factory=Counter)
    _unpacked_bytes: int = 0  # upper limit over all chunks
    _text_messages: int = 0
    _unread_topics: int = 0
    _decompressor: ChunkDecompressor = field(default_factory=ChunkDecompressor)

    def read_all(self) -> None:
        """Read every chunk; report each that cannot be read.

        Raises:
            InputError: a type of format 1 has other fields in this file.
        """
        self._unpacked_bytes = sum(
            min(chunk.unpacked_size, MAX_UNPACKED_BYTES) for chunk in self.scan.chunks
        )
        if self._unpacked_bytes > max(MIN_UNPACKED_LIMIT_BYTES, MAX_FILE_RATIO * len(self.file)):
            raise InputError(
                f"{self.path} has {len(self.file)} bytes and claims to unpack to "
                f"{self._unpacked_bytes} bytes, which is more than {MAX_FILE_RATIO} times its size",
                _FOREIGN_FILE_REMEDY,
            )
        for chunk in self.scan.chunks:
            for channel, (_, count) in chunk.index.items():
                self._expected_counts[channel] += count
        chunks_without_crc = sum(not chunk.crc for chunk in self.scan.chunks)
        if chunks_without_crc:
            self.scan.notes.append(f"{chunks_without_crc} chunks have no checksum")
        if self._unpacked_bytes > MAX_RECORD_BYTES and not self.all_records:
            self.field_names = self.field_names or SOLVER_FIELDS
        page_releaser, group = PageReleaser(self.file), _ChunkGroup()
        for chunk in self.scan.chunks:
            page_releaser.release_before(chunk.offset)
            try:
                group.add(chunk, self._decompressor.decompress_chunk(chunk, self.file))
            except ChunkError as error:
                self._read_group(group.take_chunks())
                self._report_lost_chunk(chunk, error)
            if group.is_full:
                self._read_group(group.take_chunks())
        self._read_group(group.take_chunks())

    def build_topics(self) -> dict[str, Topic]:
        """Return the messages by topic; report those that cannot be decoded."""
        stores_by_topic: dict[str, list[tuple[int, _ChannelStore]]] = defaultdict(list)
        for number, channel_store in self._channel_stores.items():
            if channel_store.store is not None:
                stores_by_topic[channel_store.topic].append((number, channel_store))
        topics = {
            name: self._build_topic(name, channel_stores)
            for name, channel_stores in stores_by_topic.items()
        }
        for number, invalid in self._invalid_messages.items():
            topic = self._channel_stores[number].topic
            text = f"{invalid.count} messages of {topic!r} are lost: {invalid.reason}"
            self.scan.losses.append(Loss(LossCause.MESSAGE, invalid.offset, 0, invalid.count, text))
        return topics

    def _read_group(self, group: list[tuple[ChunkRecord, Buffer]]) -> None:
        """Read chunks together if they have only messages of known channels."""
        if len(group) > 1:
            chunks = [chunk for chunk, _ in group]
            joined = b"".join(content for _, content in group)
            group_offsets = locate_messages_in_group(chunks, joined, self.file)
            if group_offsets is not None and self._channel_stores.keys() >= group_offsets.keys():
                for number, offsets in group_offsets.items():
                    self.message_count += len(offsets)
                    self._store_messages(number, joined, offsets, chunks)
                return
        for chunk, content in group:
            try:
                self._read_chunk(chunk, content)
            except ChunkError as error:
                self._report_lost_chunk(chunk, error)

    def _report_lost_chunk(self, chunk: ChunkRecord, error: ChunkError) -> None:
        text = f"the chunk at byte {chunk.offset} is lost: {error}"
        loss = Loss(error.cause, chunk.offset, chunk.size, chunk.indexed_messages, text)
        self.scan.losses.append(loss)

    def _read_chunk(self, chunk: ChunkRecord, content: Buffer) -> None:
        chunk_content = locate_messages(chunk, content, self.file)
        try:
            for declared, additions in (
                (self.declarations.schemas, chunk_content.declarations.schemas),
                (self.declarations.channels, chunk_content.declarations.channels),
            ):
                _merge_declarations(declared, additions)
        except MalformedError as error:
            raise ChunkError(LossCause.DAMAGED, str(error)) from error
        for number, offsets in chunk_content.offsets.items():
            self.message_count += len(offsets)
            self._store_messages(number, content, offsets, [chunk])

    def _store_messages(
        self, number: int, content: Buffer, offsets: Offsets, chunks: list[ChunkRecord]
    ) -> None:
        """Keep the messages at these offsets in the joined contents of chunks."""
        if number not in self._channel_stores:
            channel_store = self._open_channel(number)
            if channel_store is None:
                text = f"{len(offsets)} messages of channel {number}, which is not declared"
                loss = Loss(LossCause.DAMAGED, chunks[0].offset, 0, len(offsets), text)
                self.scan.losses.append(loss)
                return
            self._channel_stores[number] = channel_store
        store = self._channel_stores[number].store
        if isinstance(store, FixedSizeChannel | ImuColumnsChannel):
            invalid_offsets = store.append(content, offsets)
            if len(invalid_offsets):
                ends = np.cumsum([chunk.unpacked_size for chunk in chunks])
                chunk = chunks[int(np.searchsorted(ends, invalid_offsets.min(), side="right"))]
                reason = "not of the size and header of its type"
                self._count_invalid(number, len(invalid_offsets), chunk.offset, reason)
        elif isinstance(store, VariableSizeChannel):
            limit = MIN_TEXT_MESSAGE_LIMIT + len(self.file) // FILE_BYTES_PER_TEXT_MESSAGE
            room = limit - self._text_messages
            self._text_messages += len(offsets[:room])
            store.append(content, offsets[:room])
            if len(offsets) > room:
                reason = (
                    f"a file of this size can have {limit} commands and events; what comes after "
                    "these is not read"
                )
                self._count_invalid(number, len(offsets) - room, chunks[0].offset, reason)

    def _count_invalid(self, number: int, count: int, offset: int, reason: str) -> None:
        invalid = self._invalid_messages[number]
        if not invalid.count:
            invalid.offset, invalid.reason = offset, reason
        invalid.count += count

    def _open_channel(self, number: int) -> _ChannelStore | None:
        """Create the store of a channel's messages; None if the channel is not declared."""
        unchunked = self.scan.declarations
        channel = self.declarations.channels.get(number) or unchunked.channels.get(number)
        if channel is None:
            return None
        schema = self.declarations.schemas.get(channel.schema_id) or unchunked.schemas.get(
            channel.schema_id
        )
        if channel.encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
            return self._leave_unread(channel, "", "it is not CDR with a ros2msg schema")
        return self._open_typed_channel(number, channel, schema)

    def _open_typed_channel(
        self, number: int, channel: ChannelDeclaration, schema: SchemaDeclaration
    ) -> _ChannelStore:
        if self.only_topic not in (None, channel.topic):
            return _ChannelStore(channel.topic, schema.name, None)
        if schema.name not in MESSAGE_TYPES:
            reason = f"its messages have the unknown type {schema.name}"
            return self._leave_unread(channel, schema.name, reason)
        if not has_fields_of_format(schema.name, schema.data):
            raise InputError(
                f"in {self.path}, the topic {channel.topic!r} is invalid (the message type "
                f"{schema.name} does not have the fields that recording format 1 defines)",
                _FOREIGN_FILE_REMEDY,
            )
        layout = FIXED_LAYOUTS.get(schema.name)
        if layout is None:
            return _ChannelStore(channel.topic, schema.name, VariableSizeChannel())
        # An index can have any count; its messages cannot have more bytes than the chunks.
        expected = min(
            self._expected_counts[number],
            self._unpacked_bytes // (RECORD_BYTES + layout.size_bytes),
        )
        if self.field_names and schema.name == ImuRaw.TYPE:
            columns = ImuColumnsChannel(layout, expected, self.field_names)
            return _ChannelStore(channel.topic, schema.name, columns)
        return _ChannelStore(channel.topic, schema.name, FixedSizeChannel(layout, expected))

    def _leave_unread(self, channel: ChannelDeclaration, kind: str, reason: str) -> _ChannelStore:
        """Note that a topic is not read."""
        self._unread_topics += 1
        if self._unread_topics <= MAX_UNREAD_NOTES:
            self.scan.notes.append(f"the topic {channel.topic!r} is not read, because {reason}")
        elif self._unread_topics == MAX_UNREAD_NOTES + 1:
            self.scan.notes.append("further topics of unknown types are not read")
        return _ChannelStore(channel.topic, kind, None)

    def _build_topic(self, name: str, channel_stores: list[tuple[int, _ChannelStore]]) -> Topic:
        """Build one topic from its channels, usually one."""
        types = {channel_store.type for _, channel_store in channel_stores}
        if len(types) > 1:
            raise InputError(
                f"in {self.path}, the messages on the topic {name!r} have several types: "
                f"{', '.join(sorted(types))}",
                _FOREIGN_FILE_REMEDY,
            )
        type_name = types.pop()
        for _, channel_store in channel_stores:
            if isinstance(channel_store.store, ImuColumnsChannel):
                if len(channel_stores) > 1:
                    raise MultipleChannelsError(name)
                return Topic(type_name, None, columns=channel_store.store)
        arrays = [
            channel_store.store.array()
            for _, channel_store in channel_stores
            if isinstance(channel_store.store, FixedSizeChannel)
        ]
        if arrays:
            if len({array.dtype for array in arrays}) > 1:
                raise InputError(
                    f"in {self.path}, the messages of type {type_name} on the topic {name!r} "
                    "do not all have the same fields",
                    _FOREIGN_FILE_REMEDY,
                )
            if len(arrays) == 1:
                return Topic(type_name, arrays[0])
            joined = np.concatenate(arrays)
            return Topic(type_name, joined[np.argsort(joined["log_time"], kind="stable")])
        messages = [
            self._decode_message(number, type_name, stored)
            for number, channel_store in channel_stores
            if isinstance(channel_store.store, VariableSizeChannel)
            for stored in channel_store.store.messages
        ]
        decoded = [message for message in messages if message is not None]
        if len(channel_stores) > 1:
            decoded.sort(key=lambda message: message.log_time_ns)
        return Topic(type_name, None, tuple(decoded))

    def _decode_message(
        self, number: int, type_name: str, stored: StoredMessage
    ) -> TimedMessage[Any] | None:
        try:
            message = MESSAGE_TYPES[type_name].decode(stored.payload)
        except InputError as error:
            self._count_invalid(number, 1, 0, error.problem)
            return None
        return TimedMessage(
            stored.log_time_ns, stored.publish_time_ns, stored.message_sequence, message
        )


def _merge_declarations(declared: dict[int, Any], additions: dict[int, Any]) -> None:
    for number, declaration in additions.items():
        if declared.setdefault(number, declaration) != declaration:
            raise MalformedError(f"number {number} is declared twice with different content")
