"""Frames of a Betaflight blackbox log (.bbl, .bfl).

Source: Betaflight, "Blackbox internals", and src/main/blackbox/
blackbox_encoding.c: a session begins with the line `H Product:Blackbox flight data recorder by
Nicholas Sherwood`; the lines `H Field I name`, `predictor` and `encoding` describe the frames. A
frame begins with a letter: I has whole values, P the differences from a prediction, S, G and H
have other fields, E is an event. The numbers of predictors and encodings are those of
blackbox_fielddefs.h.
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray

PRODUCT = b"H Product:Blackbox flight data recorder"
MAX_BYTES = 1_000_000_000
MAX_FIELDS = 256
_MAX_LINE = 4000
_ENCODED_FIELDS = {6: 8, 7: 3, 8: 4, 10: 3}  # encodings of several fields at once
_MASK32 = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class BlackboxSession:
    """One session from arming to disarming."""

    headers: dict[str, str]
    names: tuple[str, ...]  # the main fields
    rows: FloatArray  # (frames, fields), as logged
    damaged: int  # frames that were left out


@dataclass(slots=True)
class _FrameFields:
    names: list[str] = field(default_factory=list)
    signed: list[int] = field(default_factory=list)
    predictors: list[int] = field(default_factory=list)
    encodings: list[int] = field(default_factory=list)


class _DamagedFrameError(Exception):
    """The bytes are no frame."""


def read_blackbox(path: Path) -> list[BlackboxSession]:
    """Return the sessions of a log that have frames.

    Raises:
        InputError: the log is too large, or its header is damaged.
    """
    if path.stat().st_size > MAX_BYTES:
        raise InputError(
            f"the log {path.name} has more than 1 GB", "split the log, and import each session"
        )
    data = path.read_bytes()
    starts = []
    at = data.find(PRODUCT)
    while at >= 0:
        starts.append(at)
        at = data.find(PRODUCT, at + 1)
    ends = [*starts[1:], len(data)][: len(starts)]
    sessions = []
    for begin, end in zip(starts, ends, strict=True):
        session = _SessionReader(data, begin, end, path.name).read()
        if len(session.rows):
            sessions.append(session)
    return sessions


class _SessionReader:
    def __init__(self, data: bytes, begin: int, end: int, name: str) -> None:
        self._data, self._at, self._end, self._name = data, begin, end, name
        self._headers: dict[str, str] = {}
        self._fields = {kind: _FrameFields() for kind in "IPSGH"}
        self._previous: list[int] | None = None
        self._before: list[int] = []
        self._damaged = 0

    def read(self) -> BlackboxSession:
        """Return the session."""
        self._read_headers()
        main = self._fields["I"]
        self._fields["P"].names = main.names
        count = len(main.names)
        lists = (main.encodings, main.predictors, self._fields["P"].encodings,
                 self._fields["P"].predictors)  # fmt: skip
        if not 0 < count <= MAX_FIELDS or any(len(part) != count for part in lists):
            raise InputError(
                f"the header of the blackbox log {self._name} is damaged",
                "download the log from the flight controller again",
            )
        interval = self._headers.get("P interval", "1/1").split("/")
        self._skipped = _whole_number(interval[-1], 1) // max(_whole_number(interval[0], 1), 1) - 1
        rows: list[list[int]] = []
        while self._at < self._end:
            kind = chr(self._data[self._at])
            begin = self._at
            try:
                row = self._read_frame(kind)
                if self._at < self._end and chr(self._data[self._at]) not in "IPSGHE":
                    raise _DamagedFrameError
            except (_DamagedFrameError, IndexError, struct.error):
                self._damaged += kind in "IP"
                self._previous = None  # differences need a whole frame again
                self._at = begin + 1
                continue
            if row is not None:
                rows.append(row)
        array = np.array(rows, dtype=np.float64).reshape(-1, count)
        return BlackboxSession(self._headers, tuple(main.names), array, self._damaged)

    def _read_headers(self) -> None:
        while self._data.startswith(b"H ", self._at):
            end = self._data.find(b"\n", self._at, min(self._at + _MAX_LINE, self._end))
            if end < 0:
                break
            line = self._data[self._at + 2 : end].decode("ascii", errors="replace")
            self._at = end + 1
            key, _, value = line.partition(":")
            self._headers[key] = value
            words = key.split(" ")
            if len(words) == 3 and words[0] == "Field" and words[1] in self._fields:
                described = self._fields[words[1]]
                if words[2] == "name":
                    described.names = value.split(",")
                elif words[2] in ("signed", "predictor", "encoding"):
                    numbers = [_whole_number(text, -1) for text in value.split(",")]
                    attribute = words[2] if words[2] == "signed" else f"{words[2]}s"
                    setattr(described, attribute, numbers)

    def _read_frame(self, kind: str) -> list[int] | None:
        """Read a frame; returns the values of a main frame that can be used."""
        self._at += 1
        if kind == "E":
            self._read_event()
            return None
        if kind not in self._fields:
            raise _DamagedFrameError
        values = self._read_values(self._fields[kind].encodings, len(self._fields[kind].encodings))
        if kind not in "IP":
            return None
        if kind == "P" and self._previous is None:
            return None
        predictors = self._fields[kind].predictors
        row: list[int] = []
        for index, value in enumerate(values):
            row.append(value + self._predict(predictors[index], index, row))
        if kind == "I":
            self._previous, self._before = row, row
        else:
            self._before, self._previous = self._previous or row, row
        return row

    def _predict(self, predictor: int, index: int, row: list[int]) -> int:
        if predictor in (1, 2, 3, 6):
            last = (self._previous or row)[index]
            before = self._before[index]
            mean = int((last + before) / 2)  # as in C, towards zero
            return {1: last, 2: 2 * last - before, 3: mean, 6: last + 1 + self._skipped}[predictor]
        if predictor == 5:
            names = self._fields["I"].names[: len(row)]
            return row[names.index("motor[0]")] if "motor[0]" in names else 0
        header = {4: "minthrottle", 9: "vbatref", 11: "motorOutput"}.get(predictor)
        if header is not None:
            return _whole_number(self._headers.get(header, "0").split(",")[0], 0)
        return 1500 if predictor == 8 else 0

    def _read_values(self, encodings: list[int], count: int) -> list[int]:
        values: list[int] = []
        while len(values) < count:
            encoding = encodings[len(values)]
            if encoding in _ENCODED_FIELDS:
                size = _ENCODED_FIELDS[encoding]
                if encoding == 6:  # of as many fields as follow with this encoding
                    run = 1
                    while (
                        run < size
                        and len(values) + run < count
                        and encodings[len(values) + run] == 6
                    ):
                        run += 1
                    size = run
                values += self._read_group(encoding, size)[: count - len(values)]
            else:
                values.append(self._read_single(encoding))
        return values

    def _read_single(self, encoding: int) -> int:
        if encoding == 0:
            return _signed(self._unsigned())
        if encoding == 1:
            return self._unsigned()
        if encoding == 3:
            return -_extend(self._unsigned() & 0x3FFF, 14)
        if encoding == 9:
            return 0
        raise _DamagedFrameError

    def _read_group(self, encoding: int, size: int) -> list[int]:
        if encoding == 6:
            if size == 1:
                return [_signed(self._unsigned())]
            tag = self._byte()
            return [_signed(self._unsigned()) if tag >> bit & 1 else 0 for bit in range(size)]
        if encoding == 8:
            return self._tag8_4s16()
        return self._tag2_3(is_variable=encoding == 10)

    def _tag2_3(self, *, is_variable: bool) -> list[int]:
        lead = self._byte()
        selector = lead >> 6
        if selector == 0:
            return [_extend(lead >> shift & 3, 2) for shift in (4, 2, 0)]
        if selector == 1:
            if is_variable:  # 5, 5 and 4 bits
                second = self._byte()
                return [
                    _extend((lead & 0x3E) >> 1, 5),
                    _extend((lead & 1) << 4 | second >> 4, 5),
                    _extend(second & 0x0F, 4),
                ]
            second = self._byte()
            return [_extend(lead & 15, 4), _extend(second >> 4, 4), _extend(second & 15, 4)]
        if selector == 2:
            second = self._byte()
            if is_variable:  # 8, 7 and 7 bits
                third = self._byte()
                return [
                    _extend((lead & 0x3F) << 2 | second >> 6, 8),
                    _extend((second & 0x3F) << 1 | third >> 7, 7),
                    _extend(third & 0x7F, 7),
                ]
            third = self._byte()
            return [_extend(lead & 63, 6), _extend(second & 63, 6), _extend(third & 63, 6)]
        values = []
        for index in range(3):
            size = (lead >> (2 * index) & 3) + 1
            whole = int.from_bytes(self._bytes(size), "little")
            values.append(_extend(whole, 8 * size))
        return values

    def _tag8_4s16(self) -> list[int]:
        """Return four values of 0, 4, 8 or 16 bits each, packed by nibbles (data version 2)."""
        tag = self._byte()
        values = []
        nibble: int | None = None
        for index in range(4):
            size = tag >> (2 * index) & 3
            if size == 0:
                values.append(0)
            elif size == 1:
                if nibble is None:
                    byte = self._byte()
                    values.append(_extend(byte >> 4, 4))
                    nibble = byte & 15
                else:
                    values.append(_extend(nibble, 4))
                    nibble = None
            elif size == 2:
                byte = self._byte()
                if nibble is None:
                    values.append(_extend(byte, 8))
                else:
                    values.append(_extend(nibble << 4 | byte >> 4, 8))
                    nibble = byte & 15
            else:
                first, second = self._byte(), self._byte()
                if nibble is None:
                    values.append(_extend(first << 8 | second, 16))
                else:
                    values.append(_extend(nibble << 12 | first << 4 | second >> 4, 16))
                    nibble = second & 15
        return values

    def _read_event(self) -> None:
        kind = self._byte()
        if kind == 0:  # synchronisation beep
            self._unsigned()
        elif kind == 13:  # in-flight adjustment
            flag = self._byte()
            self._bytes(4) if flag & 0x80 else self._unsigned()
        elif kind in (14, 30):  # logging resumes, flight mode
            self._unsigned()
            self._unsigned()
            if kind == 14:
                self._previous = None
        elif kind == 15:  # disarm
            self._unsigned()
        elif kind == 255:
            if self._bytes(11) != b"End of log\0":
                raise _DamagedFrameError
            self._at = self._end
        else:
            raise _DamagedFrameError

    def _byte(self) -> int:
        if self._at >= self._end:
            raise _DamagedFrameError
        self._at += 1
        return self._data[self._at - 1]

    def _bytes(self, size: int) -> bytes:
        if self._at + size > self._end:
            raise _DamagedFrameError
        self._at += size
        return self._data[self._at - size : self._at]

    def _unsigned(self) -> int:
        """Read 7 bits per byte, the low ones first."""
        value = 0
        for shift in range(0, 35, 7):
            byte = self._byte()
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value & _MASK32
        raise _DamagedFrameError


def _signed(value: int) -> int:
    """Return a number in zigzag encoding."""
    return (value >> 1) ^ -(value & 1)


def _extend(value: int, bits: int) -> int:
    """Return a two's complement number of some bits."""
    return value - (1 << bits) if value & 1 << (bits - 1) else value


def _whole_number(text: str, default: int) -> int:
    stripped = text.strip()
    digits = stripped.removeprefix("-")
    return int(stripped) if digits.isascii() and digits.isdigit() and len(digits) < 12 else default
