"""Signal maps: the CAN signals of an IMU, by a preset, or by a DBC file and the signals' names.

What to use when: `SignalMap` in a rig configuration; `resolve_signals` finds its signals for
`signal_parser.CanSignalParser`.

Counts: if the three axes have the same factor and their offset is an integer number of counts, the
raw codes minus the offset are kept, and the factor is the scale. Otherwise, and for floats, values
are converted to integer counts whose scale is fine enough to lose nothing: 1e-7 rad/s and
1e-6 m/s^2.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.board.text_lines import (
    ACCEL_COUNT_M_S2,
    GYRO_COUNT_RAD_S,
    STANDARD_GRAVITY_M_S2,
    TEMPERATURE_COUNT_DEGC,
)
from gyrorig_protocol.can.dbc import DbcMessage, DbcSignal, parse_dbc
from gyrorig_protocol.can.imu_presets import PRESETS, AxisSignals, ImuPreset
from gyrorig_protocol.errors import UsageError

SignalReference = Annotated[str, msgspec.Meta(pattern=r"^\w{1,128}\.\w{1,128}$")]
Triad = tuple[SignalReference | None, SignalReference | None, SignalReference | None]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e12)]

_RAD_PER_DEG = math.pi / 180.0
_GYRO_UNITS = {
    "rad/s": 1.0,
    **dict.fromkeys(("deg/s", "dps", "°/s", "degree/s"), _RAD_PER_DEG),
    "mdps": 1e-3 * _RAD_PER_DEG,
}
_ACCEL_UNITS = {
    **dict.fromkeys(("m/s2", "m/s^2", "m/s²"), 1.0),
    "g": STANDARD_GRAVITY_M_S2,
    "mg": 1e-3 * STANDARD_GRAVITY_M_S2,
}
_TIME_UNITS_HZ = {"s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9}
_INTEGER_TOLERANCE = 1e-6  # of a count: the precision of decimal factors in a file


class SignalMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The signals of an IMU: either `preset`, or `dbc` and the names `MESSAGE.SIGNAL`.

    `dbc` is the text of a DBC file, or the name of a file next to the rig configuration. An axis
    that the sensor lacks is `null`. With `source_address`, identifiers are those of J1939.
    """

    preset: Literal["j1939", "mm5.10", "racelogic"] | None = None
    dbc: Annotated[str, msgspec.Meta(min_length=1, max_length=4 << 20)] | None = None
    source_address: Annotated[int, msgspec.Meta(ge=0, le=253)] | None = None
    gyro: Triad | None = None
    accel: Triad | None = None
    temperature: SignalReference | None = None
    time: SignalReference | None = None
    counter: SignalReference | None = None
    gyro_unit: Literal["rad/s", "dps", "mdps"] | None = None  # if the file has no unit
    accel_unit: Literal["m/s2", "g", "mg"] | None = None
    tick_hz: Positive | None = None  # of `time`, if its unit is not a time
    check_range: bool = False  # values outside the file's [minimum|maximum] are invalid

    @property
    def dbc_file(self) -> str | None:
        """The name of the DBC file, None if `dbc` is its text or is missing."""
        return None if self.dbc is None or "\n" in self.dbc else self.dbc


@dataclass(frozen=True, slots=True)
class ResolvedSignal:
    """One signal, the key of its message, and its conversion to counts."""

    key: int
    signal: DbcSignal
    factor: float  # counts per raw count
    offset: float  # counts


@dataclass(frozen=True, slots=True)
class ResolvedSignalMap:
    """A map with the signals of its DBC file. Scales are per count."""

    gyro: tuple[ResolvedSignal | None, ...]
    gyro_scale_rad_s: float
    accel: tuple[ResolvedSignal | None, ...] | None
    accel_scale_m_s2: float | None
    temperature: ResolvedSignal | None
    temperature_scale_c: float | None
    time: ResolvedSignal | None
    tick_hz: float | None
    counter: ResolvedSignal | None
    check_range: bool
    source_address: int | None
    sensor: str
    needed_bytes: dict[int, int] = field(default_factory=dict)  # by message


def resolve_signals(signal_map: SignalMap, board_name: str) -> ResolvedSignalMap:
    """Find the signals of a map in its DBC file.

    Args:
        signal_map: the configured map; `dbc` must be the text of the file.
        board_name: the name of the board in an error.

    Raises:
        UsageError: a signal or a unit is missing, or there is neither preset nor file.
    """
    preset = _select_preset(signal_map, board_name)
    messages = parse_dbc(preset.dbc, f"the DBC file of board {board_name}")
    finder = _SignalFinder(messages, board_name)
    gyro, gyro_scale = finder.resolve_triad(
        preset.gyro, _GYRO_UNITS, signal_map.gyro_unit, GYRO_COUNT_RAD_S, "gyro_unit"
    )
    accel, accel_scale = None, None
    if preset.accel is not None:
        accel, accel_scale = finder.resolve_triad(
            preset.accel, _ACCEL_UNITS, signal_map.accel_unit, ACCEL_COUNT_M_S2, "accel_unit"
        )
    temperature = None
    if preset.temperature is not None:
        key, signal = finder.find_signal(preset.temperature)
        to_counts = 1.0 / TEMPERATURE_COUNT_DEGC
        temperature = ResolvedSignal(
            key, signal, signal.factor * to_counts, signal.offset * to_counts
        )
    time_signal, tick_hz = finder.resolve_clock(signal_map)
    resolved_map = ResolvedSignalMap(
        gyro=gyro,
        gyro_scale_rad_s=gyro_scale,
        accel=accel,
        accel_scale_m_s2=accel_scale,
        temperature=temperature,
        temperature_scale_c=None if temperature is None else TEMPERATURE_COUNT_DEGC,
        time=time_signal,
        tick_hz=tick_hz,
        counter=finder.resolve_unsigned(signal_map.counter, "counter"),
        check_range=preset.check_range,
        source_address=signal_map.source_address,
        sensor=preset.sensor,
    )
    for resolved in (*gyro, *(accel or ()), temperature, time_signal, resolved_map.counter):
        if resolved is not None:
            byte_count = resolved.signal.last_byte_index + 1
            resolved_map.needed_bytes[resolved.key] = max(
                byte_count, resolved_map.needed_bytes.get(resolved.key, 0)
            )
    return resolved_map


def _select_preset(signal_map: SignalMap, board_name: str) -> ImuPreset:
    """Return the preset, or the signals of the map as a preset."""
    if signal_map.preset is not None:
        if (
            signal_map.dbc is not None
            or signal_map.gyro is not None
            or signal_map.accel is not None
        ):
            raise UsageError(
                f"the key `signals` of board {board_name} has both a preset and its own signals",
                "remove the key `preset`, or remove the keys `dbc`, `gyro` and `accel`",
            )
        preset = PRESETS[signal_map.preset]
        if preset.uses_source_address and signal_map.source_address is None:
            raise UsageError(
                f"the key `signals` of board {board_name} has no `source_address`, but its "
                "preset needs one",
                "add the key `source_address` with the sensor's J1939 address, from 0 to 253",
            )
        return preset
    if signal_map.dbc is None or signal_map.gyro is None:
        raise UsageError(
            f"the key `signals` of board {board_name} has neither a preset nor a DBC file "
            "with gyro signals",
            f"add the key `preset` with one of {', '.join(PRESETS)}, or add the keys `dbc` "
            "and `gyro`",
        )
    if signal_map.dbc_file is not None:
        raise UsageError(
            f"the settings of board {board_name} contain the name of the DBC file "
            f"{signal_map.dbc_file!r}, but not its text",
            "put the text of the DBC file into the key `dbc`. Only the daemon reads a DBC "
            "file that the rig file names",
        )
    if all(axis is None for axis in signal_map.gyro):
        raise UsageError(
            f"the key `signals` of board {board_name} names no gyro signal",
            "add at least one signal to the key `gyro`, in the form MESSAGE.SIGNAL",
        )
    accel: AxisSignals | None = signal_map.accel
    return ImuPreset(
        signal_map.dbc,
        signal_map.gyro,
        accel,
        signal_map.temperature,
        check_range=signal_map.check_range,
    )


@dataclass(frozen=True, slots=True)
class _SignalFinder:
    """Find signals by name in the messages of one DBC file."""

    messages: dict[str, DbcMessage]
    board_name: str

    def find_signal(self, reference: str) -> tuple[int, DbcSignal]:
        message_name, _, signal_name = reference.partition(".")
        message = self.messages.get(message_name)
        if message is None:
            raise UsageError(
                f"the DBC file of board {self.board_name} has no message {message_name}",
                f"choose one of its messages: {_list_names(self.messages)}",
            )
        signal = message.signals.get(signal_name)
        if signal is None:
            raise UsageError(
                f"the message {message_name} in the DBC file of board {self.board_name} has "
                f"no signal {signal_name}",
                f"choose one of its signals: {_list_names(message.signals)}",
            )
        return message.key, signal

    def resolve_triad(
        self,
        axes: AxisSignals,
        units: dict[str, float],
        chosen_unit: str | None,
        fallback_scale: float,
        key: str,
    ) -> tuple[tuple[ResolvedSignal | None, ...], float]:
        """Return three axes and the scale of their counts, in rad/s or m/s^2."""
        axis_signals = [None if axis is None else self.find_signal(axis) for axis in axes]
        signals = [signal for _, signal in (pair for pair in axis_signals if pair is not None)]
        to_si = {signal.name: self._to_si(signal, units, chosen_unit, key) for signal in signals}
        first_signal = signals[0]
        unit_scale = to_si[first_signal.name]
        if all(
            _keeps_raw_counts(signal, first_signal) and to_si[signal.name] == unit_scale
            for signal in signals
        ):
            scale = abs(first_signal.factor) * unit_scale
            sign = math.copysign(1.0, first_signal.factor)
            return tuple(
                None
                if pair is None
                else ResolvedSignal(
                    *pair, sign, float(round(pair[1].offset / abs(first_signal.factor)))
                )
                for pair in axis_signals
            ), scale
        return tuple(
            None
            if pair is None
            else ResolvedSignal(
                *pair,
                pair[1].factor * to_si[pair[1].name] / fallback_scale,
                pair[1].offset * to_si[pair[1].name] / fallback_scale,
            )
            for pair in axis_signals
        ), fallback_scale

    def resolve_clock(self, signal_map: SignalMap) -> tuple[ResolvedSignal | None, float | None]:
        """Return the signal of the board's clock and its rate in Hz."""
        resolved = self.resolve_unsigned(signal_map.time, "time")
        if resolved is None:
            return None, None
        unit_hz = _TIME_UNITS_HZ.get(resolved.signal.unit.strip())
        tick_hz = signal_map.tick_hz or (unit_hz and unit_hz / resolved.signal.factor)
        if not tick_hz:
            raise UsageError(
                f"the clock signal of board {self.board_name} has the unit "
                f"{resolved.signal.unit!r}, which is not a unit of time",
                "add the key `tick_hz` with the clock's ticks per second under `signals`",
            )
        return resolved, tick_hz

    def resolve_unsigned(self, reference: str | None, role: str) -> ResolvedSignal | None:
        """Return a signal whose raw value is used as an unsigned number."""
        if reference is None:
            return None
        key, signal = self.find_signal(reference)
        if signal.is_float or signal.is_signed:
            raise UsageError(
                f"the key `{role}` under `signals` of board {self.board_name} names the signal "
                f"{reference}, which is not an unsigned number",
                f"choose an unsigned signal for `{role}`, or remove the key `{role}`",
            )
        return ResolvedSignal(key, signal, 1.0, 0.0)

    def _to_si(
        self, signal: DbcSignal, units: dict[str, float], chosen_unit: str | None, key: str
    ) -> float:
        factor = units.get(chosen_unit or signal.unit.strip())
        if factor is None:
            raise UsageError(
                f"the signal {signal.name} of board {self.board_name} has the unknown unit "
                f"{signal.unit!r}",
                f"add the key `{key}` under the key `signals` of the board",
            )
        return factor


def _list_names(names: Iterable[str], max_count: int = 12) -> str:
    sorted_names = sorted(names)
    suffix = f" and {len(sorted_names) - max_count} more" if len(sorted_names) > max_count else ""
    return ", ".join(sorted_names[:max_count]) + suffix


def _keeps_raw_counts(signal: DbcSignal, first_signal: DbcSignal) -> bool:
    """Return whether raw codes can be kept: one factor, an integer offset, at most 31 bits."""
    if signal.is_float or signal.factor != first_signal.factor or signal.bit_length > 31:
        return False
    offset = signal.offset / signal.factor
    return (
        abs(offset - round(offset)) < _INTEGER_TOLERANCE * max(1.0, abs(offset))
        and abs(offset) < 1 << 30
    )
