"""Comparison of measured features with those of simulated sessions: p-values from the draws.

The distance of a family is the mean square of its deviations from the other sessions, in units of
their scatter. The measurement and each draw are compared with all others in the same way. Without a
difference they are therefore exchangeable: the rank of the measurement among the draws is uniform
for any distribution of the distances. Between the ranks, and beyond the largest draw, Student's t
for the logarithm of the distance gives the rest of the p-value. The p-value can therefore be
smaller than one over the number of draws. For rare events, such as stalls of the host, the
logarithm of the distance does not have such a distribution: most sessions have no event, and one
has many. For these, only the rank counts.

What to use when: `compare_families` for all families of a recording, `upper_tail` for one value,
`rank_probability` for one value of rare events.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from gyrorig_solver.data import FloatArray
from gyrorig_solver.twin_check.session_features import Family

MIN_DRAWS = 4
TINY = 1e-12  # distance of a session that is equal to the mean of all others


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

    def deviations(values: FloatArray, others: FloatArray) -> FloatArray:
        spread = np.sqrt(others.var(axis=0, ddof=1) + family.floor**2)
        spread *= np.sqrt(1.0 + 1.0 / len(others))
        return np.asarray((values - others.mean(axis=0)) / spread, dtype=np.float64)

    z = np.where(known, deviations(family.values, draws), np.nan)
    sessions = np.vstack([family.values, draws])[:, known]
    distances = np.array(
        [
            np.mean(deviations(sessions[row], np.delete(sessions, row, axis=0)) ** 2)
            for row in range(len(sessions))
        ]
    )
    logarithms = np.log(distances + TINY)
    tail = rank_probability if family.is_of_rare_events else upper_tail
    p_value = tail(float(logarithms[0]), logarithms[1:])
    std: FloatArray = np.asarray(np.sqrt(draws.var(axis=0, ddof=1) + family.floor**2))
    return FamilyComparison(
        family, draws.mean(axis=0), std, z, float(np.sqrt(distances[0])), p_value
    )


def upper_tail(value: float, sample: FloatArray) -> float:
    """Return the probability that one more value of a distribution is larger than `value`.

    The rank among n values selects one of n + 1 equally probable intervals. Within this interval,
    Student's t for one more value of a normal sample gives the probability.

    Args:
        value: the measured value.
        sample: values of the distribution, at least 2.
    """
    descending = np.sort(sample)[::-1]
    larger = int(np.count_nonzero(descending > value))
    cells = sample.size + 1
    if np.any(descending == value):
        return rank_probability(value, sample)
    spread = float(sample.std(ddof=1)) * np.sqrt(1.0 + 1.0 / sample.size)
    if spread <= 0.0:
        return 0.0 if larger == 0 else 1.0

    def tail(x: float) -> float:
        return float(special.stdtr(sample.size - 1, -(x - float(sample.mean())) / spread))

    above = tail(float(descending[larger - 1])) if larger else 0.0
    below = tail(float(descending[larger])) if larger < sample.size else 1.0
    return (larger + (tail(value) - above) / (below - above)) / cells


def rank_probability(value: float, sample: FloatArray) -> float:
    """Return the mean rank of a value in a sample, as a share: at least 1/(n + 1).

    Args:
        value: the measured value.
        sample: values of the distribution, n.
    """
    larger = int(np.count_nonzero(sample > value))
    equal = int(np.count_nonzero(sample == value))
    if equal == sample.size:
        return 1.0
    middle = (equal + 1) / 2.0 if equal else 1.0
    return (larger + middle) / (sample.size + 1)
