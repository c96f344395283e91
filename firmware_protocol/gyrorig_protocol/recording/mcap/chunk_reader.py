"""Chunk reader: unpack a chunk within limits, verify it, and locate its messages.

What to use when: `ChunkDecompressor` returns the bytes of a chunk; `locate_messages` returns the
offsets of each channel's messages, after every byte of the chunk was accounted for.

Theory of operation: the message indexes after a chunk have no checksum, therefore they are only a
hint. Their offsets are used if records of the lengths found there fill the chunk without gap or
overlap (schemas and channels can be between them). Otherwise the chunk is read record by record,
which gives the same result at a third of the speed. Chunks of one second are small, and numpy calls
cost more than their content. Several chunks are therefore verified together
(`locate_messages_in_group`), and one by one only if that fails.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zstandard

from gyrorig_protocol.recording.mcap.declarations import Declarations
from gyrorig_protocol.recording.mcap.losses import LossCause
from gyrorig_protocol.recording.mcap.record_cursor import Buffer, MalformedError, RecordCursor
from gyrorig_protocol.recording.mcap.record_scan import ChunkRecord

Offsets = npt.NDArray[np.int64]

# A file of 31 kB can declare 2 GB. Real chunks have about 1 MiB, with a ratio of 2 to 10.
MAX_UNPACKED_BYTES = 64 << 20
MAX_RATIO = 200

RECORD_BYTES = 31  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIELDS_BYTES = 22
_MESSAGE_OPCODE = 0x05
_FRAME_LAYOUT = struct.Struct("<BQ")
_MESSAGE_HEAD_LAYOUT = struct.Struct("<BQH")


class ChunkError(Exception):
    """A chunk cannot be used; never raised out of this package."""

    def __init__(self, cause: LossCause, reason: str) -> None:
        super().__init__(reason)
        self.cause = cause


class ChunkDecompressor:
    """Decompress chunks within limits that do not depend on their headers."""

    def __init__(self) -> None:
        self._zstd = zstandard.ZstdDecompressor(max_window_size=MAX_UNPACKED_BYTES)

    def decompress_chunk(self, chunk: ChunkRecord, data: memoryview) -> Buffer:
        """Return the chunk's bytes, of the declared size and with a valid checksum.

        Raises:
            ChunkError: the size or the checksum is wrong, or the chunk cannot be unpacked.
        """
        compressed = data[chunk.data_start : chunk.data_end]
        size = chunk.unpacked_size
        if size > MAX_UNPACKED_BYTES or size > MAX_RATIO * len(compressed):
            reason = (
                f"the compressed data ({len(compressed)} bytes) claim an unpacked size of "
                f"{size} bytes, which is more than the limit"
            )
            raise ChunkError(LossCause.REFUSED, reason)
        try:
            content = self._decompress_bytes(chunk.compression, compressed, size)
        except (zstandard.ZstdError, RuntimeError) as error:
            raise ChunkError(LossCause.DAMAGED, f"it cannot be unpacked ({error})") from error
        if len(content) != size:
            raise ChunkError(
                LossCause.DAMAGED,
                f"it unpacks to {len(content)} bytes instead of the declared {size}",
            )
        if chunk.crc and zlib.crc32(content) != chunk.crc:
            raise ChunkError(LossCause.DAMAGED, "its checksum is wrong")
        return content

    def _decompress_bytes(self, compression: str, compressed: memoryview, size: int) -> Buffer:
        if compression == "":
            return compressed
        if compression == "zstd":
            # The library allocates the size in the frame, not our limit.
            claimed_size = zstandard.get_frame_parameters(compressed).content_size
            if claimed_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                reason = f"its frame declares {claimed_size} bytes instead of {size}"
                raise ChunkError(LossCause.REFUSED, reason)
            return self._zstd.decompress(compressed, max_output_size=size, allow_extra_data=False)
        if compression == "lz4":
            decompressor = lz4.frame.LZ4FrameDecompressor()
            content: bytes = decompressor.decompress(compressed, max_length=size + 1)
            if not decompressor.eof or decompressor.unused_data:
                raise ChunkError(LossCause.REFUSED, f"it does not end at the declared {size} bytes")
            return content
        raise ChunkError(LossCause.DAMAGED, f"its compression {compression[:20]!r} is unknown")


@dataclass(slots=True)
class ChunkContent:
    """The offsets of one chunk's messages by channel, and its declarations."""

    offsets: dict[int, Offsets] = field(default_factory=dict)
    declarations: Declarations = field(default_factory=Declarations)


def locate_messages(chunk: ChunkRecord, content: Buffer, file: memoryview) -> ChunkContent:
    """Locate the messages of an unpacked chunk, with or without its indexes.

    Raises:
        ChunkError: the content is not a sequence of complete records.
    """
    if chunk.index and chunk.is_index_valid:
        try:
            return _locate_by_index(chunk, content, file)
        except MalformedError:
            pass  # an index has no checksum; the records decide
    try:
        return _locate_by_lengths(content)
    except MalformedError as error:
        raise ChunkError(LossCause.DAMAGED, str(error)) from error


def gather_records(content: Buffer, size: int, offsets: Offsets) -> npt.NDArray[np.void]:
    """Return the `size` bytes at each offset, all inside `content`, shape (n,).

    The dtype is untyped, because numpy would copy a structured type field by field.
    """
    record_dtype = np.dtype((np.void, size))
    window_count = max(len(content) - size + 1, 0)
    windows: npt.NDArray[np.void] = np.ndarray(
        window_count, record_dtype, buffer=content, strides=(1,)
    )
    return windows[offsets]


# Lengths are signed: a length that is too large becomes negative and is rejected.
_RECORD_HEAD_DTYPE = np.dtype([("opcode", "u1"), ("length", "<i8"), ("channel", "<u2")])


def locate_messages_in_group(
    chunks: Sequence[ChunkRecord], joined: Buffer, file: memoryview
) -> dict[int, Offsets] | None:
    """Locate the messages of several unpacked chunks at once, at the cost of one.

    Args:
        chunks: the chunk records.
        joined: their contents, concatenated.
        file: the file with their indexes.

    Returns:
        The offsets of each channel's messages in `joined`; None if the indexes do not prove that
        complete messages fill every chunk. Then each chunk must be read separately.
    """
    parts: dict[int, list[Offsets]] = {}
    chunk_starts, chunk_start = [], 0
    for chunk in chunks:
        if not chunk.is_index_valid:
            return None
        chunk_starts.append(chunk_start)
        for channel, (start, count) in chunk.index.items():
            if count:
                entries = np.frombuffer(file, dtype="<i8", count=2 * count, offset=start)
                parts.setdefault(channel, []).append(entries[1::2] + chunk_start)
        chunk_start += chunk.unpacked_size
    if not parts:
        return None
    offsets = {channel: np.concatenate(channel_parts) for channel, channel_parts in parts.items()}
    try:
        begins, ends = _verify_offsets(offsets, joined)
    except MalformedError:
        return None
    fills_group = int(begins[0]) == 0 and int(ends[-1]) == len(joined)
    if not fills_group or (begins[1:] != ends[:-1]).any():
        return None
    # No message may begin in one chunk and end in the next.
    first_messages = np.searchsorted(begins, chunk_starts)
    if int(first_messages[-1]) >= len(begins) or (begins[first_messages] != chunk_starts).any():
        return None
    return offsets


def _locate_by_index(chunk: ChunkRecord, content: Buffer, file: memoryview) -> ChunkContent:
    chunk_content = ChunkContent()
    for channel, (start, count) in chunk.index.items():
        if count:
            entries = np.frombuffer(file, dtype="<i8", count=2 * count, offset=start)
            chunk_content.offsets[channel] = entries[1::2].copy()
    if not chunk_content.offsets:
        raise MalformedError("an index has no entries")
    begins, ends = _verify_offsets(chunk_content.offsets, content)
    size = len(content)
    if int(begins[0]) > 0:
        _read_declarations(chunk_content, content, 0, int(begins[0]))
    gaps = begins[1:] - ends[:-1]
    if gaps.any():
        if int(gaps.min()) < 0:
            raise MalformedError("an index points at overlapping records")
        for gap_index in np.flatnonzero(gaps):
            _read_declarations(
                chunk_content, content, int(ends[gap_index]), int(begins[gap_index + 1])
            )
    _read_declarations(chunk_content, content, int(ends[-1]), size)
    return chunk_content


def _verify_offsets(offsets: dict[int, Offsets], content: Buffer) -> tuple[Offsets, Offsets]:
    """Return the sorted begins and ends of the messages after verifying each.

    Raises:
        MalformedError: an offset is not that of a message of its channel.
    """
    all_offsets = np.concatenate(list(offsets.values()))
    # Merging sorted runs takes nearly linear time.
    order = all_offsets.argsort(kind="stable")
    begins = all_offsets[order]
    size = len(content)
    if not 0 <= int(begins[0]) <= int(begins[-1]) <= size - RECORD_BYTES:
        raise MalformedError("an index points outside its chunk")
    heads = gather_records(content, _RECORD_HEAD_DTYPE.itemsize, begins).view(_RECORD_HEAD_DTYPE)
    lengths = heads["length"]
    if int(lengths.min()) < _MESSAGE_FIELDS_BYTES or int(lengths.max()) > size:
        raise MalformedError("an index does not point at a message")
    if (heads["opcode"] != _MESSAGE_OPCODE).any() or (
        heads["channel"] != _channel_of_each_offset(offsets)[order]
    ).any():
        raise MalformedError("an index points at another record")
    return begins, begins + (lengths + _FRAME_LAYOUT.size)


def _channel_of_each_offset(offsets: dict[int, Offsets]) -> npt.NDArray[np.uint16]:
    """Return the channel of each offset, in the order of the channels."""
    channels = np.array(list(offsets), dtype=np.uint16)
    return channels.repeat([len(channel_offsets) for channel_offsets in offsets.values()])


def _read_declarations(
    chunk_content: ChunkContent, content: Buffer, offset: int, limit: int
) -> None:
    """Read the schemas and channels that fill `content[at:limit]`, if anything does."""
    if offset > limit:
        raise MalformedError("a message exceeds its chunk")
    while offset < limit:
        if offset + _FRAME_LAYOUT.size > limit:
            raise MalformedError("a record ends inside its frame")
        opcode, length = _FRAME_LAYOUT.unpack_from(content, offset)
        cursor = RecordCursor(
            content, offset + _FRAME_LAYOUT.size, offset + _FRAME_LAYOUT.size + length
        )
        if cursor.end > limit:
            raise MalformedError("a record exceeds its chunk")
        if opcode == 0x03:
            chunk_content.declarations.add_schema(cursor)
        elif opcode == 0x04:
            chunk_content.declarations.add_channel(cursor)
        else:
            raise MalformedError(f"a record of kind {opcode:#04x} is not allowed here")
        offset = cursor.end


def _locate_by_lengths(content: Buffer) -> ChunkContent:
    chunk_content = ChunkContent()
    message_offsets: dict[int, list[int]] = {}
    offset, limit, unpack_head = 0, len(content), _MESSAGE_HEAD_LAYOUT.unpack_from
    while offset < limit:
        if offset + RECORD_BYTES <= limit:
            opcode, length, channel = unpack_head(content, offset)
            end = offset + _FRAME_LAYOUT.size + length
            if opcode == _MESSAGE_OPCODE and length >= _MESSAGE_FIELDS_BYTES and end <= limit:
                message_offsets.setdefault(channel, []).append(offset)
                offset = end
                continue
        offset = _read_declaration(chunk_content, content, offset, limit)
    chunk_content.offsets = {
        channel: np.array(offset, dtype=np.int64) for channel, offset in message_offsets.items()
    }
    return chunk_content


def _read_declaration(chunk_content: ChunkContent, content: Buffer, offset: int, limit: int) -> int:
    """Read one schema or channel at `offset`; return its end."""
    if offset + _FRAME_LAYOUT.size > limit:
        raise MalformedError("a record ends inside its frame")
    _, length = _FRAME_LAYOUT.unpack_from(content, offset)
    end = offset + _FRAME_LAYOUT.size + int(length)
    if end > limit:
        raise MalformedError("a record exceeds its chunk")
    _read_declarations(chunk_content, content, offset, end)
    return end
