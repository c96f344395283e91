"""Messages of an ArduPilot DataFlash log (.bin).

Source: ArduPilot, libraries/AP_Logger/LogStructure.h: a message begins with the
bytes 0xA3 0x95 and its type. The type 128 (FMT) describes another type: type, length, name (4
characters), format (16) and columns (64). The characters of the format are the table of
LogStructure.h; c, C, e and E are hundredths, L is 1e-7 degrees.
"""

import mmap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray

HEAD = b"\xa3\x95"
_FORMAT_TYPE = 128
_FORMAT_LENGTH = 89
_HEADER_LENGTH = 3
MAX_MESSAGES = 50_000_000  # of the wanted types
_CHUNK = 500_000  # messages that are converted at a time
_DTYPES = {
    "b": "i1", "B": "u1", "M": "u1", "h": "<i2", "H": "<u2", "c": "<i2", "C": "<u2",
    "i": "<i4", "I": "<u4", "L": "<i4", "e": "<i4", "E": "<u4", "f": "<f4", "d": "<f8",
    "q": "<i8", "Q": "<u8", "g": "<f2", "n": "S4", "N": "S16", "Z": "S64", "a": "(32,)<i2",
}  # fmt: skip
_SCALES = {"c": 0.01, "C": 0.01, "e": 0.01, "E": 0.01, "L": 1e-7}


@dataclass(frozen=True, slots=True)
class _MessageType:
    """What FMT says about one type."""

    name: str
    length: int
    dtype: np.dtype[np.void]
    scales: dict[str, float]


@dataclass(frozen=True, slots=True)
class DataflashLog:
    """The numeric columns of the messages by name, and what was left out."""

    columns: dict[str, dict[str, FloatArray]]  # message -> column -> values
    known: tuple[str, ...]  # the names of all messages that the log describes
    skipped_bytes: int


def read_dataflash(path: Path, wanted: frozenset[str]) -> DataflashLog:
    """Return the messages of the wanted types.

    Raises:
        InputError: the log describes no messages, or is too large.
    """
    size = path.stat().st_size
    if size < _FORMAT_LENGTH:
        raise InputError(
            f"the file {path.name} is too short for a DataFlash log",
            "download the log from the flight controller again",
        )
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        types, places, skipped = _scan(data, size, wanted)
        if not types:
            raise InputError(
                f"the file {path.name} contains no FMT message, so it is incomplete",
                "download the log from the flight controller again",
            )
        columns = {
            types[kind].name: _columns(data, types[kind], np.asarray(at, dtype=np.int64))
            for kind, at in places.items()
            if at
        }
    return DataflashLog(columns, tuple(sorted({t.name for t in types.values()})), skipped)


def _scan(
    data: mmap.mmap, size: int, wanted: frozenset[str]
) -> tuple[dict[int, _MessageType], dict[int, list[int]], int]:
    """Return the types, the places of the wanted messages, and the number of skipped bytes."""
    types: dict[int, _MessageType] = {}
    lengths = [0] * 256
    lengths[_FORMAT_TYPE] = _FORMAT_LENGTH
    places: dict[int, list[int]] = {}
    at = skipped = count = 0
    while at + _HEADER_LENGTH <= size:
        length = lengths[data[at + 2]]
        if data[at] != HEAD[0] or data[at + 1] != HEAD[1] or not length:
            following = data.find(HEAD, at + 1)
            skipped += (following if following >= 0 else size) - at
            if following < 0:
                break
            at = following
            continue
        if at + length > size:
            skipped += size - at
            break
        kind = data[at + 2]
        if kind == _FORMAT_TYPE:
            described = _message_type(data[at + _HEADER_LENGTH : at + length])
            if described is not None:
                new, message_type = described
                if new != _FORMAT_TYPE:
                    lengths[new] = message_type.length
                    types[new] = message_type
        elif kind in types and types[kind].name in wanted:
            places.setdefault(kind, []).append(at + _HEADER_LENGTH)
            count += 1
            if count > MAX_MESSAGES:
                raise InputError(
                    f"the log has more than {MAX_MESSAGES} messages of the gyroscopes",
                    "split the log, and import each part",
                )
        at += length
    return types, places, skipped


def _message_type(body: bytes) -> tuple[int, _MessageType] | None:
    """Return the type that an FMT message describes; None if it is not consistent."""
    kind, length = body[0], body[1]
    name, characters, names = (
        part.split(b"\0", 1)[0].decode("ascii", errors="replace")
        for part in (body[2:6], body[6:22], body[22:86])
    )
    columns = names.split(",")
    if (
        len(columns) != len(characters)
        or len(set(columns)) != len(columns)
        or not name
        or not all(columns)
    ):
        return None
    if any(character not in _DTYPES for character in characters):
        return None
    dtype = np.dtype(
        [(key, _DTYPES[character]) for key, character in zip(columns, characters, strict=True)]
    )
    if dtype.itemsize + _HEADER_LENGTH != length:
        return None
    scales = {
        key: _SCALES.get(character, 1.0)
        for key, character in zip(columns, characters, strict=True)
        if character not in "nNZa"
    }
    return kind, _MessageType(name, length, dtype, scales)


def _columns(data: mmap.mmap, kind: _MessageType, at: np.ndarray) -> dict[str, FloatArray]:
    """Return the numeric columns of the messages at these places."""
    raw = np.frombuffer(data, dtype=np.uint8)
    parts = []
    for first in range(0, at.size, _CHUNK):
        rows = at[first : first + _CHUNK, None] + np.arange(kind.dtype.itemsize)
        parts.append(raw[rows].view(kind.dtype)[:, 0])
    del raw  # the map cannot be closed while an array uses it
    messages = np.concatenate(parts)
    with np.errstate(invalid="ignore"):  # of a nan that is signalling
        return {
            key: np.asarray(messages[key], dtype=np.float64) * scale
            for key, scale in kind.scales.items()
        }
