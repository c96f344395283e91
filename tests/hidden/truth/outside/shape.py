"""What an effect outside the catalogue is: how it hangs on a rig, and what it must show as."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.injection import Quantity
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, slots=True)
class Site:
    """Where an effect is put; every time the same, as its generator begins anew."""

    size: float
    rng: np.random.Generator
    hooks: RigHooks
    rig: RigSettings

    @property
    def board(self) -> str:
        """The board that it is on."""
        return self.rig.boards[0].name

    def direction(self) -> np.ndarray:
        """Return a random direction, at most 1 on each axis, (3,)."""
        drawn = self.rng.standard_normal(3)
        return np.asarray(drawn / np.abs(drawn).max())


Hanger = Callable[[Site], dict[str, Quantity]]


@dataclass(frozen=True, slots=True)
class Shape:
    """An effect that no cause of the catalogue is."""

    name: str
    says: str  # what it is physically
    unit: str  # of the size
    start: float  # a size to begin with
    groups: tuple[str, ...]  # what a finder's nameless tests may call it, first
    hang: Hanger
    near: str | None = None  # the cause of the catalogue that it is a variety of
    most: float = 1e3  # larger ones are no such thing any more
    needs_soak: bool = False
    needs_tilted_pan: bool = False  # shows only where pan turns, or points, away from tilt 0
