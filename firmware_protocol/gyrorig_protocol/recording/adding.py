"""A copy of a recording with more topics in it.

What to use when: `copy_with` to put what was worked out of a recording beside what it was
worked out of. The recording's own chunks are copied packed, as they are, so that nothing of
it can change on the way; new messages stand in chunks of their own, each behind the chunk of
the same time, so that a player need not look far.
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
from gyrorig_protocol.recording.assembly import Assembly, ReadyChunk
from gyrorig_protocol.recording.copies import (
    MEDIA_TYPE,
    METADATA_COPY,
    metadata_copy,
    read_metadata,
)
from gyrorig_protocol.recording.definitions import Declared
from gyrorig_protocol.recording.disk_file import DISK, Disk, DiskFile
from gyrorig_protocol.recording.framing import Walk, walk
from gyrorig_protocol.recording.head import FORMAT, Attachment, software
from gyrorig_protocol.recording.losses import Loss
from gyrorig_protocol.recording.mapped import map_file
from gyrorig_protocol.recording.salvage import Copying
from gyrorig_protocol.recording.summary import MAGIC, read_summary

_QOS = {"offered_qos_profiles": ""}
_RECORD = np.dtype(
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
_FIELDS_BYTES = 22  # of a message record, between its length and its payload
CHUNK_MESSAGES = 3000  # about 1 MiB of `sensor_msgs/msg/Imu`


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Messages of one topic, in the order of their log times."""

    log_time_ns: npt.NDArray[np.int64]  # (n,)
    publish_time_ns: npt.NDArray[np.int64]  # (n,)
    payloads: npt.NDArray[np.uint8]  # (n, bytes of one, its header included)


@dataclass(frozen=True, slots=True)
class AddedTopic:
    """A topic that the copy shall have more."""

    topic: str
    type: str
    schema: str  # ros2msg text with its dependencies
    batches: Iterator[Batch]  # in the order of log times, none empty


@dataclass(frozen=True, slots=True)
class Copied:
    """What a copy holds."""

    chunks: int  # of the recording itself
    added: Mapping[str, int]  # messages by topic
    losses: tuple[Loss, ...]  # what of the recording was damaged, and is not in the copy


def copy_with(
    source: Path,
    target: Path,
    metadata: Mapping[str, Mapping[str, str]],
    topics: Sequence[AddedTopic],
    disk: Disk = DISK,
) -> Copied:
    """Write a copy of `source` with more topics and metadata, whole or not at all.

    Args:
        source: a recording, finished or not.
        target: ends in `.mcap`; must not exist.
        metadata: more records.
        topics: what to add.
        disk: where `target` is.

    Raises:
        InputError: `source` is no recording, or holds a topic of that name already.
        UsageError: `target` exists, or is not named `.mcap`.
        MachineError: this computer cannot read or write.
    """
    if target.suffix != ".mcap":
        raise UsageError(f"{target.name} is no name for a recording", "end it in .mcap")
    part = target.with_name(target.name + ".part")
    for path in (target, part):
        if disk.exists(path):
            raise UsageError(f"{path} exists", "a recording is never overwritten: name another")
    data = map_file(source)
    if data[: len(MAGIC)] != MAGIC:
        raise InputError(
            f"{source} is no MCAP file",
            "measurements of other kinds become a recording by gyrorig import",
        )
    summary = read_summary(data)
    found = walk(data, summary)
    known = summary.declared if summary.sound else _declared(source, data, found)
    for channel in known.channels.values():
        if channel.topic in {one.topic for one in topics}:
            raise InputError(
                f"{source.name} holds {channel.topic} already: a calibration was applied to it",
                "apply to the recording that it was made of",
            )
    copy = _Copy(Copying(source, data, found), found, known)
    try:
        file = disk.create(part)
        try:
            done = copy.write(file, source, metadata, topics)
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
            f"cannot write {target}: {fault.strerror}", "make space, or name another file"
        ) from fault
    return done


def _declared(source: Path, data: memoryview, found: Walk) -> Declared:
    """Return every channel of a file without a summary: declared anywhere in it."""
    known = Declared()
    known.fill_from(found.declared)
    for _, declared in Copying(source, data, found).sound_chunks():
        known.fill_from(declared)
    return known


class _Copy:
    """One copy in the making."""

    def __init__(self, own: Copying, found: Walk, known: Declared) -> None:
        self._own, self._found = own, found
        self._schemas = count(max(known.schemas, default=0) + 1)
        self._channels = count(max(known.channels, default=0) + 1)
        self._zip = zstandard.ZstdCompressor(level=1)  # twice as fast as 3, for 3 % more bytes

    def write(
        self,
        file: DiskFile,
        source: Path,
        metadata: Mapping[str, Mapping[str, str]],
        topics: Sequence[AddedTopic],
    ) -> Copied:
        """Write all of it."""
        records = read_metadata(self._found.attachments) or dict(self._found.metadata)
        if records.get("gyrorig", {}).get("format") != FORMAT:
            raise InputError(
                f"{source} is MCAP, but no recording of Gyrorig of format {FORMAT}",
                "make a recording of its data with `gyrorig import`",
            )
        records |= {name: dict(record) for name, record in metadata.items()}
        out = Assembly(file)
        out.start(software())
        for name, record in records.items():
            out.add_metadata(name, record)
        for one in self._found.attachments:
            if one.name != METADATA_COPY:
                out.add_attachment(Attachment(one.name, one.media_type, one.data, one.log_time_ns))
        out.add_attachment(Attachment(METADATA_COPY, MEDIA_TYPE, metadata_copy(records)))
        writers = [_Topic(out, one, next(self._schemas), next(self._channels), self._zip)
                   for one in topics]  # fmt: skip
        chunks = 0
        for ready, declared in self._own.sound_chunks():
            self._own.declare(out, ready, declared)
            out.add_chunk(ready)
            chunks += 1
            last_ns = max(int(entries[:, 0].max()) for entries in ready.index.values())
            for writer in writers:
                writer.write_until(last_ns)
        for writer in writers:
            writer.write_until(None)
        if not chunks:
            raise InputError(
                f"{source} holds no whole message", "copy it again from the rig, or record anew"
            )
        out.finish()
        added = {one.topic: writer.written for one, writer in zip(topics, writers, strict=True)}
        return Copied(chunks, added, tuple(self._own.losses))


class _Topic:
    """One added topic: its batches cut at the recording's chunks, and packed."""

    def __init__(
        self,
        out: Assembly,
        topic: AddedTopic,
        schema: int,
        channel: int,
        compressor: zstandard.ZstdCompressor,
    ) -> None:
        self._out, self._batches, self._zip = out, topic.batches, compressor
        self._schema = Schema(schema, topic.schema.encode(), "ros2msg", topic.type)
        self._channel = Channel(channel, topic.topic, "cdr", _QOS, schema)
        self._waiting: Batch | None = next(self._batches, None)
        self._at = 0  # of what waits, the first that is not written
        self.written = 0

    def write_until(self, last_ns: int | None) -> None:
        """Write the messages up to a log time; all that are left without one."""
        while self._waiting is not None:
            times = self._waiting.log_time_ns
            upto = times.size
            if last_ns is not None:
                upto = int(np.searchsorted(times, last_ns, side="right"))
            while self._at < upto:
                end = min(upto, self._at + CHUNK_MESSAGES)
                self._write(self._waiting, slice(self._at, end))
                self._at = end
            if self._at < times.size:
                return
            self._waiting, self._at = next(self._batches, None), 0

    def _write(self, batch: Batch, rows: slice) -> None:
        declaration = b""
        if not self.written:
            declaration = self._out.declaration(self._schema, self._channel)
            self._out.know(self._schema, self._channel)
        payloads = batch.payloads[rows]
        size = payloads.shape[1]
        head = np.zeros(len(payloads), dtype=_RECORD)
        head["opcode"], head["length"] = _MESSAGE_OPCODE, _FIELDS_BYTES + size
        head["channel"] = self._channel.id
        head["sequence"] = (self.written + np.arange(len(payloads))) & 0xFFFFFFFF
        head["log_time"] = batch.log_time_ns[rows]
        head["publish_time"] = batch.publish_time_ns[rows]
        whole = np.empty((len(payloads), _RECORD.itemsize + size), dtype=np.uint8)
        whole[:, : _RECORD.itemsize] = head.view(np.uint8).reshape(len(payloads), -1)
        whole[:, _RECORD.itemsize :] = payloads
        content = declaration + whole.tobytes()
        index = np.empty((len(payloads), 2), dtype=np.uint64)
        index[:, 0] = head["log_time"]
        index[:, 1] = len(declaration) + np.arange(len(payloads)) * whole.shape[1]
        packed, crc = self._zip.compress(content), zlib.crc32(content)
        self._out.add_chunk(
            ReadyChunk("zstd", packed, len(content), crc, {self._channel.id: index})
        )
        self.written += len(payloads)
