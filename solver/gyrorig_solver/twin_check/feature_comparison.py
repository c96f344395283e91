"""Comparison of measured features with those of simulated sessions: p-values from the draws.

The distance of a family is the mean square of its deviations from the draws, in units of their
scatter. Each draw is compared with the other draws in the same way. If the simulation is right, the
measurement is one more draw. The logarithm of the distance is nearly normal, therefore the p-value
is the upper tail of Student's t for one more value of a normal sample. It can be smaller than
one over the number of draws.

What to use when: `compare_families` for all families of a recording, `upper_tail` for one value.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from gyrorig_solver.data import FloatArray
from gyrorig_solver.twin_check.session_features import Family

MIN_DRAWS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FamilyComparison:
    """One family: the measurement and the draws."""

    family: Family  # of the measurement
    mean: FloatArray  # (m,), of the draws
    std: FloatArray  # (m,), scatter of one session
    z: FloatArray  # (m,), deviation of the measurement in units of the scatter
    distance: float  # rms of z
    p_value: float

    @property
    def worst(self) -> int:
        """Position of the feature that deviates most."""
        return int(np.nanargmax(np.abs(self.z)))

    @property
    def size(self) -> float:
        """Root mean square of the deviations beyond the scatter, in the family's unit."""
        deviation = (self.family.values - self.mean) ** 2 - self.std**2
        return float(np.sqrt(max(0.0, float(np.nanmean(deviation)))))


def compare_families(
    measured: Sequence[Family], draws: Sequence[Sequence[Family]]
) -> list[FamilyComparison]:
    """Compare every family of the measurement with the same family of the draws."""
    tables = [{family.key: family for family in draw} for draw in draws]
    comparisons = []
    for family in measured:
        simulated = [
            table[family.key].values
            for table in tables
            if family.key in table and table[family.key].values.shape == family.values.shape
        ]
        if len(simulated) >= MIN_DRAWS:
            comparison = _compare(family, np.stack(simulated))
            if comparison is not None:
                comparisons.append(comparison)
    return comparisons


def _compare(family: Family, draws: FloatArray) -> FamilyComparison | None:
    """Compare one family with its values in the draws, shape (k, m)."""
    known = np.isfinite(family.values) & np.isfinite(draws).all(axis=0)
    if not known.any():
        return None
    count = len(draws)

    def deviations(values: FloatArray, others: FloatArray) -> FloatArray:
        spread = np.sqrt(others.var(axis=0, ddof=1) + family.floor**2)
        spread *= np.sqrt(1.0 + 1.0 / len(others))
        return np.asarray((values - others.mean(axis=0)) / spread, dtype=np.float64)

    z = np.where(known, deviations(family.values, draws), np.nan)
    deviations_of_draws = [
        deviations(draws[row], np.delete(draws, row, axis=0))[known] for row in range(count)
    ]
    distance = float(np.mean(z[known] ** 2))
    distances = np.array([float(np.mean(values**2)) for values in deviations_of_draws])
    tiny = 1e-12
    p_value = upper_tail(np.log(distance + tiny), np.log(distances + tiny))
    std: FloatArray = np.asarray(np.sqrt(draws.var(axis=0, ddof=1) + family.floor**2))
    return FamilyComparison(family, draws.mean(axis=0), std, z, float(np.sqrt(distance)), p_value)


def upper_tail(value: float, sample: FloatArray) -> float:
    """Return the probability that one more value of a normal sample is larger than `value`.

    Source: the prediction interval of a normal sample, with Student's t.
    """
    count = sample.size
    spread = float(sample.std(ddof=1)) * np.sqrt(1.0 + 1.0 / count)
    if spread <= 0.0:
        return 1.0 if value <= float(sample.mean()) else 0.0
    return float(special.stdtr(count - 1, -(value - float(sample.mean())) / spread))
