"""Scan of the top-level records of an MCAP file that can be cut or damaged anywhere.

What to use when: `scan_records` finds chunks (without unpacking them), metadata and attachments.
It reports every byte that it could not use.

Theory of operation: a record begins with one byte of opcode and eight bytes of length. If the
content of a record does not match its opcode, either the content is damaged and its length still
leads to the next record, or the length is damaged and leads to noise. The scan therefore trusts the
length only if it leads to something that looks like a record and does not jump over a landmark.
Otherwise it continues at the next landmark. Landmarks are chunks, whose header is redundant enough
to be recognised, and our own backup copies with a checksum, recognised by their names
(`_LANDMARK_PATTERN`).

Source: the MCAP format specification, section "Records".
"""

import re
import struct
import zlib
from dataclasses import dataclass, field, replace
from enum import IntEnum

from gyrorig_protocol.recording.mcap.declarations import Declarations
from gyrorig_protocol.recording.mcap.losses import Loss, LossCause
from gyrorig_protocol.recording.mcap.mapped_file import PageReleaser
from gyrorig_protocol.recording.mcap.mcap_summary import MAGIC, McapSummary
from gyrorig_protocol.recording.mcap.record_cursor import MalformedError, RecordCursor

FRAME_BYTES = 9  # opcode and length
_FRAME_LAYOUT = struct.Struct("<BQ")
_MAX_COPY_BYTES = 1 << 20  # a search reads each candidate, therefore a limit
# Candidates can overlap. All searches together read this many bytes of candidates, and no more
# than the file has.
_MIN_SEARCHED_BYTES = 8 << 20
# A chunk: opcode, length, three times u64 and the CRC, then one of the three compressions.
# A copy (see `backup_copies`): opcode, length, two times u64, a name that begins with gyrorig.
_LANDMARK_PATTERN = re.compile(
    rb"\x06.{36}(?:\x00\x00\x00\x00|\x03\x00\x00\x00lz4|\x04\x00\x00\x00zstd)"
    rb"|\x09.{24}.\x00\x00\x00gyrorig\.",
    re.DOTALL,
)


class Opcode(IntEnum):
    """Opcodes that can occur before the summary."""

    HEADER = 0x01
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    ATTACHMENT = 0x09
    METADATA = 0x0C
    DATA_END = 0x0F


_OPCODES = frozenset(Opcode)


@dataclass(slots=True)
class ChunkRecord:
    """A chunk, not yet unpacked, and the message indexes after it."""

    offset: int
    size: int  # of the record with its frame
    unpacked_size: int  # as declared
    crc: int
    compression: str
    data_start: int
    data_end: int
    index: dict[int, tuple[int, int]] = field(default_factory=dict)  # channel: (offset, count)
    is_index_valid: bool = True

    @property
    def indexed_messages(self) -> int | None:
        """Number of messages by the indexes; None without indexes."""
        return sum(count for _, count in self.index.values()) if self.index else None


@dataclass(frozen=True, slots=True)
class AttachmentRecord:
    """An attachment with a valid checksum."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int


@dataclass(slots=True)
class FileScan:
    """The result of a scan."""

    chunks: list[ChunkRecord] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: list[AttachmentRecord] = field(default_factory=list)
    declarations: Declarations = field(default_factory=Declarations)  # outside chunks: no checksum
    profile: str = ""
    losses: list[Loss] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    has_data_end: bool = False
    current_chunk: ChunkRecord | None = None  # the chunk of the next message index
    unchunked_messages: int = 0
    next_landmark: int = 0  # offset of the next landmark, if already searched
    searched_bytes: int = 0  # of copies that a search for landmarks has read


def scan_records(data: memoryview, summary: McapSummary) -> FileScan:
    """Scan the data section of a file that begins with `MAGIC`."""
    scan = FileScan()
    limit = summary.start_offset if summary.is_valid else len(data)
    offset = len(MAGIC)
    page_releaser = PageReleaser(data)
    while offset < limit and not scan.has_data_end:
        page_releaser.release_before(offset)
        end = offset + FRAME_BYTES
        try:
            if end > limit:
                raise MalformedError("the file ends inside a record")
            opcode, length = _FRAME_LAYOUT.unpack_from(data, offset)
            end += length
            if end > limit:
                raise MalformedError("a record exceeds the file")
            _read_record(scan, data, opcode, offset, end)
            offset = end
        except MalformedError as error:
            offset = _skip_damage(scan, data, offset, end, limit, str(error))
    _report_end(scan, data, summary, offset)
    if scan.unchunked_messages:
        text = (
            f"{scan.unchunked_messages} messages outside chunks have no checksum and are not read"
        )
        scan.losses.append(Loss(LossCause.REFUSED, 0, 0, scan.unchunked_messages, text))
    return scan


def _read_record(scan: FileScan, data: memoryview, opcode: int, offset: int, end: int) -> None:
    """Read the record at `offset`; raises MalformedError if it is invalid."""
    cursor = RecordCursor(data, offset + FRAME_BYTES, end)
    if opcode == Opcode.MESSAGE_INDEX:
        _read_index(scan, cursor, offset)
        return
    scan.current_chunk = None
    match opcode:
        case Opcode.CHUNK:
            scan.chunks.append(_read_chunk(cursor, offset))
            scan.current_chunk = scan.chunks[-1]
        case Opcode.METADATA:
            record = (cursor.read_text(), cursor.read_text_map())
            cursor.check_end()
            scan.metadata.append(record)
        case Opcode.ATTACHMENT:
            _read_attachment(scan, data, cursor, offset)
        case Opcode.DATA_END:
            _read_data_end(scan, data, cursor, offset)
        case Opcode.HEADER:
            scan.profile = cursor.read_text()
            cursor.read_text()
            cursor.check_end()
        case Opcode.SCHEMA:
            scan.declarations.add_schema(cursor)
        case Opcode.CHANNEL:
            scan.declarations.add_channel(cursor)
        case Opcode.MESSAGE:
            cursor.skip(22)  # channel, sequence and two times
            scan.unchunked_messages += 1
        case _:
            raise MalformedError(f"a record of unknown kind {opcode:#04x}")


def _read_chunk(cursor: RecordCursor, offset: int) -> ChunkRecord:
    cursor.skip(16)  # first and last log time: without a checksum, and not needed
    unpacked_size, crc = cursor.read_uint(8), cursor.read_uint(4)
    compression = cursor.read_text()
    size = cursor.read_uint(8)
    start = cursor.skip(size)
    cursor.check_end()
    return ChunkRecord(
        offset, cursor.end - offset, unpacked_size, crc, compression, start, start + size
    )


def _read_index(scan: FileScan, cursor: RecordCursor, offset: int) -> None:
    channel, size = cursor.read_uint(2), cursor.read_uint(4)
    start = cursor.skip(size)
    cursor.check_end()
    if size % 16:
        raise MalformedError("a message index has half an entry")
    chunk = scan.current_chunk
    if chunk is not None:
        chunk.is_index_valid &= channel not in chunk.index
        chunk.index[channel] = (start, size // 16)
    elif scan.losses:  # of the chunk that was just lost
        last_loss = scan.losses[-1]
        scan.losses[-1] = replace(
            last_loss,
            bytes=last_loss.bytes + cursor.end - offset,
            messages=(last_loss.messages or 0) + size // 16,
        )


def _read_attachment(scan: FileScan, data: memoryview, cursor: RecordCursor, offset: int) -> None:
    start = cursor.offset
    log_time_ns = cursor.read_uint(8)
    cursor.skip(8)  # creation time
    name, media_type, content = cursor.read_text(), cursor.read_text(), cursor.read_bytes(8)
    crc_offset = cursor.offset
    crc = cursor.read_uint(4)
    cursor.check_end()
    if crc and zlib.crc32(data[start:crc_offset]) != crc:
        text = f"attachment {name[:40]!r} at byte {offset} has a wrong checksum"
        scan.losses.append(Loss(LossCause.DAMAGED, offset, cursor.end - offset, 0, text))
        return
    scan.attachments.append(AttachmentRecord(name, media_type, content, log_time_ns))


def _read_data_end(scan: FileScan, data: memoryview, cursor: RecordCursor, offset: int) -> None:
    crc = cursor.read_uint(4)
    cursor.check_end()
    scan.has_data_end = True
    if crc and zlib.crc32(data[:offset]) != crc:
        text = "the checksum of the data section is wrong, metadata can be damaged"
        scan.losses.append(Loss(LossCause.DAMAGED, offset, 0, 0, text))


def _skip_damage(
    scan: FileScan, data: memoryview, offset: int, end: int, limit: int, reason: str
) -> int:
    """Return where to continue after an invalid record; report the loss."""
    scan.current_chunk = None
    if scan.next_landmark <= offset:
        scan.next_landmark = _find_landmark(scan, data, offset + 1, limit)
    is_length_plausible = end <= scan.next_landmark and _looks_like_record(data, end, limit)
    target = end if is_length_plausible else scan.next_landmark
    if target == limit and not is_length_plausible:
        is_truncated = end > limit and limit == len(data)
        cause = LossCause.TRUNCATED if is_truncated else LossCause.DAMAGED
        text = f"{reason}; the last {limit - offset} bytes, from byte {offset}, are unusable"
        scan.losses.append(Loss(cause, offset, limit - offset, None, text))
        return limit
    if scan.losses and scan.losses[-1].offset + scan.losses[-1].bytes == offset:
        offset = scan.losses.pop().offset  # adjacent damage is one loss
    text = f"{reason}; {target - offset} bytes from byte {offset} are unusable"
    scan.losses.append(Loss(LossCause.DAMAGED, offset, target - offset, None, text))
    return target


def _looks_like_record(data: memoryview, offset: int, limit: int) -> bool:
    if offset == limit:
        return True
    if offset + FRAME_BYTES > limit:
        return False
    opcode, length = _FRAME_LAYOUT.unpack_from(data, offset)
    return opcode in _OPCODES and offset + FRAME_BYTES + length <= limit


def _find_landmark(scan: FileScan, data: memoryview, start: int, limit: int) -> int:
    """Return the offset of the next chunk or copy at or after `start`, else `limit`.

    The checksum of each possible copy is computed. If these bytes together exceed a limit, only
    chunks are landmarks, so that the time is proportional to the size of the file.
    """
    max_searched_bytes = max(_MIN_SEARCHED_BYTES, len(data))
    offset = start - 1
    while match := _LANDMARK_PATTERN.search(data, offset + 1, limit):
        offset = match.start()
        end = (
            offset + FRAME_BYTES + int.from_bytes(data[offset + 1 : offset + FRAME_BYTES], "little")
        )
        if data[offset] == Opcode.ATTACHMENT:
            size = end - offset
            if size > _MAX_COPY_BYTES or scan.searched_bytes + size > max_searched_bytes:
                continue
            if end <= limit:
                scan.searched_bytes += size
        if end <= limit:
            try:
                _read_record(FileScan(), data, data[offset], offset, end)
            except MalformedError:
                continue
            return offset
    return limit


def _report_end(scan: FileScan, data: memoryview, summary: McapSummary, offset: int) -> None:
    size = len(data)
    if summary.is_valid:
        if offset < summary.start_offset:
            unused_bytes = summary.start_offset - offset
            text = f"{unused_bytes} bytes between the data and the summary are unusable"
            scan.losses.append(Loss(LossCause.DAMAGED, offset, unused_bytes, 0, text))
    elif scan.has_data_end and _find_landmark(scan, data, offset, size) < size:
        text = (
            f"{size - offset} bytes after the end of the data are not read, because they contain "
            "further chunks, for example of another recording"
        )
        scan.losses.append(Loss(LossCause.DAMAGED, offset, size - offset, None, text))
    elif scan.has_data_end:
        text = f"the summary at the end is damaged or cut ({summary.fault}); it has no messages"
        scan.losses.append(Loss(LossCause.SUMMARY, offset, size - offset, 0, text))
    else:
        text = "the writer did not finish the file"
        scan.losses.append(Loss(LossCause.UNFINISHED, size, 0, 0, text))
