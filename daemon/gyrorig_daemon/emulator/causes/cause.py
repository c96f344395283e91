"""What a cause is: its name, its part of the rig, its sizes, and how it gets into a rig.

`draw` turns a size into parameters, with directions, phases and times from the seed; the
parameters are all that the truth document says and all that `hang` needs to put the effect
on the rig. Helpers for both are below.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.hooks import BoardHooks, RigHooks
from gyrorig_daemon.emulator.settings import BoardSettings, RigSettings

FloatArray = NDArray[np.float64]
Part = Literal["clock", "link", "sensor", "ptu", "mount", "environment"]

SENSOR_AXES = ("x", "y", "z")
UNIT_AXES = ("pan", "tilt")


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number, or one for each axis, and its unit."""

    value: float | tuple[float, ...]
    unit: str

    @property
    def number(self) -> float:
        """The value of a quantity that is one number."""
        if isinstance(self.value, tuple):
            raise TypeError("this quantity has a value for each axis")
        return self.value

    @property
    def array(self) -> FloatArray:
        """The values of a quantity that has several."""
        return np.array(self.value, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Draw:
    """What the parameters of a cause are drawn from."""

    size: float
    place: str  # one of the cause's places, "" for all of them together
    rng: np.random.Generator
    rig: RigSettings
    board: BoardSettings

    def event_s(self) -> float:
        """Return an instant in the middle of the session, since power-up."""
        begin_s, end_s = self.rig.session_s
        return begin_s + (end_s - begin_s) * float(self.rng.uniform(0.35, 0.65))

    def phase_rad(self) -> float:
        """Return any phase."""
        return float(self.rng.uniform(-np.pi, np.pi))

    def by_axis(self, unit: str) -> Quantity:
        """Return the size on one sensor axis, or in a random direction: at most it on each."""
        if self.place in SENSOR_AXES:
            direction = np.eye(3)[SENSOR_AXES.index(self.place)]
        else:
            direction = self.rng.standard_normal(3)
            direction = direction / np.abs(direction).max()
        return Quantity(tuple((self.size * direction).tolist()), unit)


@dataclass(frozen=True, slots=True)
class Hidden:
    """A cause with its parameters, as it is hung on a rig and told in the truth."""

    cause: str
    part: Part
    where: str
    board: str | None
    size: Quantity
    parameters: Mapping[str, Quantity]

    def number(self, name: str) -> float:
        """Return a parameter that is one number."""
        return self.parameters[name].number

    def array(self, name: str) -> FloatArray:
        """Return a parameter that has several."""
        return self.parameters[name].array

    def to_document(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "cause": self.cause,
            "part": self.part,
            "where": self.where,
            "board": self.board,
            "size": _plain(self.size),
            "parameters": {name: _plain(told) for name, told in self.parameters.items()},
        }


def _plain(told: Quantity) -> dict[str, Any]:
    value = list(told.value) if isinstance(told.value, tuple) else told.value
    return {"value": value, "unit": told.unit}


Drawer = Callable[[Draw], dict[str, Quantity]]
Hanger = Callable[[Hidden, RigHooks, np.random.Generator], None]


@dataclass(frozen=True, slots=True)
class Cause:
    """A physical cause that a rig can hide."""

    name: str
    size_is: str  # what its size means
    part: Part
    unit: str  # of the size
    typical: float
    lowest: float  # sizes are drawn from here ...
    highest: float  # ... to here, evenly in the logarithm
    most: float  # larger ones are refused
    draw: Drawer
    hang: Hanger
    places: tuple[str, ...] = ()
    together: bool = False  # without a place named: all of them, not one of them
    signed: bool = True
    least: float = 0.0  # smaller ones are refused
    sizes: tuple[float, ...] = ()  # the only ones that are drawn, where there are such
    whole: bool = False  # only whole sizes make sense
    neutral: float = 0.0  # the size at which there is nothing
    most_on: Callable[[BoardSettings], float] | None = None  # less than `most` on this board

    @property
    def on_board(self) -> bool:
        """True when it is one board's, not the unit's or the world's."""
        return self.part in ("clock", "link", "sensor", "mount")

    def to_document(self) -> dict[str, Any]:
        """Return plain values: what can be asked for."""
        return {
            "cause": self.name,
            "part": self.part,
            "places": list(self.places),
            "size": self.size_is,
            "unit": self.unit,
            "typical": self.typical,
            "drawn": list(self.sizes) or [self.lowest, self.highest],
            "signed": self.signed,
            "nothing_at": self.neutral,
        }


def board_of(hidden: Hidden, hooks: RigHooks) -> BoardHooks:
    """Return the hooks of the board that a cause sits on."""
    return hooks.board(hidden.board or "")


def axes_of(hidden: Hidden) -> tuple[str, ...]:
    """Return the axes that a cause sits on."""
    return tuple(hidden.where.split(","))
