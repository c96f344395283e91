"""Interface of an effect outside the catalogue, and its entry in the table.

An effect overrides one method of `Effect`. `OutsideEffect` is its entry in the table.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.stage_motion import StageMotion, StepTracks


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """An effect that changes nothing; others override one method."""

    def added_angles_rad(self, tracks: StepTracks) -> tuple[FloatArray, FloatArray]:
        """Return the added angles of pan and tilt at the edges of the grid."""
        nothing = np.zeros(tracks.edges_s.size)
        return nothing, nothing

    def added_rates_rad_s(self, motion: StageMotion, span_s: tuple[float, float]) -> FloatArray:
        """Return the added rates at the output of the sensing element, (n, 3) or (1, 3)."""
        return np.zeros((1, 3))

    def axis_lags_s(self) -> FloatArray:
        """Return the added lag of each axis, (3,)."""
        return np.zeros(3)

    def noise_amplitude(self, motion: StageMotion, span_s: tuple[float, float]) -> FloatArray:
        """Return the white noise's amplitude relative to that at rest, (n,) or (1,)."""
        return np.ones(1)


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """The draws of an effect; the generator starts with the same seed each time."""

    size: float
    rng: np.random.Generator
    span_s: tuple[float, float]

    def draw_direction(self) -> FloatArray:
        """Return a random direction whose largest component is 1, (3,)."""
        drawn = self.rng.standard_normal(3)
        return np.asarray(drawn / np.abs(drawn).max())


@dataclass(frozen=True, slots=True)
class OutsideEffect:
    """One effect outside the catalogue.

    Attributes:
        start: first size of the search for the right size.
        most: largest size that still is this effect.
        groups: covariates, one of which an explanation must report.
        in_variance: whether it changes only the scatter.
        near: the similar cause of the catalogue.
    """

    name: str
    description: str
    unit: str
    start: float
    most: float
    groups: tuple[str, ...]
    make: Callable[[Site], Effect]
    in_variance: bool = False
    near: str | None = None
