"""A board known to lie still: the reference that shows bias and noise, and nothing else."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.reference.motion import Evaluated
from gyrorig_solver.reference.turns import Interval


@dataclass(frozen=True, slots=True, eq=False)
class RestReference:
    """No turning inside the rests; not known outside. Earth's own rate is left out."""

    rests: tuple[Interval, ...]

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        return f"{len(self.rests)} rests, in which nothing turned"

    @property
    def information(self) -> Arrow:
        """There are no unknowns."""
        return Arrow.zero(0, 0)

    @property
    def pull(self) -> FloatArray:
        """There are no unknowns."""
        return np.zeros(0)

    @property
    def common_std_s(self) -> float:
        """Nothing moves, so time does not matter."""
        return 0.0

    @property
    def differentiated(self) -> bool:
        """False: zero is exact."""
        return False

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> Evaluated:
        """Return zero rate inside the rests, nan outside."""
        del derivatives
        rate = np.full((edges_s.size - 1, 3), np.nan)
        for rest in self.rests:
            inside = (edges_s[:-1] >= rest.begin_s) & (edges_s[1:] <= rest.end_s)
            rate[inside] = 0.0
        return Evaluated(rate, (), np.zeros((0, edges_s.size - 1, 3)))

    def moved(self, step: FloatArray) -> Self:
        """Return the same: there is nothing to change."""
        del step
        return self


def mostly_at_rest(rests: Sequence[Interval], span_s: float) -> bool:
    """Return True where the rests fill nine tenths of a recording."""
    return sum(rest.end_s - rest.begin_s for rest in rests) > 0.9 * span_s
