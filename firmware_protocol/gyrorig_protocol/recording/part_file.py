"""Part file: the unfinished MCAP file of a recording that is being written.

What to use when: only in `writer`, by `create_part_file`. The file always ends with a complete
record. An error of the disk costs the messages that are not yet written as a chunk, never the data
before them.
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

from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.recording.backup_copies import (
    CHANNELS_COPY,
    COPY_MEDIA_TYPE,
    METADATA_COPY,
    encode_channels_copy,
    encode_metadata_copy,
)
from gyrorig_protocol.recording.encoding.message_schemas import SCHEMAS
from gyrorig_protocol.recording.mcap.disk_file import Disk
from gyrorig_protocol.recording.mcap.mcap_builder import McapBuilder, PackedChunk
from gyrorig_protocol.recording.recording_metadata import Attachment, software_version

# Writing a chunk of 1 MiB blocks the thread for about 14 ms, one of 16 MiB for 160 ms.
CHUNK_BYTES = 1 << 20
_MESSAGE_LAYOUT = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, two times
_MESSAGE_OPCODE = 0x05
_MESSAGE_FIELDS_BYTES = 22
_QOS = {"offered_qos_profiles": ""}
_OVERWRITE_REMEDY = "choose another name or move the file, because a recording is never overwritten"

Records = Mapping[str, Mapping[str, str]]


@dataclass(slots=True)
class OpenChannel:
    """The state of one topic."""

    number: int
    type_name: str
    sequence: int = 0
    last_log_time_ns: int = 0


@dataclass(slots=True)
class CommittedOffset:
    """The end of the last complete record, and the messages after it."""

    position: int = 0
    waiting_messages: int = 0
    lost_messages: int = field(default=0)


class PartFile:
    """A `.mcap.part` file that becomes a `.mcap` file.

    Raises:
        FileExistsError: the name exists.
        OSError: from every method, as the disk reports it; after it only `truncate_and_close` is
            allowed.
    """

    def __init__(self, final: Path, part: Path, disk: Disk) -> None:
        self._final, self._part, self._disk = final, part, disk
        self._schemas: dict[str, Schema] = {}
        self._chunk = bytearray()  # in progress
        self._index: dict[int, list[int]] = {}  # of the chunk: log times and offsets, by channel
        self._compressor = zstandard.ZstdCompressor()
        self._channels_without_copy: dict[int, tuple[str, str]] = {}  # channels since the last copy
        self._metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[str, OpenChannel] = {}
        self.committed = CommittedOffset()
        self.is_renamed = False
        self._is_name_synced = False
        self.sync_error: OSError | None = None  # the system reports it only once
        self._file = disk.create(part)
        self._builder = McapBuilder(self._file)

    def begin(self, records: Records, attachments: Iterable[Attachment], is_synced: bool) -> None:
        """Write the records before the first message, and wait until they are on the disk.

        If not `is_synced`, the first `sync` makes them durable.
        """
        self._builder.write_header(software_version())
        self.add_metadata(records, attachments)
        if is_synced:
            self.sync()

    def add_metadata(self, records: Records, attachments: Iterable[Attachment]) -> None:
        """Write metadata and attachments, with a checksummed copy of all metadata so far."""
        self._write_chunk()
        for name, record in records.items():
            self._metadata[name] = dict(record)
            self._builder.add_metadata(name, record)
        for attachment in attachments:
            self._builder.add_attachment(attachment)
        self._builder.add_attachment(
            Attachment(METADATA_COPY, COPY_MEDIA_TYPE, encode_metadata_copy(self._metadata))
        )
        self._mark_committed()

    def open_channel(self, topic: str, type_name: str) -> OpenChannel:
        """Return the channel of a topic, created at its first message.

        Raises:
            ValueError: the topic does not begin with a slash.
        """
        open_channel = self.channels.get(topic)
        if open_channel is None:
            if not topic.startswith("/"):
                raise ValueError(f"a topic begins with a slash: {topic!r}")
            schema = self._schemas.get(type_name)
            if schema is None:
                text = SCHEMAS[type_name].encode()
                schema = Schema(len(self._schemas) + 1, text, "ros2msg", type_name)
                self._schemas[type_name] = schema
            number = len(self.channels) + 1
            channel = Channel(number, topic, "cdr", _QOS, schema.id)
            self._chunk += self._builder.encode_declaration(schema, channel)
            self._builder.register_channel(schema, channel)
            open_channel = self.channels[topic] = OpenChannel(number, type_name)
            self._channels_without_copy[number] = (topic, type_name)
        return open_channel

    def append(self, channel: OpenChannel, time_ns: int, publish_ns: int, payload: bytes) -> None:
        """Add one message to the chunk in progress; write the chunk if it is full.

        Raises:
            ValueError: a time or the sequence number does not fit; nothing was added.
        """
        chunk, sequence, number = self._chunk, channel.sequence, channel.number
        length = _MESSAGE_FIELDS_BYTES + len(payload)
        try:
            head = _MESSAGE_LAYOUT.pack(
                _MESSAGE_OPCODE, length, number, sequence, time_ns, publish_ns
            )
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
        self.committed.waiting_messages += 1
        if len(chunk) >= CHUNK_BYTES:
            self._write_chunk()

    def flush(self) -> None:
        """Write the chunk in progress."""
        self._write_chunk()
        if self._channels_without_copy:
            copy = encode_channels_copy(self._channels_without_copy)
            self._builder.add_attachment(Attachment(CHANNELS_COPY, COPY_MEDIA_TYPE, copy))
            self._channels_without_copy.clear()
            self._mark_committed()

    def sync(self) -> None:
        """Wait until the written data and the name are on the disk; callable by any thread."""
        self._sync_data()
        if not self._is_name_synced:
            self._disk.sync_directory(self._part.parent)
            self._is_name_synced = True

    def finish(self) -> None:
        """Write the summary, sync, and give the file its final name.

        Never after a failed sync: the next one succeeds, although the data are lost.
        """
        if self.sync_error is not None:
            raise self.sync_error
        self._write_chunk()
        self._builder.finish()
        self._sync_data()
        if self._disk.exists(self._final):
            raise FileExistsError(errno.EEXIST, "a file of the final name has appeared")
        self._disk.rename(self._part, self._final)
        self.is_renamed = True
        self._mark_committed()
        self._file.close()
        self._disk.sync_directory(self._final.parent)

    def truncate_and_close(self, length: int | None = None) -> str:
        """Truncate to the last complete record, or further, and close; describe the result."""
        position = (
            self.committed.position if length is None else min(length, self.committed.position)
        )
        outcome = f"its first {position} bytes are complete and kept"
        try:
            if not self.is_renamed:
                self._file.cut(position)
                self._sync_data()
        except OSError as error:
            outcome = f"its last bytes can be incomplete ({error.strerror})"
        with suppress(OSError):  # the descriptor is closed also after an error
            self._file.close()
        return outcome

    def _sync_data(self) -> None:
        try:
            self._file.sync()
        except OSError as error:
            self.sync_error = error
            raise

    def _write_chunk(self) -> None:
        """Write the chunk in progress if it has a message."""
        if not self._index:
            return
        content = self._chunk
        index = {
            number: np.array(entries, np.uint64).reshape(-1, 2)
            for number, entries in self._index.items()
        }
        compressed, crc = self._compressor.compress(content), zlib.crc32(content)
        self._builder.add_chunk(PackedChunk("zstd", compressed, len(content), crc, index))
        self._chunk, self._index = bytearray(), {}
        self._mark_committed()

    def _mark_committed(self) -> None:
        self.committed.position = self._file.tell()
        self.committed.waiting_messages = 0


def part_path(path: Path) -> Path:
    """Return the name of the file while it is being written."""
    return path.with_name(path.name + ".part")


def create_part_file(final: Path, part: Path, disk: Disk) -> PartFile:
    """Create the file of a recording.

    Args:
        final: the name of the complete recording.
        part: the name while it is being written.
        disk: the disk interface.

    Raises:
        UsageError: one of them exists.
        MachineError: the file cannot be created.
    """
    for path in (final, part):
        if disk.exists(path):
            raise UsageError(f"the file {path} already exists", _OVERWRITE_REMEDY)
    try:
        return PartFile(final, part, disk)
    except FileExistsError as error:
        raise UsageError(f"the file {part} already exists", _OVERWRITE_REMEDY) from error
    except OSError as error:
        raise MachineError(
            f"the recording {part} cannot be created ({error.strerror})",
            "free disk space, correct the permissions of the folder, or choose another folder",
        ) from error
