"""Walk the top-level records of an MCAP file that may be cut or damaged anywhere.

What to use when: under `reader`. `walk` finds chunks (without opening them), metadata
and attachments, and states every byte that it could not use.

Theory of operation: records are a byte of opcode and eight of length. Where a record
does not hold what its opcode says, either its content is damaged, and its length still
leads to the next record, or its length is, and the walk would read noise. So the walk
goes by the length only when that leads to something that looks like a record and does
not jump over a landmark; else it goes on at the next landmark. Landmarks are chunks,
whose header is redundant enough to be recognised, and our own checksummed copies,
which are known by their names (`_LANDMARK`).

Source: the MCAP format specification, section "Records".
"""

import re
import struct
import zlib
from dataclasses import dataclass, field, replace
from enum import IntEnum

from gyrorig_protocol.recording.definitions import Declared
from gyrorig_protocol.recording.fields import Fields, MalformedError
from gyrorig_protocol.recording.losses import Loss, LossCause
from gyrorig_protocol.recording.mapped import Passage
from gyrorig_protocol.recording.summary import MAGIC, Summary

FRAME_BYTES = 9  # opcode and length
_FRAME = struct.Struct("<BQ")
_MAX_COPY_BYTES = 1 << 20  # a search tries each, so that none may cost much
# A chunk: opcode, length, three times u64 and the CRC, then one of the three compressions.
# A copy (see `copies`): opcode, length, two times u64, a name that begins with ours.
_LANDMARK = re.compile(
    rb"\x06.{36}(?:\x00\x00\x00\x00|\x03\x00\x00\x00lz4|\x04\x00\x00\x00zstd)"
    rb"|\x09.{24}.\x00\x00\x00gyrorig\.",
    re.DOTALL,
)


class Opcode(IntEnum):
    """Opcodes that may appear before the summary."""

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
    """A chunk, not yet opened, and the message indexes behind it."""

    offset: int
    size: int  # of the record with its frame
    unpacked_size: int  # as declared
    crc: int
    compression: str
    data_start: int
    data_end: int
    index: dict[int, tuple[int, int]] = field(default_factory=dict)  # channel: (offset, count)
    index_sound: bool = True

    @property
    def indexed_messages(self) -> int | None:
        """How many messages the indexes promise; None without any."""
        return sum(count for _, count in self.index.values()) if self.index else None


@dataclass(frozen=True, slots=True)
class AttachmentRecord:
    """An attachment whose checksum is right."""

    name: str
    media_type: str
    data: bytes
    log_time_ns: int


@dataclass(slots=True)
class Walk:
    """What the walk has found so far."""

    chunks: list[ChunkRecord] = field(default_factory=list)
    metadata: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    attachments: list[AttachmentRecord] = field(default_factory=list)
    declared: Declared = field(default_factory=Declared)  # outside chunks: no checksum
    profile: str = ""
    losses: list[Loss] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    data_end: bool = False
    current: ChunkRecord | None = None  # the chunk that an index now would belong to
    loose_messages: int = 0
    landmark: int = 0  # the next one, as far as it has been searched for


def walk(data: memoryview, summary: Summary) -> Walk:
    """Walk the data section of a file that begins with the magic."""
    found = Walk()
    limit = summary.start if summary.sound else len(data)
    at = len(MAGIC)
    passage = Passage(data)
    while at < limit and not found.data_end:
        passage.reached(at)
        end = at + FRAME_BYTES
        try:
            if end > limit:
                raise MalformedError("the file ends inside a record")
            opcode, length = _FRAME.unpack_from(data, at)
            end += length
            if end > limit:
                raise MalformedError("a record runs over the end of the file")
            _take(found, data, opcode, at, end)
            at = end
        except MalformedError as error:
            at = _step_over(found, data, at, end, limit, str(error))
    _state_the_end(found, summary, at, len(data))
    if found.loose_messages:
        text = f"{found.loose_messages} messages outside chunks, without a checksum, are not read"
        found.losses.append(Loss(LossCause.REFUSED, 0, 0, found.loose_messages, text))
    return found


def _take(found: Walk, data: memoryview, opcode: int, at: int, end: int) -> None:
    """Take in the record at `at`; raises MalformedError when it is none."""
    fields = Fields(data, at + FRAME_BYTES, end)
    if opcode == Opcode.MESSAGE_INDEX:
        _take_index(found, fields, at)
        return
    found.current = None
    match opcode:
        case Opcode.CHUNK:
            found.chunks.append(_chunk(fields, at))
            found.current = found.chunks[-1]
        case Opcode.METADATA:
            record = (fields.text(), fields.text_map())
            fields.done()
            found.metadata.append(record)
        case Opcode.ATTACHMENT:
            _take_attachment(found, data, fields, at)
        case Opcode.DATA_END:
            _take_data_end(found, data, fields, at)
        case Opcode.HEADER:
            found.profile = fields.text()
            fields.text()
            fields.done()
        case Opcode.SCHEMA:
            found.declared.add_schema(fields)
        case Opcode.CHANNEL:
            found.declared.add_channel(fields)
        case Opcode.MESSAGE:
            fields.skip(22)  # channel, sequence and two times
            found.loose_messages += 1
        case _:
            raise MalformedError(f"a record of the unknown kind {opcode:#04x}")


def _chunk(fields: Fields, at: int) -> ChunkRecord:
    fields.skip(16)  # first and last log time, which carry no checksum and are not needed
    unpacked_size, crc = fields.number(8), fields.number(4)
    compression = fields.text()
    size = fields.number(8)
    start = fields.skip(size)
    fields.done()
    return ChunkRecord(at, fields.end - at, unpacked_size, crc, compression, start, start + size)


def _take_index(found: Walk, fields: Fields, at: int) -> None:
    channel, size = fields.number(2), fields.number(4)
    start = fields.skip(size)
    fields.done()
    if size % 16:
        raise MalformedError("a message index with half an entry")
    chunk = found.current
    if chunk is not None:
        chunk.index_sound &= channel not in chunk.index
        chunk.index[channel] = (start, size // 16)
    elif found.losses:  # of the chunk that has just been lost
        lost = found.losses[-1]
        found.losses[-1] = replace(
            lost,
            bytes=lost.bytes + fields.end - at,
            messages=(lost.messages or 0) + size // 16,
        )


def _take_attachment(found: Walk, data: memoryview, fields: Fields, at: int) -> None:
    start = fields.at
    log_time_ns = fields.number(8)
    fields.skip(8)  # creation time
    name, media_type, content = fields.text(), fields.text(), fields.raw(8)
    crc_at = fields.at
    crc = fields.number(4)
    fields.done()
    if crc and zlib.crc32(data[start:crc_at]) != crc:
        text = f"attachment {name[:40]!r} at byte {at} has a wrong checksum"
        found.losses.append(Loss(LossCause.DAMAGED, at, fields.end - at, 0, text))
        return
    found.attachments.append(AttachmentRecord(name, media_type, content, log_time_ns))


def _take_data_end(found: Walk, data: memoryview, fields: Fields, at: int) -> None:
    crc = fields.number(4)
    fields.done()
    found.data_end = True
    if crc and zlib.crc32(data[:at]) != crc:
        text = "the checksum over everything but the summary is wrong: metadata may be changed"
        found.losses.append(Loss(LossCause.DAMAGED, at, 0, 0, text))


def _step_over(found: Walk, data: memoryview, at: int, end: int, limit: int, why: str) -> int:
    """Where to go on behind a record that is none; states the loss."""
    found.current = None
    if found.landmark <= at:
        found.landmark = _next_landmark(data, at + 1, limit)
    by_length = end <= found.landmark and _looks_like_record(data, end, limit)
    target = end if by_length else found.landmark
    if target == limit and not by_length:
        cut = end > limit and limit == len(data)
        cause = LossCause.TRUNCATED if cut else LossCause.DAMAGED
        text = f"{why}: the last {limit - at} bytes, from byte {at} on, are no use"
        found.losses.append(Loss(cause, at, limit - at, None, text))
        return limit
    if found.losses and found.losses[-1].offset + found.losses[-1].bytes == at:
        at = found.losses.pop().offset  # one damaged stretch is one loss
    text = f"{why}: {target - at} bytes from byte {at} on are no use"
    found.losses.append(Loss(LossCause.DAMAGED, at, target - at, None, text))
    return target


def _looks_like_record(data: memoryview, at: int, limit: int) -> bool:
    if at == limit:
        return True
    if at + FRAME_BYTES > limit:
        return False
    opcode, length = _FRAME.unpack_from(data, at)
    return opcode in _OPCODES and at + FRAME_BYTES + length <= limit


def _next_landmark(data: memoryview, start: int, limit: int) -> int:
    """Where the next chunk or copy begins at or behind `start`, else `limit`."""
    at = start - 1
    while match := _LANDMARK.search(data, at + 1, limit):
        at = match.start()
        end = at + FRAME_BYTES + int.from_bytes(data[at + 1 : at + FRAME_BYTES], "little")
        copy_is_large = data[at] == Opcode.ATTACHMENT and end - at > _MAX_COPY_BYTES
        if end <= limit and not copy_is_large:
            try:
                _take(Walk(), data, data[at], at, end)
            except MalformedError:
                continue
            return at
    return limit


def _state_the_end(found: Walk, summary: Summary, at: int, size: int) -> None:
    if summary.sound:
        if at < summary.start:
            text = f"{summary.start - at} bytes between the data and the summary are no use"
            found.losses.append(Loss(LossCause.DAMAGED, at, summary.start - at, 0, text))
    elif found.data_end:
        text = f"the index at the end is damaged or cut ({summary.fault}); no message is in it"
        found.losses.append(Loss(LossCause.SUMMARY, at, size - at, 0, text))
    else:
        text = "the file was not finished by its writer"
        found.losses.append(Loss(LossCause.UNFINISHED, size, 0, 0, text))
