"""Which signals of a bus are an IMU's: a preset, or a DBC file and their names.

What to use when: `SignalMap` in a rig's document; `bind` makes of it what
`signal_parser.SignalParser` reads frames with.

Counts. Where the three axes have one factor and their offset is a whole number of counts, the
raw codes are kept, less the offset, and the factor is the scale. Anything else, floats too,
becomes whole counts of a scale that loses nothing: 1e-7 rad/s and 1e-6 m/s^2 (recording
contract, format 1, "Imported measurements").
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.board.text import (
    ACCEL_COUNT_M_S2,
    GYRO_COUNT_RAD_S,
    STANDARD_GRAVITY_M_S2,
    TEMPERATURE_COUNT_DEGC,
)
from gyrorig_protocol.can.dbc import Message, Signal, parse_dbc
from gyrorig_protocol.can.presets import PRESETS, Axes, Preset
from gyrorig_protocol.errors import UsageError

Reference = Annotated[str, msgspec.Meta(pattern=r"^\w{1,128}\.\w{1,128}$")]
Triad = tuple[Reference | None, Reference | None, Reference | None]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e12)]

_DEG = math.pi / 180.0
_GYRO_UNITS = {
    "rad/s": 1.0, "deg/s": _DEG, "dps": _DEG, "°/s": _DEG, "degree/s": _DEG, "mdps": 1e-3 * _DEG,
}  # fmt: skip
_ACCEL_UNITS = {
    "m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "g": STANDARD_GRAVITY_M_S2,
    "mg": 1e-3 * STANDARD_GRAVITY_M_S2,
}  # fmt: skip
_TIME_UNITS_HZ = {"s": 1.0, "ms": 1e3, "us": 1e6, "µs": 1e6, "ns": 1e9}
_WHOLE = 1e-6  # of a count: what decimal factors in a file are exact to


class SignalMap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Which signals are which; either `preset`, or `dbc` and the names `MESSAGE.SIGNAL`.

    `dbc` is the text of a DBC file, or the name of one beside the rig's document. An axis
    that the sensor does not have is `null`. With `source_address` identifiers are J1939's.
    """

    preset: Literal["j1939", "mm5.10", "racelogic"] | None = None
    dbc: Annotated[str, msgspec.Meta(min_length=1, max_length=4 << 20)] | None = None
    source_address: Annotated[int, msgspec.Meta(ge=0, le=253)] | None = None
    gyro: Triad | None = None
    accel: Triad | None = None
    temperature: Reference | None = None
    time: Reference | None = None
    counter: Reference | None = None
    gyro_unit: Literal["rad/s", "dps", "mdps"] | None = None  # where the file names none
    accel_unit: Literal["m/s2", "g", "mg"] | None = None
    tick_hz: Positive | None = None  # of `time`, where its unit is no time
    check_range: bool = False  # values outside of the file's [minimum|maximum] are none

    @property
    def dbc_file(self) -> str | None:
        """The name of the DBC file that is still to be read, None where there is none."""
        return None if self.dbc is None or "\n" in self.dbc else self.dbc


@dataclass(frozen=True, slots=True)
class BoundSignal:
    """One signal, the message that holds it, and the way to counts."""

    key: int
    signal: Signal
    factor: float  # counts per raw count
    offset: float  # counts


@dataclass(frozen=True, slots=True)
class BoundMap:
    """A map whose signals have been found. Scales are per count."""

    gyro: tuple[BoundSignal | None, ...]
    gyro_scale_rad_s: float
    accel: tuple[BoundSignal | None, ...] | None
    accel_scale_m_s2: float | None
    temperature: BoundSignal | None
    temperature_scale_c: float | None
    time: BoundSignal | None
    tick_hz: float | None
    counter: BoundSignal | None
    check_range: bool
    source_address: int | None
    sensor: str
    lengths: dict[int, int] = field(default_factory=dict)  # bytes needed of each message


def bind(chosen: SignalMap, name: str) -> BoundMap:
    """Return the signals that a map names.

    Args:
        chosen: what a person wrote; `dbc` must be the file's text by now.
        name: the board, for errors.

    Raises:
        UsageError: no such signal, no unit, or neither preset nor file.
    """
    preset = _preset(chosen, name)
    messages = parse_dbc(preset.dbc, f"the DBC file of board {name}")
    finder = _Finder(messages, name)
    gyro, gyro_scale = finder.triad(
        preset.gyro, _GYRO_UNITS, chosen.gyro_unit, GYRO_COUNT_RAD_S, "gyro_unit"
    )
    accel, accel_scale = None, None
    if preset.accel is not None:
        accel, accel_scale = finder.triad(
            preset.accel, _ACCEL_UNITS, chosen.accel_unit, ACCEL_COUNT_M_S2, "accel_unit"
        )
    temperature = None
    if preset.temperature is not None:
        key, signal = finder.find(preset.temperature)
        to_counts = 1.0 / TEMPERATURE_COUNT_DEGC
        temperature = BoundSignal(key, signal, signal.factor * to_counts, signal.offset * to_counts)
    time, tick_hz = finder.time(chosen)
    bound = BoundMap(
        gyro=gyro,
        gyro_scale_rad_s=gyro_scale,
        accel=accel,
        accel_scale_m_s2=accel_scale,
        temperature=temperature,
        temperature_scale_c=None if temperature is None else TEMPERATURE_COUNT_DEGC,
        time=time,
        tick_hz=tick_hz,
        counter=finder.integer(chosen.counter, "counter"),
        check_range=preset.check_range,
        source_address=chosen.source_address,
        sensor=preset.sensor,
    )
    for part in (*gyro, *(accel or ()), temperature, time, bound.counter):
        if part is not None:
            needed = part.signal.last_byte + 1
            bound.lengths[part.key] = max(needed, bound.lengths.get(part.key, 0))
    return bound


def _preset(chosen: SignalMap, name: str) -> Preset:
    """Return the preset, or what the map itself says in the form of one."""
    if chosen.preset is not None:
        if chosen.dbc is not None or chosen.gyro is not None or chosen.accel is not None:
            raise UsageError(
                f"board {name} has a preset and signals of its own",
                "leave out preset, or dbc, gyro and accel",
            )
        preset = PRESETS[chosen.preset]
        if preset.by_source and chosen.source_address is None:
            raise UsageError(
                f"board {name} has no source_address",
                "give the sensor's J1939 address under signals: source_address, 0 to 253",
            )
        return preset
    if chosen.dbc is None or chosen.gyro is None:
        raise UsageError(
            f"board {name} has neither a preset nor a DBC file with its gyro",
            f"give signals: preset ({', '.join(PRESETS)}), or dbc and gyro",
        )
    if chosen.dbc_file is not None:
        raise UsageError(f"the DBC file {chosen.dbc_file!r} has not been read", "give its text")
    if all(axis is None for axis in chosen.gyro):
        raise UsageError(
            f"board {name} has no axis of a gyro",
            "name at least one under signals: gyro, as MESSAGE.SIGNAL",
        )
    accel: Axes | None = chosen.accel
    return Preset(
        chosen.dbc, chosen.gyro, accel, chosen.temperature, check_range=chosen.check_range
    )


@dataclass(frozen=True, slots=True)
class _Finder:
    """Finds signals by name in one file's messages."""

    messages: dict[str, Message]
    board: str

    def find(self, reference: str) -> tuple[int, Signal]:
        message_name, _, signal_name = reference.partition(".")
        message = self.messages.get(message_name)
        if message is None:
            raise UsageError(
                f"board {self.board}: the DBC file has no message {message_name}",
                f"name one that it has: {_some(self.messages)}",
            )
        signal = message.signals.get(signal_name)
        if signal is None:
            raise UsageError(
                f"board {self.board}: message {message_name} has no signal {signal_name}",
                f"name one that it has: {_some(message.signals)}",
            )
        return message.key, signal

    def triad(
        self,
        axes: Axes,
        units: dict[str, float],
        chosen_unit: str | None,
        fine: float,
        key: str,
    ) -> tuple[tuple[BoundSignal | None, ...], float]:
        """Return three axes and the scale of their counts, in rad/s or m/s^2."""
        found = [None if axis is None else self.find(axis) for axis in axes]
        there = [signal for _, signal in (pair for pair in found if pair is not None)]
        to_si = {signal.name: self._to_si(signal, units, chosen_unit, key) for signal in there}
        first = there[0]
        unit = to_si[first.name]
        if all(_is_raw(signal, first) and to_si[signal.name] == unit for signal in there):
            scale = abs(first.factor) * unit
            sign = math.copysign(1.0, first.factor)
            return tuple(
                None
                if pair is None
                else BoundSignal(*pair, sign, float(round(pair[1].offset / abs(first.factor))))
                for pair in found
            ), scale
        return tuple(
            None
            if pair is None
            else BoundSignal(
                *pair,
                pair[1].factor * to_si[pair[1].name] / fine,
                pair[1].offset * to_si[pair[1].name] / fine,
            )
            for pair in found
        ), fine

    def time(self, chosen: SignalMap) -> tuple[BoundSignal | None, float | None]:
        """Return the board's own clock and its rate."""
        bound = self.integer(chosen.time, "time")
        if bound is None:
            return None, None
        unit_hz = _TIME_UNITS_HZ.get(bound.signal.unit.strip())
        tick_hz = chosen.tick_hz or (unit_hz and unit_hz / bound.signal.factor)
        if not tick_hz:
            raise UsageError(
                f"board {self.board}: the signal of time has the unit {bound.signal.unit!r}, which "
                "is none of time",
                "give its ticks a second under signals: tick_hz",
            )
        return bound, tick_hz

    def integer(self, reference: str | None, what: str) -> BoundSignal | None:
        """Return a signal whose raw number is what is wanted."""
        if reference is None:
            return None
        key, signal = self.find(reference)
        if signal.is_float or signal.is_signed:
            raise UsageError(
                f"board {self.board}: {reference}, named as its {what}, is no unsigned number",
                "choose another signal, or leave it out",
            )
        return BoundSignal(key, signal, 1.0, 0.0)

    def _to_si(
        self, signal: Signal, units: dict[str, float], chosen: str | None, key: str
    ) -> float:
        factor = units.get(chosen or signal.unit.strip())
        if factor is None:
            raise UsageError(
                f"board {self.board}: signal {signal.name} has the unit {signal.unit!r}, which is "
                "not known",
                f"say what it is in under signals: {key}",
            )
        return factor


def _some(names: Iterable[str], most: int = 12) -> str:
    known = sorted(names)
    more = f" and {len(known) - most} more" if len(known) > most else ""
    return ", ".join(known[:most]) + more


def _is_raw(signal: Signal, first: Signal) -> bool:
    """Return whether a signal's codes can be kept: one factor, a whole offset, 31 bits."""
    if signal.is_float or signal.factor != first.factor or signal.length > 31:
        return False
    offset = signal.offset / signal.factor
    return abs(offset - round(offset)) < _WHOLE * max(1.0, abs(offset)) and abs(offset) < 1 << 30
