"""Description of an effect outside the catalogue: how to add it, and its right covariates."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gyrorig_daemon.emulator.emulator_settings import RigSettings
from gyrorig_daemon.emulator.injection import Quantity
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


@dataclass(frozen=True, slots=True)
class Site:
    """The rig and the draws of an effect; its generator starts with the same seed each time."""

    size: float
    rng: np.random.Generator
    hooks: RigHooks
    rig: RigSettings

    @property
    def board(self) -> str:
        """The board with the effect."""
        return self.rig.boards[0].name

    def draw_direction(self) -> np.ndarray:
        """Return a random direction, at most 1 on each axis, (3,)."""
        drawn = self.rng.standard_normal(3)
        return np.asarray(drawn / np.abs(drawn).max())


ShapeAdder = Callable[[Site], dict[str, Quantity]]


@dataclass(frozen=True, slots=True)
class Shape:
    """An effect outside the catalogue."""

    name: str
    description: str  # of the physics
    unit: str  # of the size
    start: float  # first size of the search
    groups: tuple[str, ...]  # covariates, one of which the solver must report first
    add: ShapeAdder
    near: str | None = None  # the similar cause of the catalogue
    most: float = 1e3  # largest size that still is this effect
    needs_soak: bool = False
    needs_tilted_pan: bool = False  # visible only in programs that pan while tilted
