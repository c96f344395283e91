"""Boards that print lines of numbers, as the paper's own logger read them.

What to use when: a `ColumnMap` says which column is what; `TextLineParser` gives the same
`FrameEvent`s with `Sample`s as a board that speaks GCB1. Without a `sequence` column the
lines are counted, good and bad, so that a bad line shows as a gap. A text line has no check: a lost
or changed digit cannot be seen, only a wrong number of columns. So give `columns`, and a
`sequence` column where the board has one.

Columns in physical units become whole counts of a scale that loses nothing:
1e-7 rad/s, 1e-6 m/s^2 and 0.01 degC (recording contract, format 1, "Imported measurements").

Contract: device bytes raise nothing. A line without its numbers is a `FrameFault` event;
the events do not depend on where the stream was cut; memory stays below `max_line_bytes`.
"""

import math
import re
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.board.events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.frames import Sample, Triple
from gyrorig_protocol.board.pieces import PieceSplitter

GYRO_COUNT_RAD_S = 1e-7
ACCEL_COUNT_M_S2 = 1e-6
TEMPERATURE_COUNT_DEGC = 0.01
STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901, resolution 2

_DEG = math.pi / 180.0
_GYRO_UNITS_RAD_S = {"counts": None, "dps": _DEG, "mdps": 1e-3 * _DEG, "rad/s": 1.0}
_ACCEL_UNITS_M_S2 = {
    "counts": None,
    "g": STANDARD_GRAVITY_M_S2,
    "mg": 1e-3 * STANDARD_GRAVITY_M_S2,
    "m/s2": 1.0,
}
# unit: ticks per second, and the decimals that a tick keeps. A counter in us, ns or ticks is
# kept as sent, so that its wrap is where the board's is.
_TIME_UNITS = {"s": (1e9, 9), "ms": (1e6, 3), "us": (1e6, 0), "ns": (1e9, 0), "ticks": (None, 0)}

_TIME = re.compile(rb"(\d{1,20})(?:\.(\d{0,20}))?")
_NUMBER = re.compile(rb"[-+]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eE][-+]?\d{1,2})?")
_INT16, _INT32, _UINT64 = 2**15 - 1, 2**31 - 1, 2**64 - 1

Index = Annotated[int, msgspec.Meta(ge=0, le=255)]


class ColumnMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which column of a line is what; columns count from 0.

    Without `separator` any run of spaces, tabs, commas and semicolons separates. Lines
    that begin with `comment` and the first `skip_lines` lines are passed over. With
    `columns` a line must have that many, without it at least those that are named.
    """

    gyro: tuple[Index, Index, Index]
    accel: tuple[Index, Index, Index] | None = None
    time: Index | None = None
    sequence: Index | None = None
    temperature: Index | None = None
    gyro_unit: Literal["counts", "dps", "mdps", "rad/s"] = "counts"
    accel_unit: Literal["counts", "g", "mg", "m/s2"] = "counts"
    temperature_unit: Literal["counts", "degC"] = "counts"
    time_unit: Literal["s", "ms", "us", "ns", "ticks"] = "us"
    separator: Literal[",", ";", "\t", " "] | None = None
    comment: Annotated[str, msgspec.Meta(max_length=8)] = "#"
    skip_lines: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    columns: Annotated[int, msgspec.Meta(ge=3, le=256)] | None = None

    @property
    def tick_hz(self) -> float | None:
        """Ticks of `Sample.device_time` per second; None where the map cannot know."""
        return None if self.time is None else _TIME_UNITS[self.time_unit][0]

    @property
    def gyro_scale_rad_s(self) -> float | None:
        """rad/s per count of `Sample.gyro`; None where the board sends counts."""
        return None if self.gyro_unit == "counts" else GYRO_COUNT_RAD_S

    @property
    def accel_scale_m_s2(self) -> float | None:
        """m/s^2 per count of `Sample.accel`; None where the board sends counts."""
        return None if self.accel_unit == "counts" else ACCEL_COUNT_M_S2

    @property
    def temperature_scale_c(self) -> float | None:
        """Kelvin per count of `Sample.temperature`; None where the board sends counts."""
        return None if self.temperature_unit == "counts" else TEMPERATURE_COUNT_DEGC

    @property
    def min_columns(self) -> int:
        """How many columns a line has at least."""
        single = (self.time, self.sequence, self.temperature)
        named: list[int] = [*self.gyro, *(self.accel or ())]
        named += [at for at in single if at is not None]
        return max(named) + 1


class TextLineParser:
    """Split a board's text into samples and faults.

    Args:
        columns: which column is what.
        mid_stream: True for a port: the first line may have lost its beginning, which a
            shorter first number would not show, so it is dropped. False for a file.
        max_line_bytes: a longer line is a fault.
    """

    def __init__(
        self, columns: ColumnMap, mid_stream: bool = True, max_line_bytes: int = 512
    ) -> None:
        self._map = columns
        self._limit = max_line_bytes
        self._splitter = PieceSplitter(b"\n", max_line_bytes)
        self._to_skip = columns.skip_lines + mid_stream
        self._comment = columns.comment.encode()
        self._separator = None if columns.separator is None else columns.separator.encode()
        gyro, accel = _GYRO_UNITS_RAD_S[columns.gyro_unit], _ACCEL_UNITS_M_S2[columns.accel_unit]
        self._gyro_factor = None if gyro is None else gyro / GYRO_COUNT_RAD_S
        self._accel_factor = None if accel is None else accel / ACCEL_COUNT_M_S2
        degc = columns.temperature_unit == "degC"
        self._temperature_factor = 1.0 / TEMPERATURE_COUNT_DEGC if degc else None
        self._time_decimals = _TIME_UNITS[columns.time_unit][1]
        self._min_columns = columns.min_columns
        self._lines = 0
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)

    @property
    def buffered_bytes(self) -> int:
        """How much of an unfinished line is held, at most `max_line_bytes`."""
        return self._splitter.buffered_bytes

    def reset(self) -> None:
        """Forget an unfinished line, as after opening the port anew; the next one is dropped."""
        self._splitter.reset()
        self._to_skip = max(self._to_skip, 1)

    def feed(self, data: bytes, received_ns: int) -> list[BoardEvent]:
        """Return the events that `data` completes; a last line needs its line end.

        Args:
            data: what one read returned, cut anywhere.
            received_ns: the stamp of that read.
        """
        events: list[BoardEvent] = []
        for piece, offset in self._splitter.feed(data):
            if self._to_skip:
                self._to_skip -= 1
                continue
            line = piece.strip()
            if not line or (self._comment and line.startswith(self._comment)):
                continue
            self._lines += 1
            too_long = len(piece) > self._limit
            sample = FaultCause.OVERSIZE if too_long else self._sample(line)
            if isinstance(sample, FaultCause):
                self.faults[sample] += 1
                events.append(FrameFault(sample, received_ns, offset, piece))
            else:
                self.frames += 1
                events.append(FrameEvent(sample, received_ns, offset, line))
        return events

    def _sample(self, line: bytes) -> Sample | FaultCause:
        fields = self._fields(line)
        if len(fields) != (self._map.columns or len(fields)) or len(fields) < self._min_columns:
            return FaultCause.COLUMNS
        gyro = _triple(fields, self._map.gyro, self._gyro_factor)
        accel: Triple | None = None
        temperature = time = None
        sequence: int | None = (self._lines - 1) & 0xFFFF_FFFF
        if self._map.accel is not None:
            accel = _triple(fields, self._map.accel, self._accel_factor)
        if self._map.temperature is not None:
            temperature = _count(fields[self._map.temperature], self._temperature_factor, _INT16)
        if self._map.time is not None:
            time = _ticks(fields[self._map.time], self._time_decimals)
        if self._map.sequence is not None:
            sequence = _ticks(fields[self._map.sequence], 0)
        missing = (
            (self._map.accel is not None and accel is None)
            or (self._map.temperature is not None and temperature is None)
            or (self._map.time is not None and time is None)
        )
        if missing or gyro is None or sequence is None or sequence > 0xFFFF_FFFF:
            return FaultCause.NUMBER
        return Sample(0, sequence, time, gyro, accel, temperature)

    def _fields(self, line: bytes) -> list[bytes]:
        if self._separator is None:
            return line.translate(_ALL_SEPARATORS).split()
        if self._separator == b" ":
            return line.split()
        return line.split(self._separator)


_ALL_SEPARATORS = bytes.maketrans(b",;\t", b"   ")


def _triple(
    fields: list[bytes], columns: tuple[int, int, int], factor: float | None
) -> Triple | None:
    x, y, z = (_count(fields[at], factor, _INT32) for at in columns)
    return None if x is None or y is None or z is None else (x, y, z)


def _count(field: bytes, factor: float | None, limit: int) -> int | None:
    """Return a field as a whole number of counts, None where it is none within the limit."""
    field = field.strip()
    if _NUMBER.fullmatch(field) is None:
        return None
    value = float(field)
    if factor is None:
        return int(value) if value.is_integer() and abs(value) <= limit else None
    value *= factor
    return round(value) if abs(value) <= limit else None


def _ticks(field: bytes, decimals: int) -> int | None:
    """Return a field as ticks of which the last `decimals` digits are a fraction."""
    match = _TIME.fullmatch(field.strip())
    if match is None or (match.group(2) and not decimals):
        return None
    fraction = (match.group(2) or b"")[:decimals].ljust(decimals, b"0")
    ticks = int(match.group(1) + fraction)
    return ticks if ticks <= _UINT64 else None
