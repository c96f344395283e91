"""Bring the messages of a file's chunks together by topic.

What to use when: under `reader`, one `Collector` for each time through a file.

Samples are kept as whole records, which every field can be viewed in, as long as all of
the file's chunks unpack to little; beyond that as columns (`imu_columns`).
"""

from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.arrays import FixedChannel, StoredMessage, VariableChannel
from gyrorig_protocol.recording.cdr import fixed_layout
from gyrorig_protocol.recording.chunks import (
    MAX_UNPACKED_BYTES,
    RECORD_BYTES,
    ChunkError,
    Offsets,
    Unpacker,
    open_chunk,
    open_together,
)
from gyrorig_protocol.recording.definitions import Channel, Declared, Schema
from gyrorig_protocol.recording.fields import Buffer, MalformedError
from gyrorig_protocol.recording.framing import ChunkRecord, Walk
from gyrorig_protocol.recording.imu_columns import FOR_SOLVING, ColumnsChannel
from gyrorig_protocol.recording.losses import Loss, LossCause
from gyrorig_protocol.recording.mapped import Passage
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.recording import MESSAGE_TYPES, Stamped, Topic
from gyrorig_protocol.recording.ros2msg import same_definition
from gyrorig_protocol.recording.schemas import SCHEMAS

_FOREIGN = "another program or version wrote it: copy it from the rig again, or record anew"
KEPT_BYTES = 160 << 20  # of unpacked chunks: half an hour of a board at 800 Hz
GROUP_BYTES = 1 << 19  # of unpacked chunks taken together: they stay in the processor's cache


class SeveralChannelsError(Exception):
    """Columns of several channels on one topic; never leaves this package."""


@dataclass(slots=True)
class _Sink:
    """Where one channel's messages go; `None` when they are not read."""

    topic: str
    type: str
    store: FixedChannel | ColumnsChannel | VariableChannel | None


@dataclass(slots=True)
class _Bad:
    """Messages of one channel that are not what its schema says."""

    count: int = 0
    offset: int = 0  # of the first such message's chunk
    why: str = ""


@dataclass(slots=True)
class _Group:
    """Unpacked chunks that are to be opened together: one at first, more and more then.

    What declares channels is in the first ones mostly, and those have to be opened alone.
    """

    limit: int = 1
    size: int = 0
    waiting: list[tuple[ChunkRecord, Buffer]] = field(default_factory=list)

    @property
    def full(self) -> bool:
        """Whether it is time to close it."""
        return self.size >= self.limit

    def add(self, chunk: ChunkRecord, content: Buffer) -> None:
        """Let one more chunk wait."""
        self.waiting.append((chunk, content))
        self.size += len(content)

    def close(self) -> list[tuple[ChunkRecord, Buffer]]:
        """Give the chunks that waited, and begin anew."""
        self.limit = min(max(2 * self.limit, 2 * self.size), GROUP_BYTES)
        group, self.waiting, self.size = self.waiting, [], 0
        return group


@dataclass(slots=True)
class Collector:
    """Opens chunks one after the other and keeps their messages."""

    path: Path
    file: memoryview
    found: Walk
    known: Declared  # from the summary, and from the chunks opened so far
    only: str | None = None  # read this topic and no other
    names: tuple[str, ...] = ()  # keep these fields of samples, and no records
    all_records: bool = False  # keep records, however many
    seen: int = 0  # messages in sound chunks
    _sinks: dict[int, _Sink] = field(default_factory=dict)
    _bad: dict[int, _Bad] = field(default_factory=lambda: defaultdict(_Bad))
    _expected: Counter[int] = field(default_factory=Counter)
    _room: int = 0  # what all chunks unpack to, at most
    _unpacker: Unpacker = field(default_factory=Unpacker)

    def take_all(self) -> None:
        """Open every chunk; state each that cannot be opened.

        Raises:
            InputError: a type of format 1 has other fields in this file.
        """
        self._room = sum(min(c.unpacked_size, MAX_UNPACKED_BYTES) for c in self.found.chunks)
        for chunk in self.found.chunks:
            for channel, (_, count) in chunk.index.items():
                self._expected[channel] += count
        unchecked = sum(not chunk.crc for chunk in self.found.chunks)
        if unchecked:
            self.found.notes.append(f"{unchecked} chunks carry no checksum to check")
        if self._room > KEPT_BYTES and not self.all_records:
            self.names = self.names or FOR_SOLVING
        passage, group = Passage(self.file), _Group()
        for chunk in self.found.chunks:
            passage.reached(chunk.offset)
            try:
                group.add(chunk, self._unpacker.unpack(chunk, self.file))
            except ChunkError as error:
                self._take_group(group.close())
                self._lose(chunk, error)
            if group.full:
                self._take_group(group.close())
        self._take_group(group.close())

    def topics(self) -> dict[str, Topic]:
        """The messages by topic; states those that do not decode."""
        sinks: dict[str, list[tuple[int, _Sink]]] = defaultdict(list)
        for number, sink in self._sinks.items():
            if sink.store is not None:
                sinks[sink.topic].append((number, sink))
        topics = {name: self._topic(name, parts) for name, parts in sinks.items()}
        for number, bad in self._bad.items():
            text = f"{bad.count} messages of {self._sinks[number].topic!r} are lost: {bad.why}"
            self.found.losses.append(Loss(LossCause.MESSAGE, bad.offset, 0, bad.count, text))
        return topics

    def _take_group(self, group: list[tuple[ChunkRecord, Buffer]]) -> None:
        """Take some chunks at once where nothing but messages of known channels is in them."""
        if len(group) > 1:
            chunks = [chunk for chunk, _ in group]
            joined = b"".join(content for _, content in group)
            together = open_together(chunks, joined, self.file)
            if together is not None and self._sinks.keys() >= together.keys():
                for number, offsets in together.items():
                    self.seen += len(offsets)
                    self._append(number, joined, offsets, chunks)
                return
        for chunk, content in group:
            try:
                self._take(chunk, content)
            except ChunkError as error:
                self._lose(chunk, error)

    def _lose(self, chunk: ChunkRecord, error: ChunkError) -> None:
        text = f"the chunk at byte {chunk.offset} is lost: {error}"
        loss = Loss(error.cause, chunk.offset, chunk.size, chunk.indexed_messages, text)
        self.found.losses.append(loss)

    def _take(self, chunk: ChunkRecord, content: Buffer) -> None:
        inside = open_chunk(chunk, content, self.file)
        try:
            for known, more in (
                (self.known.schemas, inside.declared.schemas),
                (self.known.channels, inside.declared.channels),
            ):
                _merge(known, more)
        except MalformedError as error:
            raise ChunkError(LossCause.DAMAGED, str(error)) from error
        for number, offsets in inside.offsets.items():
            self.seen += len(offsets)
            self._append(number, content, offsets, [chunk])

    def _append(
        self, number: int, content: Buffer, offsets: Offsets, chunks: list[ChunkRecord]
    ) -> None:
        """Keep messages at offsets into the contents of chunks, one behind the other."""
        if number not in self._sinks:
            sink = self._open(number)
            if sink is None:
                text = f"{len(offsets)} messages of channel {number}, which nothing declares"
                loss = Loss(LossCause.DAMAGED, chunks[0].offset, 0, len(offsets), text)
                self.found.losses.append(loss)
                return
            self._sinks[number] = sink
        store = self._sinks[number].store
        if isinstance(store, FixedChannel | ColumnsChannel):
            wrong = store.append(content, offsets)
            if len(wrong):
                ends = np.cumsum([chunk.unpacked_size for chunk in chunks])
                chunk = chunks[int(np.searchsorted(ends, wrong.min(), side="right"))]
                why = "not of the size and header of its type"
                self._blame(number, len(wrong), chunk.offset, why)
        elif isinstance(store, VariableChannel):
            store.append(content, offsets)

    def _blame(self, number: int, count: int, offset: int, why: str) -> None:
        bad = self._bad[number]
        if not bad.count:
            bad.offset, bad.why = offset, why
        bad.count += count

    def _open(self, number: int) -> _Sink | None:
        """Decide how to keep a channel's messages; None when it is not declared."""
        loose = self.found.declared
        channel = self.known.channels.get(number) or loose.channels.get(number)
        if channel is None:
            return None
        schema = self.known.schemas.get(channel.schema_id) or loose.schemas.get(channel.schema_id)
        if channel.encoding != "cdr" or schema is None or schema.encoding != "ros2msg":
            self.found.notes.append(f"{channel.topic!r} is not cdr with ros2msg: not read")
            return _Sink(channel.topic, "", None)
        return self._open_typed(number, channel, schema)

    def _open_typed(self, number: int, channel: Channel, schema: Schema) -> _Sink:
        if self.only not in (None, channel.topic):
            return _Sink(channel.topic, schema.name, None)
        try:
            text = schema.data.decode()
            ours = SCHEMAS.get(schema.name)
            if ours is not None and not same_definition(schema.name, text, ours):
                raise InputError(f"{schema.name} has other fields than in format 1")
            layout = fixed_layout(schema.name, text)
        except (UnicodeDecodeError, InputError) as error:
            if schema.name in SCHEMAS or schema.name.startswith("gyrorig_msgs/"):
                why = error.what if isinstance(error, InputError) else "its schema is no text"
                raise InputError(f"{self.path}: {channel.topic!r}: {why}", _FOREIGN) from error
            self.found.notes.append(f"{channel.topic!r} is not read: {error}")
            return _Sink(channel.topic, schema.name, None)
        if layout is not None:
            # An index may promise anything; its messages cannot take more than the chunks.
            expected = min(self._expected[number], self._room // (RECORD_BYTES + layout.size))
            if self.names and schema.name == ImuRaw.TYPE:
                columns = ColumnsChannel(layout, expected, self.names)
                return _Sink(channel.topic, schema.name, columns)
            return _Sink(channel.topic, schema.name, FixedChannel(layout, expected))
        if schema.name not in MESSAGE_TYPES:
            self.found.notes.append(f"{channel.topic!r} holds {schema.name}: not read")
            return _Sink(channel.topic, schema.name, None)
        return _Sink(channel.topic, schema.name, VariableChannel())

    def _topic(self, name: str, parts: list[tuple[int, _Sink]]) -> Topic:
        """One topic from its channels, usually one."""
        kinds = {sink.type for _, sink in parts}
        if len(kinds) > 1:
            raise InputError(
                f"{self.path}: {name!r} holds several types, {', '.join(sorted(kinds))}", _FOREIGN
            )
        kind = kinds.pop()
        for _, sink in parts:
            if isinstance(sink.store, ColumnsChannel):
                if len(parts) > 1:
                    raise SeveralChannelsError(name)
                return Topic(kind, None, columns=sink.store)
        arrays = [s.store.array() for _, s in parts if isinstance(s.store, FixedChannel)]
        if arrays:
            if len({array.dtype for array in arrays}) > 1:
                raise InputError(f"{self.path}: {name!r} holds {kind} in several layouts", _FOREIGN)
            if len(arrays) == 1:
                return Topic(kind, arrays[0])
            both = np.concatenate(arrays)
            return Topic(kind, both[np.argsort(both["log_time"], kind="stable")])
        stamped = [
            self._decode(number, kind, one)
            for number, sink in parts
            if isinstance(sink.store, VariableChannel)
            for one in sink.store.messages
        ]
        whole = [one for one in stamped if one is not None]
        if len(parts) > 1:
            whole.sort(key=lambda one: one.log_time_ns)
        return Topic(kind, None, tuple(whole))

    def _decode(self, number: int, kind: str, one: StoredMessage) -> Stamped[Any] | None:
        try:
            message = MESSAGE_TYPES[kind].decode(one.payload)
        except InputError as error:
            self._blame(number, 1, 0, str(error))
            return None
        return Stamped(one.log_time_ns, one.publish_time_ns, one.message_sequence, message)


def _merge(known: dict[int, Any], more: dict[int, Any]) -> None:
    for number, one in more.items():
        if known.setdefault(number, one) != one:
            raise MalformedError(f"number {number} is declared twice, differently")
