"""Many runs judged: efficiency, coverage, chi-squared, each with its own uncertainty.

Efficiency is the bound over the achieved standard deviation. From 200 runs that ratio is
known to 5 %; a best estimate (see `bound`) made of the same noise errs alike, and the ratio
of the two is known several times better. Both are given; the second decides.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats
from tests.bench.accuracy.board import GROUPS, NAMES
from tests.bench.accuracy.profile import FloatArray

RESAMPLED = 1000
SIGMA_68, SIGMA_95 = float(stats.norm.ppf(0.84134)), float(stats.norm.ppf(0.975))
OFFSET = NAMES.index("time_offset")


@dataclass(frozen=True, slots=True)
class Figure:
    """One number with its 95 % interval over other seeds."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """The runs of one case in which every parameter was seen."""

    error: FloatArray  # (runs, 13)
    std: FloatArray
    bound: FloatArray
    best: FloatArray
    chi2: FloatArray  # (runs,)
    best_chi2: FloatArray
    begin: FloatArray  # (runs, 3), error of the bias as it was at the begin
    common_s: FloatArray  # (runs,), of the offset: what no answer can show
    common_std_s: FloatArray
    stated_common_s: FloatArray
    failed: int

    @property
    def count(self) -> int:
        """How many."""
        return int(self.chi2.size)

    def apart(self) -> "Runs":
        """Return the same with the constant of the shortest exchange taken out of the offset."""
        error, best = self.error.copy(), self.best.copy()
        error[:, OFFSET] -= self.common_s
        best[:, OFFSET] -= self.common_s
        std, bound = self.std.copy(), self.bound.copy()
        for part, common_s in ((std, self.stated_common_s), (bound, self.common_std_s)):
            rest = part[:, OFFSET] ** 2 - common_s**2
            part[:, OFFSET] = np.sqrt(np.maximum(rest, 0.0))
        return replace(self, error=error, std=std, bound=bound, best=best)


def gather(rows: Sequence[dict[str, Any]]) -> Runs:
    """Return the runs of one case as arrays."""
    whole = [row for row in rows if row.get("shown") == len(NAMES)]

    def column(name: str) -> FloatArray:
        return np.array([row[name] for row in whole], dtype=np.float64)

    return Runs(
        error=column("error"),
        std=column("std"),
        bound=column("bound"),
        best=column("best"),
        chi2=column("chi2"),
        best_chi2=column("best_chi2"),
        begin=column("bias_at_begin"),
        common_s=column("common_s"),
        common_std_s=column("common_std_s"),
        stated_common_s=column("stated_common_s"),
        failed=len(rows) - len(whole),
    )


def members(group: str) -> list[int]:
    """Return which parameters a group such as `scale` or `time_offset` has."""
    return [k for k, name in enumerate(NAMES) if name.split(".")[0] == group]


ALL_GROUPS = (*GROUPS, "time_offset")


def efficiency(runs: Runs, parameter: int) -> Figure:
    """Return bound over achieved deviation, interval by the chi-squared law of a variance."""
    z = runs.error[:, parameter] / runs.bound[:, parameter]
    n, mean_square = z.size, float(np.mean(z**2))
    low, high = (float(stats.chi2.ppf(share, n)) / n for share in (0.025, 0.975))
    value = 1.0 / float(np.sqrt(mean_square))
    return Figure(value, value * float(np.sqrt(low)), value * float(np.sqrt(high)))


def paired_efficiency(runs: Runs, parameter: int) -> Figure:
    """Return the deviation of the best estimate over that of the solver, on the same noise."""
    normalised = (runs.error[:, parameter] / runs.bound[:, parameter]) ** 2
    best = (runs.best[:, parameter] / runs.bound[:, parameter]) ** 2
    return ratio(best, normalised)


def ratio(upper: FloatArray, lower: FloatArray) -> Figure:
    """Return the root of a ratio of mean squares of pairs, interval by resampling the pairs."""
    rng = np.random.default_rng(0)
    pick = rng.integers(upper.size, size=(RESAMPLED, upper.size))
    many = np.sqrt(upper[pick].mean(axis=1) / lower[pick].mean(axis=1))
    low, high = np.percentile(many, [2.5, 97.5])
    return Figure(float(np.sqrt(upper.mean() / lower.mean())), float(low), float(high))


def covered(runs: Runs, parameter: int, sigma: float) -> Figure:
    """Return how often the stated interval holds the truth (Clopper and Pearson)."""
    inside = np.abs(runs.error[:, parameter]) <= sigma * runs.std[:, parameter]
    interval = stats.binomtest(int(inside.sum()), inside.size).proportion_ci(0.95)
    return Figure(float(inside.mean()), float(interval.low), float(interval.high))


def covered_together(runs: Runs, parameters: Sequence[int], sigma: float) -> Figure:
    """Return the same over several parameters; runs are independent, parameters are not."""
    at = list(parameters)
    if len(at) == 1:
        return covered(runs, at[0], sigma)
    inside = (np.abs(runs.error[:, at]) <= sigma * runs.std[:, at]).mean(axis=1)
    return mean_of(inside)


def mean_of(values: FloatArray) -> Figure:
    """Return a mean with its interval."""
    mean = float(values.mean())
    half = 1.96 * float(values.std(ddof=1)) / float(np.sqrt(values.size))
    return Figure(mean, mean - half, mean + half)


def stated_over_bound(runs: Runs, parameter: int) -> float:
    """Return the median of stated deviation over bound."""
    return float(np.median(runs.std[:, parameter] / runs.bound[:, parameter]))


def mean_error(runs: Runs, parameter: int) -> Figure:
    """Return the mean error in units of the bound."""
    return mean_of(runs.error[:, parameter] / runs.bound[:, parameter])


def chi2_p_value(chi2: FloatArray, freedom: int) -> float:
    """Return the Kolmogorov-Smirnov probability of the joint chi-squared."""
    return float(stats.kstest(chi2, stats.chi2(freedom).cdf).pvalue)
