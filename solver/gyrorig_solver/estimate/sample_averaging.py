"""Means of consecutive samples, which bound memory and time of a fit to a long recording.

A fit needs several kB for each sample, so that a night would need many GB. The solver therefore
replaces the samples of a long recording by means. The model of a mean is the mean rate between its
edges, which is exact; the low-pass of the sensor acts as a distribution of delays. A mean lasts at
least one period of the bandwidth. See decision 0079.

What to use when: `averaging_factor` for a recording, `average_samples` for each of its series.
"""

import math

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.count_columns import CountArray
from gyrorig_solver.data.samples import GyroSamples

MAX_SERIES_SAMPLES = 500_000  # 10 min at 800 Hz, 83 min at 100 Hz
AVERAGED_SAMPLES = 100_000  # after averaging, at most


def averaging_factor(sample_count: int, rate_hz: float, bandwidth_hz: float | None) -> int:
    """Return how many samples form one mean; 1 for a recording that is short enough."""
    if sample_count <= MAX_SERIES_SAMPLES:
        return 1
    least = 1 if bandwidth_hz is None else math.ceil(rate_hz / bandwidth_hz)
    return max(least, math.ceil(sample_count / AVERAGED_SAMPLES))


def mean_duration_s(samples: GyroSamples) -> float:
    """Return how long each mean lasts that replaces the samples of a recording; 0 for none."""
    period_s = samples.period_s
    factor = averaging_factor(samples.number.size, 1.0 / period_s, samples.bandwidth_hz)
    return factor * period_s if factor > 1 else 0.0


def average_samples(
    time_s: FloatArray, raw: CountArray, good: BoolArray, factor: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return times, sums of the raw rates and validity of the means.

    Args:
        time_s: of every sample number, (n,).
        raw: counts or rates, (n, 3).
        good: which samples are valid, (n,). A mean with an invalid sample is invalid.
        factor: samples per mean.

    Returns:
        Times (m,), sums (m, 3), which are `factor` times the mean, and validity (m,).
    """
    count = time_s.size // factor
    n = count * factor
    return (
        np.asarray(time_s[:n].reshape(count, factor).mean(axis=1), dtype=np.float64),
        np.asarray(raw[:n].reshape(count, factor, 3).sum(axis=1, dtype=np.float64)),
        np.asarray(good[:n].reshape(count, factor).all(axis=1), dtype=np.bool_),
    )
