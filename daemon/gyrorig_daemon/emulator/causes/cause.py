"""The base class of the causes that an emulated rig can inject, and their parameters.

A cause is one class in a separate file. Its class attributes describe it (`Cause`),
`sample_parameters` turns a size into physical parameters, `from_findings` turns the values of
findings into them, and `apply` puts the effect on a rig. Directions, phases and times are sampled
from the rig's seed. The truth document lists the parameters; `apply` needs nothing else.

The physics is part of the class too: an instance of a cause is its effect on one rig, behind
one of the interfaces in `physics.effects`. A cause that only changes a number of the rig (a
scale error, a window, a cut-off) has no instances.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.emulator_settings import BoardSettings, RigSettings
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples
from gyrorig_daemon.emulator.physics.effects.rig_hooks import AxisHooks, BoardHooks, RigHooks
from gyrorig_daemon.emulator.stated_cause import (
    SENSOR_AXES,
    UNIT_AXES,
    CarriedCause,
    Quantity,
    StatedCause,
)

FloatArray = NDArray[np.float64]
Part = Literal["clock", "link", "sensor", "ptu", "mount", "environment"]

__all__ = [
    "SENSOR_AXES",
    "UNIT_AXES",
    "CarriedCause",
    "Cause",
    "FloatArray",
    "InjectedCause",
    "ParameterSampling",
    "Part",
    "Quantity",
    "RateCause",
    "SensorCause",
    "StatedCause",
    "UnitCause",
]


@dataclass(frozen=True, slots=True)
class ParameterSampling:
    """What `Cause.sample_parameters` uses: the size, the component, the rig and a generator."""

    size: float
    component: str  # one of the cause's components, "" for all of them together
    rng: np.random.Generator
    rig: RigSettings
    board: BoardSettings

    def event_s(self) -> float:
        """Sample an instant in the middle of the session, in seconds since power-up."""
        begin_s, end_s = self.rig.session_s
        return begin_s + (end_s - begin_s) * float(self.rng.uniform(0.35, 0.65))

    def phase_rad(self) -> float:
        """Sample a phase, uniform over one turn."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def by_axis(self, unit: str) -> Quantity:
        """Return the size on the chosen sensor axis, or along a random direction.

        The largest component of a random direction equals the size.
        """
        if self.component in SENSOR_AXES:
            direction = np.eye(3)[SENSOR_AXES.index(self.component)]
        else:
            direction = self.rng.standard_normal(3)
            direction = direction / np.abs(direction).max()
        return Quantity(tuple((self.size * direction).tolist()), unit)


@dataclass(frozen=True, slots=True)
class InjectedCause:
    """A cause with its parameters, as applied to a rig and written to the truth document."""

    cause: str
    part: Part
    component: str
    board: str | None
    size: Quantity
    parameters: Mapping[str, Quantity]

    @property
    def components(self) -> tuple[str, ...]:
        """The axes on which the cause acts."""
        return tuple(self.component.split(","))

    def number(self, name: str) -> float:
        """Return a scalar parameter."""
        return self.parameters[name].number

    def number_or(self, name: str, default: float) -> float:
        """Return a scalar parameter that only some causes of this name have."""
        return self.parameters[name].number if name in self.parameters else default

    def array(self, name: str) -> FloatArray:
        """Return a parameter that has one value per axis."""
        return self.parameters[name].array

    def array_or_zeros(self, name: str) -> FloatArray:
        """Return a parameter per axis that only some causes of this name have."""
        return self.parameters[name].array if name in self.parameters else np.zeros(3)

    def board_hooks(self, hooks: RigHooks) -> BoardHooks:
        """Return the hooks of the board on which the cause acts."""
        return hooks.board(self.board or "")

    def axis_hooks(self, hooks: RigHooks) -> list[AxisHooks]:
        """Return the hooks of the unit's axes on which the cause acts."""
        return [hooks.axis(name) for name in self.components]

    def to_document(self) -> dict[str, Any]:
        """Return plain values for the truth document."""
        return {
            "cause": self.cause,
            "part": self.part,
            "where": self.component,
            "board": self.board,
            "size": _plain(self.size),
            "parameters": {name: _plain(quantity) for name, quantity in self.parameters.items()},
        }


def _plain(quantity: Quantity) -> dict[str, Any]:
    value = list(quantity.value) if isinstance(quantity.value, tuple) else quantity.value
    return {"value": value, "unit": quantity.unit}


class Cause(ABC):
    """A physical cause that a rig can inject. The class attributes are its catalogue entry."""

    name: ClassVar[str]  # the id in the catalogue of causes
    size_meaning: ClassVar[str]
    part: ClassVar[Part]
    unit: ClassVar[str]  # of the size
    typical: ClassVar[float]
    sampled_min: ClassVar[float]  # sizes are sampled log-uniformly from here ...
    sampled_max: ClassVar[float]  # ... to here
    max_size: ClassVar[float]  # larger sizes are rejected
    min_size: ClassVar[float] = 0.0  # smaller sizes are rejected
    components: ClassVar[tuple[str, ...]] = ()
    acts_on_all: ClassVar[bool] = False  # without a named component: on all, not on one of them
    is_signed: ClassVar[bool] = True
    allowed_sizes: ClassVar[tuple[float, ...]] = ()  # if given, only these are sampled
    is_integer: ClassVar[bool] = False
    neutral_size: ClassVar[float] = 0.0  # the size that has no effect
    parameter: ClassVar[str] = ""  # name of the only parameter, which is the size
    stated_name: ClassVar[str] = ""  # name of this parameter in findings, if it is another

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """Return the physical parameters for a size; here, `parameter` alone."""
        return {cls.parameter: Quantity(sampling.size, cls.unit)}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """Return the cause for the values that findings state; here, `parameter` alone.

        One result per axis where the parameters of the axes differ. No result if the base
        parameters contain the whole effect.

        Raises:
            UsageError: a value is missing.
        """
        value = stated.number(cls.stated_name or cls.parameter)
        return (CarriedCause({cls.parameter: Quantity(value, cls.unit)}),)

    @classmethod
    @abstractmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """Put the effect on a rig; `rng` is for effects that are random at run time."""

    @classmethod
    def is_on_board(cls) -> bool:
        """Return whether the cause belongs to a board, not to the unit or the environment."""
        return cls.part in ("clock", "link", "sensor", "mount")

    @classmethod
    def max_size_on(cls, board: BoardSettings) -> float:
        """Return the largest size on a board with these settings."""
        return cls.max_size

    @classmethod
    def to_document(cls) -> dict[str, Any]:
        """Return the catalogue entry as plain values."""
        return {
            "cause": cls.name,
            "part": cls.part,
            "places": list(cls.components),
            "size": cls.size_meaning,
            "unit": cls.unit,
            "typical": cls.typical,
            "drawn": list(cls.allowed_sizes) or [cls.sampled_min, cls.sampled_max],
            "signed": cls.is_signed,
            "nothing_at": cls.neutral_size,
        }


class SensorCause(Cause):
    """A cause in the sensor, with a component per sensor axis."""

    part = "sensor"
    components = SENSOR_AXES
    acts_on_all = True

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """Return the physical parameters for a size; here, `parameter` alone, per axis."""
        return {cls.parameter: sampling.by_axis(cls.unit)}

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; here, `parameter` alone, per sensor axis."""
        name = cls.stated_name or cls.parameter
        return (CarriedCause({cls.parameter: stated.by_sensor_axis(name, cls.unit)}),)


@dataclass(frozen=True, eq=False)
class RateCause(SensorCause, ABC):
    """A cause that adds to the rate at the sensor element, with a coefficient per axis."""

    coefficient: FloatArray  # (3,)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        effect = cls(injected.array(cls.parameter))
        injected.board_hooks(hooks).rate_effects.append(effect)

    @abstractmethod
    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""


class UnitCause(Cause):
    """A cause in the pan-tilt unit, with a component per axis of the unit."""

    part = "ptu"
    components = UNIT_AXES

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; here, `parameter` alone, for each axis of the unit."""
        return tuple(
            CarriedCause({cls.parameter: Quantity(value, cls.unit)}, axis)
            for axis, value in stated.by_unit_axis(cls.stated_name or cls.parameter)
        )
