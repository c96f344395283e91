"""The MCAP file under a recording being written: what of it is whole, and how it ends.

What to use when: under `writer` only. Everything here is whole records or nothing: an
error of the disk costs what has not yet been written out as a chunk, never what stands
before it.
"""

import errno
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer

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
        self._schemas: dict[str, int] = {}
        self._uncopied: dict[int, tuple[str, str]] = {}  # channels since the last copy
        self._metadata: dict[str, dict[str, str]] = {}
        self.channels: dict[str, OpenChannel] = {}
        self.safe = Safe()
        self.renamed = False
        self._file = disk.create(part)
        self._mcap = Writer(
            cast(IO[bytes], self._file),
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
        )

    def begin(self, records: Records, attachments: Iterable[Attachment]) -> None:
        """Write what stands in front of the first message, and make it last."""
        self._mcap.start(profile="ros2", library=software())
        self.add_facts(records, attachments)
        self._file.sync()
        self._disk.sync_directory(self._part.parent)

    def add_facts(self, records: Records, attachments: Iterable[Attachment]) -> None:
        """Write metadata and attachments, with a checksummed copy of all metadata so far."""
        self._mcap.flush()  # type: ignore[no-untyped-call]
        for name, record in records.items():
            self._metadata[name] = dict(record)
            self._mcap.add_metadata(name, dict(record))
        for one in attachments:
            self._attach(one)
        self._attach(Attachment(METADATA_COPY, MEDIA_TYPE, metadata_copy(self._metadata)))
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
            if type_name not in self._schemas:
                text = SCHEMAS[type_name].encode()
                self._schemas[type_name] = self._mcap.register_schema(type_name, "ros2msg", text)
            number = self._mcap.register_channel(
                topic, "cdr", self._schemas[type_name], {"offered_qos_profiles": ""}
            )
            known = self.channels[topic] = OpenChannel(number, type_name)
            self._uncopied[number] = (topic, type_name)
        return known

    def append(self, channel: OpenChannel, time_ns: int, publish_ns: int, payload: bytes) -> None:
        """Add one message to the chunk in progress; now and then that writes the chunk."""
        self.safe.waiting += 1
        self._mcap.add_message(channel.number, time_ns, payload, publish_ns, channel.sequence)
        channel.sequence = (channel.sequence + 1) & 0xFFFFFFFF
        channel.last_log_time_ns = time_ns
        if self._file.tell() != self.safe.position:  # mcap has just written out a chunk
            self._mark_safe()

    def flush(self) -> None:
        """Write out the chunk in progress."""
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._mark_safe()
        if self._uncopied:
            self._attach(Attachment(CHANNELS_COPY, MEDIA_TYPE, channels_copy(self._uncopied)))
            self._uncopied.clear()
            self._mark_safe()

    def sync(self) -> None:
        """Wait until what has been written is on the disk; any thread may."""
        self._file.sync()

    def finish(self) -> None:
        """Write the summary, sync, and give the file its final name."""
        self._mcap.finish()  # type: ignore[no-untyped-call]
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

    def _attach(self, one: Attachment) -> None:
        self._mcap.add_attachment(
            one.log_time_ns, one.log_time_ns, one.name, one.media_type, one.data
        )

    def _mark_safe(self) -> None:
        self.safe.position = self._file.tell()
        self.safe.waiting = 0
