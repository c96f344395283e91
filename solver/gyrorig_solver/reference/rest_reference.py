"""A board at rest as the reference, which determines bias and noise only."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.numerics import ArrowheadMatrix
from gyrorig_solver.reference.known_turns import TimeInterval
from gyrorig_solver.reference.reference_motion import EvaluatedMotion


@dataclass(frozen=True, slots=True, eq=False)
class RestReference:
    """Zero rate in the rests, unknown outside; the rate of the Earth is neglected."""

    rests: tuple[TimeInterval, ...]

    @property
    def description(self) -> str:
        """One sentence on the reference."""
        return f"{len(self.rests)} rests without motion"

    @property
    def information(self) -> ArrowheadMatrix:
        """There are no unknowns."""
        return ArrowheadMatrix.zero(0, 0)

    @property
    def prior_offset(self) -> FloatArray:
        """There are no unknowns."""
        return np.zeros(0)

    @property
    def common_shift_std_s(self) -> float:
        """Zero, because time has no influence at rest."""
        return 0.0

    @property
    def is_differentiated(self) -> bool:
        """False, because the zero rate is exact."""
        return False

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> EvaluatedMotion:
        """Return zero rate in the rests, nan outside."""
        del derivatives
        rate = np.full((edges_s.size - 1, 3), np.nan)
        for rest in self.rests:
            inside = (edges_s[:-1] >= rest.begin_s) & (edges_s[1:] <= rest.end_s)
            rate[inside] = 0.0
        return EvaluatedMotion(rate, (), np.zeros((0, edges_s.size - 1, 3)))

    def with_step(self, step: FloatArray) -> Self:
        """Return the same reference, which has no unknowns."""
        del step
        return self


def mostly_at_rest(rests: Sequence[TimeInterval], span_s: float) -> bool:
    """Return whether the rests cover nine tenths of a recording."""
    return sum(rest.end_s - rest.begin_s for rest in rests) > 0.9 * span_s
