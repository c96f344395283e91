"""The MCAP file under a recording being written: what of it is whole, and how it ends.

What to use when: under `writer` only. Everything here is whole records or nothing: an
error of the disk costs what has not yet been written out as a chunk, never what stands
before it.
"""

import errno
import struct
import zlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zstandard
from mcap.records import Channel, Schema

from gyrorig_protocol.recording.assembly import Assembly, ReadyChunk
from gyrorig_protocol.recording.copies import (
    CHANNELS_COPY,
    MEDIA_TYPE,
    METADATA_COPY,
    channels_copy,
    metadata_copy,
)
from gyrorig_protocol.recording.disk_file import Disk
from gyrorig_protocol.recording.head import Attachment, software
from gyrorig_protocol.recording.schemas import SCHEMAS

# A chunk of 1 MiB stalls the writing thread by about 14 ms, one of 16 MiB by 160 ms.
CHUNK_BYTES = 1 << 20
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, two times
_MESSAGE_OPCODE = 0x05
_MESSAGE_FIELDS_BYTES = 22
_QOS = {"offered_qos_profiles": ""}

Records = Mapping[str, Mapping[str, str]]


@dataclass(slots=True)
class OpenChannel:
    """What is remembered about one topic."""

    number: int
    type: str
    sequence: int = 0
    last_log_time_ns: int = 0


@dataclass(slots=True)
class Safe:
    """How far the file holds whole records, and what waits behind that."""

    position: int = 0
    waiting: int = 0
    lost: int = field(default=0)


class PartFile:
    """One `.mcap.part` on its way to `.mcap`.

    Raises:
        FileExistsError: the name is taken.
        OSError: from every method, as the disk reports it; then only `salvage` is left.
    """

    def __init__(self, final: Path, part: Path, disk: Disk) -> None:
        self._final, self._part, self._disk = final, part, disk
        self._schemas: dict[str, Schema] = {}
        self._chunk = bytearray()  # in progress
        self._index: dict[int, list[int]] = {}  # of it: log times and places, by channel
        self._zip = zstandard.ZstdCompressor()
        self._uncopied: dict[int, tuple[str, str]] = {}  # channels since the last copy
        self._metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[str, OpenChannel] = {}
        self.safe = Safe()
        self.renamed = False
        self._name_lasts = False
        self._file = disk.create(part)
        self._out = Assembly(self._file)

    def begin(self, records: Records, attachments: Iterable[Attachment]) -> None:
        """Write what stands in front of the first message; `sync` makes it last."""
        self._out.start(software())
        self.add_facts(records, attachments)

    def add_facts(self, records: Records, attachments: Iterable[Attachment]) -> None:
        """Write metadata and attachments, with a checksummed copy of all metadata so far."""
        self._write_chunk()
        for name, record in records.items():
            self._metadata[name] = dict(record)
            self._out.add_metadata(name, record)
        for one in attachments:
            self._out.add_attachment(one)
        self._out.add_attachment(
            Attachment(METADATA_COPY, MEDIA_TYPE, metadata_copy(self._metadata))
        )
        self._mark_safe()

    def channel(self, topic: str, type_name: str) -> OpenChannel:
        """The channel of a topic, made at its first message.

        Raises:
            ValueError: the topic is none.
        """
        known = self.channels.get(topic)
        if known is None:
            if not topic.startswith("/"):
                raise ValueError(f"a topic begins with a slash: {topic!r}")
            schema = self._schemas.get(type_name)
            if schema is None:
                text = SCHEMAS[type_name].encode()
                schema = Schema(len(self._schemas) + 1, text, "ros2msg", type_name)
                self._schemas[type_name] = schema
            number = len(self.channels) + 1
            channel = Channel(number, topic, "cdr", _QOS, schema.id)
            self._chunk += self._out.declaration(schema, channel)
            self._out.know(schema, channel)
            known = self.channels[topic] = OpenChannel(number, type_name)
            self._uncopied[number] = (topic, type_name)
        return known

    def append(self, channel: OpenChannel, time_ns: int, publish_ns: int, payload: bytes) -> None:
        """Add one message to the chunk in progress; now and then that writes the chunk.

        Raises:
            ValueError: a time or the sequence number does not fit; nothing was added.
        """
        chunk, sequence, number = self._chunk, channel.sequence, channel.number
        length = _MESSAGE_FIELDS_BYTES + len(payload)
        try:
            head = _MESSAGE.pack(_MESSAGE_OPCODE, length, number, sequence, time_ns, publish_ns)
        except struct.error as error:
            raise ValueError(f"a message at {time_ns} ns cannot be written: {error}") from error
        entries = self._index.get(number)
        if entries is None:
            entries = self._index[number] = []
        entries.append(time_ns)
        entries.append(len(chunk))
        chunk += head
        chunk += payload
        channel.sequence = (sequence + 1) & 0xFFFFFFFF
        channel.last_log_time_ns = time_ns
        self.safe.waiting += 1
        if len(chunk) >= CHUNK_BYTES:
            self._write_chunk()

    def flush(self) -> None:
        """Write out the chunk in progress."""
        self._write_chunk()
        if self._uncopied:
            copy = channels_copy(self._uncopied)
            self._out.add_attachment(Attachment(CHANNELS_COPY, MEDIA_TYPE, copy))
            self._uncopied.clear()
            self._mark_safe()

    def sync(self) -> None:
        """Wait until what has been written is on the disk, and so is its name; any thread may."""
        self._file.sync()
        if not self._name_lasts:
            self._disk.sync_directory(self._part.parent)
            self._name_lasts = True

    def finish(self) -> None:
        """Write the summary, sync, and give the file its final name."""
        self._write_chunk()
        self._out.finish()
        self._file.sync()
        if self._disk.exists(self._final):
            raise FileExistsError(errno.EEXIST, "a file of the final name has appeared")
        self._disk.rename(self._part, self._final)
        self.renamed = True
        self._mark_safe()
        self._file.close()
        self._disk.sync_directory(self._final.parent)

    def salvage(self, length: int | None = None) -> str:
        """Cut back to the last whole record, or further, and let go; say what is kept."""
        position = self.safe.position if length is None else min(length, self.safe.position)
        kept = f"its first {position} bytes are whole and kept"
        try:
            if not self.renamed:
                self._file.cut(position)
                self._file.sync()
        except OSError as error:
            kept = f"its last bytes may be torn ({error.strerror})"
        with suppress(OSError):  # whatever it says, the descriptor is gone then
            self._file.close()
        return kept

    def _write_chunk(self) -> None:
        """Write out the chunk in progress, if a message is in it."""
        if not self._index:
            return
        content = self._chunk
        index = {
            number: np.array(entries, np.uint64).reshape(-1, 2)
            for number, entries in self._index.items()
        }
        packed, crc = self._zip.compress(content), zlib.crc32(content)
        self._out.add_chunk(ReadyChunk("zstd", packed, len(content), crc, index))
        self._chunk, self._index = bytearray(), {}
        self._mark_safe()

    def _mark_safe(self) -> None:
        self.safe.position = self._file.tell()
        self.safe.waiting = 0
