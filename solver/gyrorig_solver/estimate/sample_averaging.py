"""Means of consecutive samples, which limit memory and time of a fit to a long recording.

A fit needs several kB for each sample, so that a recording of a night would need many GB. The
solver therefore replaces the samples of a long recording by means. The model of a mean is the mean
rate between its edges, which is exact; the low-pass of the sensor acts as a distribution of delays.
A mean lasts at least one period of the bandwidth. See decision 0079.

What to use when: `averaging_factor` for a recording, `average_samples` for each of its series.
"""

import math

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.count_columns import CountArray
from gyrorig_solver.data.samples import GyroSamples

MAX_SERIES_SAMPLES = 500_000  # 10 min at 800 Hz, 83 min at 100 Hz
MAX_MEANS = 100_000
MAX_FILLED_SAMPLES = 3  # in sequence


def averaging_factor(sample_count: int, rate_hz: float, bandwidth_hz: float | None) -> int:
    """Return the number of samples per mean; 1 for a recording that is short enough."""
    if sample_count <= MAX_SERIES_SAMPLES:
        return 1
    least = 1 if bandwidth_hz is None else math.ceil(rate_hz / bandwidth_hz)
    return max(least, math.ceil(sample_count / MAX_MEANS))


def mean_duration_s(samples: GyroSamples) -> float:
    """Return the duration of the means that replace the samples of a recording; 0 for none."""
    period_s = samples.period_s
    factor = averaging_factor(samples.number.size, 1.0 / period_s, samples.bandwidth_hz)
    return factor * period_s if factor > 1 else 0.0


def average_samples(
    time_s: FloatArray, raw: CountArray, good: BoolArray, factor: int
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return times, sums of the raw rates and validity of the means.

    A few successive invalid samples are interpolated. Otherwise many means would be missing, and
    the gaps would hide the slow noise. A mean with more invalid samples is invalid.

    Args:
        time_s: of every sample number, (n,).
        raw: counts or rates, (n, 3).
        good: which samples are valid, (n,).
        factor: samples per mean.

    Returns:
        Times (m,), sums (m, 3), which are `factor` times the mean, and validity (m,).
    """
    count = time_s.size // factor
    n = count * factor
    raw, good = _fill_short_gaps(raw[:n], good[:n])
    return (
        np.asarray(time_s[:n].reshape(count, factor).mean(axis=1), dtype=np.float64),
        np.asarray(raw.reshape(count, factor, 3).sum(axis=1, dtype=np.float64)),
        np.asarray(good.reshape(count, factor).all(axis=1), dtype=np.bool_),
    )


def _fill_short_gaps(raw: CountArray, good: BoolArray) -> tuple[CountArray, BoolArray]:
    """Return samples with short gaps interpolated, and the new mask of valid samples."""
    if good.all() or not good.any():
        return raw, good
    edges = np.flatnonzero(np.diff(np.concatenate([[True], good, [True]]).astype(np.int8)))
    begin, end = edges[::2], edges[1::2]  # of each gap
    is_short = (end - begin <= MAX_FILLED_SAMPLES) & (begin > 0) & (end < good.size)
    filled_good = good.copy()
    for first, last in zip(begin[is_short], end[is_short], strict=True):
        filled_good[first:last] = True
    positions = np.flatnonzero(filled_good & ~good)
    filled = raw.astype(np.float64)
    good_positions = np.flatnonzero(good)
    for axis in range(3):
        filled[positions, axis] = np.interp(positions, good_positions, raw[good, axis])
    return filled, filled_good
