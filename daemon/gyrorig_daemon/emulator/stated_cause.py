"""A cause as findings state it, and what an emulated rig makes of it.

`Cause.from_findings` converts a `StatedCause` to `CarriedCause`s. Names, units and signs of the
stated values are those of `gyrorig/findings/1`. The base parameters of the same fit contain what
the base model absorbs of a cause, for example the mean of a growing delay. A `CarriedCause` states
that part, so that the emulator takes it out of the base parameters.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrorig_protocol.errors import UsageError

FloatArray = NDArray[np.float64]

SENSOR_AXES = ("x", "y", "z")
UNIT_AXES = ("pan", "tilt")


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number, or one number per axis, and its unit."""

    value: float | tuple[float, ...]
    unit: str

    @property
    def number(self) -> float:
        """The value of a scalar quantity."""
        if isinstance(self.value, tuple):
            raise TypeError("this quantity has one value per axis")
        return self.value

    @property
    def array(self) -> FloatArray:
        """The values of a quantity per axis."""
        return np.array(self.value, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class StatedBoard:
    """What conversions need of the board of a cause."""

    mounting: FloatArray  # M, stage to sensor, (3, 3)
    full_scale_rad_s: float
    period_s: float
    bandwidth_hz: float  # as configured
    reference_rise_k: float  # of the reference temperature of thermal causes, since power-up


@dataclass(frozen=True, slots=True, eq=False)
class StatedCause:
    """A cause with the values of a fit."""

    name: str
    places: tuple[str, ...]  # axes; () for all
    values: Mapping[str, float]  # by name, such as `gap.pan`
    zero_s: float  # the zero of its times, since power-up, by the clock of the samples
    begin_s: float  # begin of its recording, on the same clock
    end_s: float
    step_rad: Mapping[str, float]  # signed angle of a step of each axis of the unit
    latitude_deg: float | None = None
    heading_deg: float | None = None
    board: StatedBoard | None = None
    period_share: float = 0.0  # of a period by which a cause that repeats is later than stated

    @property
    def on_board(self) -> StatedBoard:
        """The board of a cause that acts on one."""
        if self.board is None:
            raise self.error("it has no board", "write the id of its board under `board`")
        return self.board

    @property
    def middle_s(self) -> float:
        """The middle of the recording, since power-up."""
        return 0.5 * (self.begin_s + self.end_s)

    @property
    def latest_s(self) -> float:
        """A time after the end of any session like this one."""
        return 1.3 * self.end_s + 10.0

    def number(self, name: str, default: float | None = None) -> float:
        """Return a value.

        Raises:
            UsageError: it is not stated, and has no default.
        """
        value = self.values.get(name, default)
        if value is None:
            raise self.error(
                f"it has no parameter {name!r}",
                "write the parameters as `gyrorig explain` states them",
            )
        return value

    def has(self, name: str) -> bool:
        """Return whether a value is stated, for at least one axis."""
        return any(key.partition(".")[0] == name for key in self.values)

    def by_sensor_axis(self, name: str, unit: str) -> Quantity:
        """Return the value of each sensor axis, 0 where none is stated."""
        return Quantity(tuple(self.values.get(f"{name}.{axis}", 0.0) for axis in SENSOR_AXES), unit)

    def by_unit_axis(self, name: str) -> Iterator[tuple[str, float]]:
        """Yield the axes of the unit that have a value other than 0, with this value."""
        for axis in UNIT_AXES:
            value = self.values.get(f"{name}.{axis}", 0.0)
            if value != 0.0:
                yield axis, value

    def event_s(self) -> Quantity:
        """Return the time of a single event, since power-up."""
        return Quantity(self.zero_s + self.number("time"), "s")

    def harmonics(
        self, cosine: str = "cosine", sine: str = "sine"
    ) -> Iterator[tuple[str, float, float]]:
        """Yield axis, amplitude and phase of cosine and sine: amplitude sin(angle + phase)."""
        for axis in UNIT_AXES:
            c, s = (self.values.get(f"{name}.{axis}", 0.0) for name in (cosine, sine))
            if c != 0.0 or s != 0.0:
                yield axis, math.hypot(c, s), math.atan2(c, s)

    def error(self, problem: str, remedy: str) -> UsageError:
        """Return an error about this cause."""
        return UsageError(f"the cause {self.name} of the twin cannot be used: {problem}", remedy)


@dataclass(frozen=True, slots=True, eq=False)
class CarriedCause:
    """A cause as the emulated rig has it, and what base parameters contain of it."""

    parameters: Mapping[str, Quantity]
    component: str = ""  # axes, as in an injected cause; "" for all
    delay_s: float = 0.0  # in the time offset
    start_delay_s: float = 0.0  # in the start delay of the unit, mean over its axes
    stage_turn_rad: FloatArray = field(default_factory=lambda: np.zeros(3))  # in the gain
