"""Parser of text lines: for boards that print one line of numbers per sample.

What to use when: a `ColumnMap` assigns the columns; `TextLineParser` returns the same
`FrameEvent`s with `Sample`s as `FrameParser`. Without a `sequence` column the lines are counted,
valid or not, so that an invalid line shows as a gap. A text line has no checksum: a lost or changed
digit cannot be detected, only a wrong number of columns. Therefore give `columns`, and a `sequence`
column if the board has one.

Columns in physical units are converted to integer counts whose scale is fine enough to lose
nothing: 1e-7 rad/s, 1e-6 m/s^2 and 0.01 degC.

Contract: received bytes never raise an error. An invalid line gives a `FrameFault` event. The
events do not depend on where the stream was cut. Memory stays below `max_line_bytes`.
"""

import math
import re
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.board.board_events import BoardEvent, FaultCause, FrameEvent, FrameFault
from gyrorig_protocol.board.board_frames import Sample, Triple
from gyrorig_protocol.board.delimiter_splitter import DelimiterSplitter

GYRO_COUNT_RAD_S = 1e-7
ACCEL_COUNT_M_S2 = 1e-6
TEMPERATURE_COUNT_DEGC = 0.01
STANDARD_GRAVITY_M_S2 = 9.80665  # CGPM 1901, resolution 2

_RAD_PER_DEG = math.pi / 180.0
_GYRO_UNITS_RAD_S = {"counts": None, "dps": _RAD_PER_DEG, "mdps": 1e-3 * _RAD_PER_DEG, "rad/s": 1.0}
_ACCEL_UNITS_M_S2 = {
    "counts": None,
    "g": STANDARD_GRAVITY_M_S2,
    "mg": 1e-3 * STANDARD_GRAVITY_M_S2,
    "m/s2": 1.0,
}
# unit: ticks per second, and the decimals of a tick. A counter in us, ns or ticks is kept as
# sent, so that it wraps where the board's counter wraps.
_TIME_UNITS = {"s": (1e9, 9), "ms": (1e6, 3), "us": (1e6, 0), "ns": (1e9, 0), "ticks": (None, 0)}

_TIME_PATTERN = re.compile(rb"(\d{1,20})(?:\.(\d{0,20}))?")
_NUMBER_PATTERN = re.compile(rb"[-+]?(?:\d{1,20}(?:\.\d{0,20})?|\.\d{1,20})(?:[eE][-+]?\d{1,2})?")
_INT16, _INT32, _UINT64 = 2**15 - 1, 2**31 - 1, 2**64 - 1

ColumnIndex = Annotated[int, msgspec.Meta(ge=0, le=255)]


class ColumnMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The meaning of each column of a line; columns count from 0.

    Without `separator`, any sequence of spaces, tabs, commas and semicolons separates columns.
    Lines that begin with `comment` and the first `skip_lines` lines are skipped. With `columns`
    a line must have exactly that many columns, otherwise at least those that are assigned.
    """

    gyro: tuple[ColumnIndex, ColumnIndex, ColumnIndex]
    accel: tuple[ColumnIndex, ColumnIndex, ColumnIndex] | None = None
    time: ColumnIndex | None = None
    sequence: ColumnIndex | None = None
    temperature: ColumnIndex | None = None
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
        """Ticks of `Sample.device_time` per second; None if unknown."""
        return None if self.time is None else _TIME_UNITS[self.time_unit][0]

    @property
    def gyro_scale_rad_s(self) -> float | None:
        """rad/s per count of `Sample.gyro`; None if the board sends counts."""
        return None if self.gyro_unit == "counts" else GYRO_COUNT_RAD_S

    @property
    def accel_scale_m_s2(self) -> float | None:
        """m/s^2 per count of `Sample.accel`; None if the board sends counts."""
        return None if self.accel_unit == "counts" else ACCEL_COUNT_M_S2

    @property
    def temperature_scale_c(self) -> float | None:
        """Kelvin per count of `Sample.temperature`; None if the board sends counts."""
        return None if self.temperature_unit == "counts" else TEMPERATURE_COUNT_DEGC

    @property
    def min_columns(self) -> int:
        """The least number of columns of a line."""
        scalar_columns = (self.time, self.sequence, self.temperature)
        used_columns: list[int] = [*self.gyro, *(self.accel or ())]
        used_columns += [column for column in scalar_columns if column is not None]
        return max(used_columns) + 1


class TextLineParser:
    """Parse a board's text into samples and faults.

    Args:
        columns: the meaning of the columns.
        mid_stream: True for a port. The first line is dropped, because its beginning can be
            missing, and a shorter first number would not show that. False for a file.
        max_line_bytes: a longer line is a fault.
    """

    def __init__(
        self, columns: ColumnMap, mid_stream: bool = True, max_line_bytes: int = 512
    ) -> None:
        self._columns = columns
        self._max_line_bytes = max_line_bytes
        self._splitter = DelimiterSplitter(b"\n", max_line_bytes)
        self._lines_to_skip = columns.skip_lines + mid_stream
        self._comment = columns.comment.encode()
        self._separator = None if columns.separator is None else columns.separator.encode()
        gyro, accel = _GYRO_UNITS_RAD_S[columns.gyro_unit], _ACCEL_UNITS_M_S2[columns.accel_unit]
        self._gyro_factor = None if gyro is None else gyro / GYRO_COUNT_RAD_S
        self._accel_factor = None if accel is None else accel / ACCEL_COUNT_M_S2
        is_degc = columns.temperature_unit == "degC"
        self._temperature_factor = 1.0 / TEMPERATURE_COUNT_DEGC if is_degc else None
        self._time_decimals = _TIME_UNITS[columns.time_unit][1]
        self._min_columns = columns.min_columns
        self._line_count = 0
        self.frames = 0
        self.faults = dict.fromkeys(FaultCause, 0)

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes of an unfinished line, at most `max_line_bytes`."""
        return self._splitter.buffered_bytes

    def reset(self) -> None:
        """Drop an unfinished line and the next one, for example after the port was opened again."""
        self._splitter.reset()
        self._lines_to_skip = max(self._lines_to_skip, 1)

    def feed(self, data: bytes, received_ns: int) -> list[BoardEvent]:
        """Return the events that `data` completes; the last line needs its line end.

        Args:
            data: the bytes of one read call, cut anywhere.
            received_ns: the timestamp of that read call.
        """
        events: list[BoardEvent] = []
        for piece, offset in self._splitter.feed(data):
            if self._lines_to_skip:
                self._lines_to_skip -= 1
                continue
            line = piece.strip()
            if not line or (self._comment and line.startswith(self._comment)):
                continue
            self._line_count += 1
            is_too_long = len(piece) > self._max_line_bytes
            result = FaultCause.OVERSIZE if is_too_long else self._parse_sample(line)
            if isinstance(result, FaultCause):
                self.faults[result] += 1
                events.append(FrameFault(result, received_ns, offset, piece))
            else:
                self.frames += 1
                events.append(FrameEvent(result, received_ns, offset, line))
        return events

    def _parse_sample(self, line: bytes) -> Sample | FaultCause:
        fields = self._split_fields(line)
        if len(fields) != (self._columns.columns or len(fields)) or len(fields) < self._min_columns:
            return FaultCause.COLUMNS
        gyro = _parse_triple(fields, self._columns.gyro, self._gyro_factor)
        accel: Triple | None = None
        temperature = time_ticks = None
        sequence: int | None = (self._line_count - 1) & 0xFFFF_FFFF
        if self._columns.accel is not None:
            accel = _parse_triple(fields, self._columns.accel, self._accel_factor)
        if self._columns.temperature is not None:
            temperature = _parse_count(
                fields[self._columns.temperature], self._temperature_factor, _INT16
            )
        if self._columns.time is not None:
            time_ticks = _parse_ticks(fields[self._columns.time], self._time_decimals)
        if self._columns.sequence is not None:
            sequence = _parse_ticks(fields[self._columns.sequence], 0)
        is_incomplete = (
            (self._columns.accel is not None and accel is None)
            or (self._columns.temperature is not None and temperature is None)
            or (self._columns.time is not None and time_ticks is None)
        )
        if is_incomplete or gyro is None or sequence is None or sequence > 0xFFFF_FFFF:
            return FaultCause.NUMBER
        return Sample(0, sequence, time_ticks, gyro, accel, temperature)

    def _split_fields(self, line: bytes) -> list[bytes]:
        if self._separator is None:
            return line.translate(_ALL_SEPARATORS).split()
        if self._separator == b" ":
            return line.split()
        return line.split(self._separator)


_ALL_SEPARATORS = bytes.maketrans(b",;\t", b"   ")


def _parse_triple(
    fields: list[bytes], columns: tuple[int, int, int], factor: float | None
) -> Triple | None:
    x, y, z = (_parse_count(fields[column], factor, _INT32) for column in columns)
    return None if x is None or y is None or z is None else (x, y, z)


def _parse_count(field: bytes, factor: float | None, limit: int) -> int | None:
    """Return a field as an integer number of counts, None if invalid or beyond the limit."""
    field = field.strip()
    if _NUMBER_PATTERN.fullmatch(field) is None:
        return None
    value = float(field)
    if factor is None:
        return int(value) if value.is_integer() and abs(value) <= limit else None
    value *= factor
    return round(value) if abs(value) <= limit else None


def _parse_ticks(field: bytes, decimals: int) -> int | None:
    """Return a field as ticks; the last `decimals` digits are its decimal places."""
    match = _TIME_PATTERN.fullmatch(field.strip())
    if match is None or (match.group(2) and not decimals):
        return None
    fraction = (match.group(2) or b"")[:decimals].ljust(decimals, b"0")
    ticks = int(match.group(1) + fraction)
    return ticks if ticks <= _UINT64 else None
