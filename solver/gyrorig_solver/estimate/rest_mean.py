"""Mean rate of a rest, and its standard uncertainty by noise and by rounding.

What to use when: `measure_rest` for a rest between turns; `samples_in` for the samples of a phase;
`mean_std_by_rounding` for a bias that is a mean over rests and motion.

Theory of operation. The variance of a mean of correlated samples is that of the means of blocks
that are longer than the correlation, divided by their number. It is at least that of uncorrelated
samples. Source: G. S. Fishman, "Grouping Observations in Digital Simulation", Management Science 24
(1978).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.noise.rounding import LEAST_NOISE_COUNTS
from gyrorig_solver.reference import TimeInterval

MIN_SAMPLES = 8
MIN_BLOCKS, MAX_BLOCKS, BLOCK_SAMPLES = 8, 16, 8
KNOCK_SIGMA = 6.0
WINDOW_S = 1.0  # shorter than most rests


@dataclass(frozen=True, slots=True, eq=False)
class RestMean:
    """The mean rate of one rest."""

    rate_rad_s: FloatArray  # (3,)
    noise_std_rad_s: FloatArray  # (3,)
    rounding_std_rad_s: FloatArray  # (3,), of an error that all rests share, see `std_by_rounding`
    # (3,): variance of the integral of the noise, per second.
    angle_variance_rad2_s: FloatArray

    @property
    def std_rad_s(self) -> FloatArray:
        """The standard uncertainty of the rate by noise and rounding, (3,)."""
        return np.hypot(self.noise_std_rad_s, self.rounding_std_rad_s)


def samples_in(samples: GyroSamples, interval: TimeInterval) -> IntArray:
    """Return the indices of the usable samples in an interval, shape (n,)."""
    tolerance_s = 0.25 * samples.period_s
    picked = (samples.time_s >= interval.begin_s - tolerance_s) & (
        samples.time_s <= interval.end_s + tolerance_s
    )
    return np.flatnonzero(picked & samples.usable).astype(np.int64)


def measure_rest(samples: GyroSamples, interval: TimeInterval) -> RestMean:
    """Return the mean rate of a rest, without knocks.

    Args:
        samples: of the recording.
        interval: of the rest, s since the recording's origin.

    Raises:
        InputError: the rest has fewer than `MIN_SAMPLES` usable samples.
    """
    rate = samples.rate_rad_s[samples_in(samples, interval)]
    if len(rate) < MIN_SAMPLES:
        raise InputError(
            f"the rest at {interval.begin_s:.1f} s has only {len(rate)} usable samples, and "
            f"{MIN_SAMPLES} are needed",
            "make the rest longer, or remove it from the motion program or the import map",
        )
    median = np.median(rate, axis=0)
    # The median absolute deviation would be 0 if most samples have the same count.
    low, high = np.percentile(rate, (5.0, 95.0), axis=0)
    spread = (high - low) / 3.29 + samples.quantum_rad_s
    inliers = rate[np.all(np.abs(rate - median) < KNOCK_SIGMA * spread, axis=1)]
    noise_std = std_of_mean(inliers)
    return RestMean(
        rate_rad_s=inliers.mean(axis=0),
        noise_std_rad_s=noise_std,
        rounding_std_rad_s=std_by_rounding(inliers, samples.quantum_rad_s),
        angle_variance_rad2_s=noise_std**2 * len(inliers) * samples.period_s,
    )


def std_of_mean(rate: FloatArray) -> FloatArray:
    """Return the standard deviation of the mean of correlated samples, (3,)."""
    white = np.std(rate, axis=0, ddof=1) / np.sqrt(len(rate))
    count = int(np.clip(len(rate) // BLOCK_SAMPLES, MIN_BLOCKS, MAX_BLOCKS))
    blocks = np.array([block.mean(axis=0) for block in np.array_split(rate, count)])
    # Student's t of n - 1 degrees of freedom has the variance (n - 1) / (n - 3).
    by_blocks = np.std(blocks, axis=0, ddof=1) / np.sqrt(count) * np.sqrt((count - 1) / (count - 3))
    return np.asarray(np.maximum(white, by_blocks), dtype=np.float64)


def std_by_rounding(rate: FloatArray, quantum_rad_s: float) -> FloatArray:
    """Return what rounding adds if the noise does not move the samples over several counts, (3,).

    The position of the rate within a count is then unknown, as in `noise.rounding`. All rests of a
    board with a constant bias have the same position, so that more rests do not reduce the error.

    Args:
        rate: of a rest, (n, 3), or of several, (k, n, 3), which give (k, 3).
        quantum_rad_s: step of the rounding.
    """
    noise_variance = np.var(rate, axis=-2, ddof=1) - quantum_rad_s**2 / 12.0
    is_coarse = noise_variance < (LEAST_NOISE_COUNTS * quantum_rad_s) ** 2
    return np.where(is_coarse, quantum_rad_s / np.sqrt(12.0), 0.0)


def mean_std_by_rounding(samples: GyroSamples) -> FloatArray:
    """Return what rounding adds to the mean over a whole recording, (3,).

    Motion moves the samples over several counts, so that its rounding averages out. The error is
    therefore that of a rest, times the share of the windows in which the samples hardly move.

    Args:
        samples: of the recording.
    """
    rate = samples.rate_rad_s[samples.usable]
    length = max(MIN_SAMPLES, round(WINDOW_S / samples.period_s))
    count = len(rate) // length
    if count == 0:
        return np.zeros(3)
    windows = rate[: count * length].reshape(count, length, 3)
    return np.asarray(std_by_rounding(windows, samples.quantum_rad_s).mean(axis=0), np.float64)
