"""JSON lines on a serial port: one object per sample, as many hobby firmwares print them.

    {"t": 123456, "n": 17, "gyro": [12, -5, 3], "accel": [0, 0, 256], "temp": 251}

`options` in the rig file gives other names of the keys (`gyro_key`, `time_key`, `sequence_key`,
`accel_key`, `temperature_key`; "" for a value that the board does not send), the unit of the rates
(`gyro_unit`: counts, dps, mdps or rad/s) and of the time (`time_unit`: us, ns, ms or s).

Contract: received bytes never raise an error. An invalid line gives a `FrameFault` event. A line
has no checksum, so a changed digit is not detected.
"""

import math
from collections.abc import Mapping
from typing import Literal

import msgspec

from gyrorig_protocol.board import BoardEvent, FaultCause, FrameEvent, FrameFault, Sample
from gyrorig_protocol.board.delimiter_splitter import DelimiterSplitter
from gyrorig_protocol.board_protocols.board_protocol import BoardEntry, SerialProtocol
from gyrorig_protocol.errors import UsageError

MAX_LINE_BYTES = 512
COUNT_RAD_S = 1e-7  # of rates in a physical unit
_RAD_S = {"dps": math.pi / 180.0, "mdps": math.pi / 180e3, "rad/s": 1.0}
_TICK_HZ = {"us": 1e6, "ns": 1e9, "ms": 1e3, "s": 1e9}  # seconds have decimals
_INT16, _INT32, _UINT64 = 2**15 - 1, 2**31 - 1, 2**64 - 1


class JsonOptions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The names of the keys, and the units."""

    gyro_key: str = "gyro"
    accel_key: str = "accel"
    time_key: str = "t"
    sequence_key: str = "n"
    temperature_key: str = "temp"
    gyro_unit: Literal["counts", "dps", "mdps", "rad/s"] = "counts"
    time_unit: Literal["us", "ns", "ms", "s"] = "us"


def json_options(board: BoardEntry) -> JsonOptions:
    """Return the options of a board.

    Raises:
        UsageError: an option is not known, or its value is not allowed.
    """
    try:
        return msgspec.convert(dict(board.options), JsonOptions)
    except msgspec.ValidationError as error:
        raise UsageError(
            f"the `options` of board {board.id} are not those of `format: json` ({error})",
            f"use only the options {', '.join(JsonOptions.__struct_fields__)}",
        ) from error


class JsonLineParser:
    """Parses JSON lines; the first line after opening can be incomplete and is dropped."""

    def __init__(self, options: JsonOptions) -> None:
        self._options = options
        self._splitter = DelimiterSplitter(b"\n", MAX_LINE_BYTES)
        self._decoder = msgspec.json.Decoder(dict[str, object])
        self._drops_line = True
        self._line_count = -1
        self._sends_time = False  # a line had a time
        self.faults = dict.fromkeys(FaultCause, 0)

    def reset(self) -> None:
        """Drop an unfinished line and the next one."""
        self._splitter.reset()
        self._drops_line = True

    def feed(self, data: bytes, received_ns: int) -> list[BoardEvent]:
        """Return the events that `data` completes; see `SerialParser`."""
        events: list[BoardEvent] = []
        for piece, offset in self._splitter.feed(data):
            line = piece.strip()
            if self._drops_line or not line:
                self._drops_line = False
                continue
            self._line_count += 1
            sample = FaultCause.OVERSIZE if len(piece) > MAX_LINE_BYTES else self._read(line)
            if isinstance(sample, FaultCause):
                self.faults[sample] += 1
                events.append(FrameFault(sample, received_ns, offset, piece))
            else:
                events.append(FrameEvent(sample, received_ns, offset, line))
        return events

    def _read(self, line: bytes) -> Sample | FaultCause:
        options = self._options
        try:
            values = self._decoder.decode(line)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return FaultCause.CONTENT
        factor = _RAD_S.get(options.gyro_unit, COUNT_RAD_S) / COUNT_RAD_S
        gyro = _read_triple(values.get(options.gyro_key), factor)
        accel = _read_triple(values.get(options.accel_key), 1.0)
        ticks_per_unit = 1e9 if options.time_unit == "s" else 1.0
        time_ticks = _read_count(values.get(options.time_key), ticks_per_unit, _UINT64)
        temperature = _read_count(values.get(options.temperature_key), 1.0, _INT16)
        sequence = self._line_count & 0xFFFF_FFFF
        if options.sequence_key in values:
            number = _read_count(values[options.sequence_key], 1.0, 0xFFFF_FFFF)
            if number is None or number < 0:
                return FaultCause.NUMBER
            sequence = number
        required = {options.accel_key: accel, options.time_key: time_ticks}
        required[options.temperature_key] = temperature
        if gyro is None or any(key in values and v is None for key, v in required.items()):
            return FaultCause.NUMBER
        if time_ticks is None and self._sends_time:
            return FaultCause.NUMBER
        if time_ticks is not None and time_ticks < 0:
            return FaultCause.NUMBER
        self._sends_time = time_ticks is not None
        return Sample(0, sequence, time_ticks, gyro, accel, temperature)


def _read_triple(value: object, factor: float) -> tuple[int, int, int] | None:
    if not isinstance(value, list) or len(value) != 3:
        return None
    x, y, z = (_read_count(number, factor, _INT32) for number in value)
    return None if x is None or y is None or z is None else (x, y, z)


def _read_count(value: object, factor: float, limit: int) -> int | None:
    """Return a number as counts, None if it is none, not finite, or beyond the limit."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    if abs(value) > _UINT64:  # too large for a float
        return None
    if isinstance(value, int) and factor == 1.0:
        return value if abs(value) <= limit else None
    scaled = value * factor
    if factor == 1.0 and not scaled.is_integer():
        return None
    return round(scaled) if abs(scaled) <= limit else None


class JsonLines(SerialProtocol):
    """One JSON object per line and sample."""

    name = "json"
    description = "JSON lines"
    sample_bytes = 96
    optional_keys = ("options",)

    def make_parser(self, board: BoardEntry) -> JsonLineParser:
        """Return a parser of the lines."""
        return JsonLineParser(json_options(board))

    def scales(self, board: BoardEntry) -> Mapping[str, str | float | int | None]:
        """Return the scale of rates in a physical unit, and that of the time."""
        options = json_options(board)
        in_counts = options.gyro_unit == "counts"
        return {
            "gyro_scale_rad_s": None if in_counts else COUNT_RAD_S,
            "tick_hz": _TICK_HZ[options.time_unit] if options.time_key else None,
        }


PROTOCOL = JsonLines()
