"""Open one chunk: unpack it within bounds, check it, and find its messages.

What to use when: under `reader`. `unpack` gives the bytes, `message_offsets` where each
channel's messages begin, proven by accounting for every byte of the chunk.

Theory of operation: the message indexes behind a chunk carry no checksum, so they are
only a hint. The offsets they give are taken when records of the lengths found there
fill the chunk without gap or overlap (schemas and channels may lie between); otherwise
the chunk is walked record by record, which gives the same at a third of the speed.
Chunks of a second are small, and numpy's calls cost more than their content: several are
proven together (`open_together`), and one by one only where that fails.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zstandard

from gyrorig_protocol.recording.definitions import Declared
from gyrorig_protocol.recording.fields import Buffer, Fields, MalformedError
from gyrorig_protocol.recording.framing import ChunkRecord
from gyrorig_protocol.recording.losses import LossCause

Offsets = npt.NDArray[np.int64]

# A 31 kB file can claim 2 GB. Real chunks unpack to about 1 MiB, at 2 to 10 times.
MAX_UNPACKED_BYTES = 64 << 20
MAX_RATIO = 200

RECORD_BYTES = 31  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIELDS_BYTES = 22
_MESSAGE = 0x05
_FRAME = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQH")


class ChunkError(Exception):
    """A chunk that cannot be used; never leaves this package."""

    def __init__(self, cause: LossCause, why: str) -> None:
        super().__init__(why)
        self.cause = cause


class Unpacker:
    """Unpacks chunks within bounds, whatever their headers claim."""

    def __init__(self) -> None:
        self._zstd = zstandard.ZstdDecompressor(max_window_size=MAX_UNPACKED_BYTES)

    def unpack(self, chunk: ChunkRecord, data: memoryview) -> Buffer:
        """The chunk's bytes, of the declared size and with the right checksum.

        Raises:
            ChunkError: they are not.
        """
        packed = data[chunk.data_start : chunk.data_end]
        size = chunk.unpacked_size
        if size > MAX_UNPACKED_BYTES or size > MAX_RATIO * len(packed):
            why = f"{len(packed)} bytes claim to unpack to {size}"
            raise ChunkError(LossCause.REFUSED, why)
        try:
            content = self._content(chunk.compression, packed, size)
        except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
            raise ChunkError(LossCause.DAMAGED, f"it does not unpack ({error})") from error
        if len(content) != size:
            raise ChunkError(LossCause.DAMAGED, f"{len(content)} bytes where {size} were declared")
        if chunk.crc and zlib.crc32(content) != chunk.crc:
            raise ChunkError(LossCause.DAMAGED, "its checksum is wrong")
        return content

    def _content(self, compression: str, packed: memoryview, size: int) -> Buffer:
        if compression == "":
            return packed
        if compression == "zstd":
            # The frame's own size governs what the library allocates, not our limit.
            claimed = zstandard.get_frame_parameters(packed).content_size
            if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                why = f"its frame claims {claimed} bytes where {size} were declared"
                raise ChunkError(LossCause.REFUSED, why)
            return self._zstd.decompress(packed, max_output_size=size, allow_extra_data=False)
        if compression == "lz4":
            unpacker = lz4.frame.LZ4FrameDecompressor()
            content: bytes = unpacker.decompress(packed, max_length=size + 1)
            if not unpacker.eof or unpacker.unused_data:
                raise ChunkError(LossCause.REFUSED, f"it does not end at the declared {size} bytes")
            return content
        raise ChunkError(LossCause.DAMAGED, f"its compression {compression[:20]!r} is unknown")


@dataclass(slots=True)
class ChunkContent:
    """Where the messages of one chunk begin, by channel, and what it declares."""

    offsets: dict[int, Offsets] = field(default_factory=dict)
    declared: Declared = field(default_factory=Declared)


def open_chunk(chunk: ChunkRecord, content: Buffer, file: memoryview) -> ChunkContent:
    """Find the messages of an unpacked chunk, by its indexes or without them.

    Raises:
        ChunkError: the content is no sequence of whole records.
    """
    if chunk.index and chunk.index_sound:
        try:
            return _by_index(chunk, content, file)
        except MalformedError:
            pass  # an index carries no checksum; the records themselves decide
    try:
        return _by_lengths(content)
    except MalformedError as error:
        raise ChunkError(LossCause.DAMAGED, str(error)) from error


def gather(content: Buffer, size: int, offsets: Offsets) -> npt.NDArray[np.void]:
    """The `size` bytes at each offset, all of them inside `content`, shape (n,).

    Untyped bytes on purpose: numpy would copy a structured type field by field.
    """
    whole = np.dtype((np.void, size))
    places = max(len(content) - size + 1, 0)
    every: npt.NDArray[np.void] = np.ndarray(places, whole, buffer=content, strides=(1,))
    return every[offsets]


# Lengths as signed numbers: one that is too large for that is negative, and refused.
_HEAD = np.dtype([("opcode", "u1"), ("length", "<i8"), ("channel", "<u2")])


def open_together(
    chunks: Sequence[ChunkRecord], joined: Buffer, file: memoryview
) -> dict[int, Offsets] | None:
    """Find the messages of several unpacked chunks at once, as cheaply as those of one.

    Args:
        chunks: their records.
        joined: their contents, one behind the other.
        file: where their indexes are.

    Returns:
        Where each channel's messages begin in `joined`; None where the indexes do not
        prove that whole messages fill every chunk, and each has to be opened by itself.
    """
    parts: dict[int, list[Offsets]] = {}
    bases, base = [], 0
    for chunk in chunks:
        if not chunk.index_sound:
            return None
        bases.append(base)
        for channel, (start, count) in chunk.index.items():
            if count:
                entries = np.frombuffer(file, dtype="<i8", count=2 * count, offset=start)
                parts.setdefault(channel, []).append(entries[1::2] + base)
        base += chunk.unpacked_size
    if not parts:
        return None
    offsets = {channel: np.concatenate(found) for channel, found in parts.items()}
    try:
        begins, ends = _proven(offsets, joined)
    except MalformedError:
        return None
    whole = int(begins[0]) == 0 and int(ends[-1]) == len(joined)
    if not whole or (begins[1:] != ends[:-1]).any():
        return None
    # A message must not begin in one chunk and end in the next.
    at = np.searchsorted(begins, bases)
    if int(at[-1]) >= len(begins) or (begins[at] != bases).any():
        return None
    return offsets


def _by_index(chunk: ChunkRecord, content: Buffer, file: memoryview) -> ChunkContent:
    found = ChunkContent()
    for channel, (start, count) in chunk.index.items():
        if count:
            entries = np.frombuffer(file, dtype="<i8", count=2 * count, offset=start)
            found.offsets[channel] = entries[1::2].copy()
    if not found.offsets:
        raise MalformedError("an index without entries")
    begins, ends = _proven(found.offsets, content)
    size = len(content)
    if int(begins[0]) > 0:
        _declare(found, content, 0, int(begins[0]))
    gaps = begins[1:] - ends[:-1]
    if gaps.any():
        if int(gaps.min()) < 0:
            raise MalformedError("an index points at overlapping records")
        for at in np.flatnonzero(gaps):
            _declare(found, content, int(ends[at]), int(begins[at + 1]))
    _declare(found, content, int(ends[-1]), size)
    return found


def _proven(offsets: dict[int, Offsets], content: Buffer) -> tuple[Offsets, Offsets]:
    """Where messages begin and end, in order, if each is one of its channel.

    Raises:
        MalformedError: one is not.
    """
    places = np.concatenate(list(offsets.values()))
    # Runs that are in order already merge in nearly linear time.
    order = places.argsort(kind="stable")
    begins = places[order]
    size = len(content)
    if not 0 <= int(begins[0]) <= int(begins[-1]) <= size - RECORD_BYTES:
        raise MalformedError("an index points outside its chunk")
    heads = gather(content, _HEAD.itemsize, begins).view(_HEAD)
    lengths = heads["length"]
    if int(lengths.min()) < _MESSAGE_FIELDS_BYTES or int(lengths.max()) > size:
        raise MalformedError("an index points at no message")
    if (heads["opcode"] != _MESSAGE).any() or (heads["channel"] != _numbers(offsets)[order]).any():
        raise MalformedError("an index points at another record")
    return begins, begins + (lengths + _FRAME.size)


def _numbers(offsets: dict[int, Offsets]) -> npt.NDArray[np.uint16]:
    """The channel of each offset, in the order of the channels."""
    channels = np.array(list(offsets), dtype=np.uint16)
    return channels.repeat([len(found) for found in offsets.values()])


def _declare(found: ChunkContent, content: Buffer, at: int, limit: int) -> None:
    """Take in the schemas and channels that fill `content[at:limit]`, if anything does."""
    if at > limit:
        raise MalformedError("a message runs over its chunk")
    while at < limit:
        if at + _FRAME.size > limit:
            raise MalformedError("a record ends inside its frame")
        opcode, length = _FRAME.unpack_from(content, at)
        fields = Fields(content, at + _FRAME.size, at + _FRAME.size + length)
        if fields.end > limit:
            raise MalformedError("a record runs over its chunk")
        if opcode == 0x03:
            found.declared.add_schema(fields)
        elif opcode == 0x04:
            found.declared.add_channel(fields)
        else:
            raise MalformedError(f"a record of kind {opcode:#04x} where none belongs")
        at = fields.end


def _by_lengths(content: Buffer) -> ChunkContent:
    found = ChunkContent()
    places: dict[int, list[int]] = {}
    at, limit, unpack = 0, len(content), _MESSAGE_HEAD.unpack_from
    while at < limit:
        if at + RECORD_BYTES <= limit:
            opcode, length, channel = unpack(content, at)
            end = at + _FRAME.size + length
            if opcode == _MESSAGE and length >= _MESSAGE_FIELDS_BYTES and end <= limit:
                places.setdefault(channel, []).append(at)
                at = end
                continue
        at = _declare_one(found, content, at, limit)
    found.offsets = {channel: np.array(at, dtype=np.int64) for channel, at in places.items()}
    return found


def _declare_one(found: ChunkContent, content: Buffer, at: int, limit: int) -> int:
    """Take in one schema or channel at `at`; returns its end."""
    if at + _FRAME.size > limit:
        raise MalformedError("a record ends inside its frame")
    _, length = _FRAME.unpack_from(content, at)
    end = at + _FRAME.size + int(length)
    if end > limit:
        raise MalformedError("a record runs over its chunk")
    _declare(found, content, at, end)
    return end
