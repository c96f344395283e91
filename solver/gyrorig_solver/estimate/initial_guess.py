"""Initial guess of a fit: the lag by correlation, gain and bias by least squares.

What to use when: `correlation_lag` for one series; `LeastSquaresSums` for the sums over a
recording; `solve_shared_gain` to combine recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.series import Series

MAX_LAG_S = 0.3  # range of the search
NOMINAL_WEIGHT = 1e-4  # of the nominal gain, (rad/s)^2 times samples
MAX_CORRELATED_BLOCKS = 1 << 17  # some minutes show the lag as well as hours
MIN_SPEED_STD_RAD_S = 0.003  # with less variation, the lag cannot be found


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresSums:
    """Sums of unweighted least squares over one recording: (rate, 1) to measured rate."""

    gram: FloatArray  # (4, 4)
    moment: FloatArray  # (4, 3)
    square: float  # sum of the squared measured rates

    def __add__(self, other: "LeastSquaresSums") -> "LeastSquaresSums":
        """Add the sums of another series."""
        return LeastSquaresSums(
            self.gram + other.gram, self.moment + other.moment, self.square + other.square
        )

    def without_bias(self) -> "LeastSquaresSums":
        """Return the sums with the recording's bias eliminated, (3, 3) each."""
        count = max(float(self.gram[3, 3]), 1.0)
        mean, measured = self.gram[3, :3] / count, self.moment[3] / count
        return LeastSquaresSums(
            self.gram[:3, :3] - count * np.outer(mean, mean),
            self.moment[:3] - count * np.outer(mean, measured),
            self.square - count * float(measured @ measured),
        )

    def bias(self, gain: FloatArray) -> FloatArray:
        """Return the bias that belongs to a gain, shape (3,)."""
        count = max(float(self.gram[3, 3]), 1.0)
        return np.asarray((self.moment[3] - gain @ self.gram[3, :3]) / count, dtype=np.float64)

    def residual_sum_of_squares(self, gain: FloatArray, bias_rad_s: FloatArray) -> float:
        """Return the sum of squared residuals of all axes."""
        parameters = np.column_stack([gain, bias_rad_s])
        cross = 2.0 * float(np.sum(parameters * self.moment.T))
        return self.square - cross + float(np.sum((parameters @ self.gram) * parameters))


def solve_shared_gain(sums: Sequence[LeastSquaresSums]) -> FloatArray:
    """Return the least-squares gain of recordings that have separate biases, shape (3, 3).

    Directions without excitation stay nominal.
    """
    gram = np.eye(3) * NOMINAL_WEIGHT
    moment = gram.copy()
    for centred in (sums_of_recording.without_bias() for sums_of_recording in sums):
        gram += centred.gram
        moment += centred.moment
    return np.asarray(np.linalg.solve(gram, moment).T, dtype=np.float64)


def correlation_lag(
    series: Series, measured_rad_s: FloatArray, rate_rad_s: FloatArray, used: BoolArray
) -> tuple[float, float]:
    """Return the lag of maximum correlation of measured and reference speed, and the correlation.

    Speeds (norms) do not depend on the mount of the sensor. Their means are removed.
    """
    first = slice(0, MAX_CORRELATED_BLOCKS)
    used_here, rate = used[first], rate_rad_s[first]
    if used_here.sum() < 10:
        return 0.0, -1.0
    reference_speed = np.where(used_here, row_norms(rate), 0.0)
    if np.std(reference_speed[used_here]) < MIN_SPEED_STD_RAD_S:
        return 0.0, -1.0
    bias = np.median(measured_rad_s[first][used_here], axis=0)
    measured_speed = np.where(used_here, row_norms(measured_rad_s[first] - bias), 0.0)
    measured_speed = np.where(used_here, measured_speed - measured_speed[used_here].mean(), 0.0)
    reference_speed = np.where(used_here, reference_speed - reference_speed[used_here].mean(), 0.0)
    size = 1 << (2 * measured_speed.size - 1).bit_length()
    correlation = np.fft.irfft(
        np.fft.rfft(measured_speed, size) * np.conj(np.fft.rfft(reference_speed, size)), size
    )
    period_s = series.period_s * series.samples_per_block
    max_lag_blocks = int(MAX_LAG_S / period_s)
    lags = np.arange(-max_lag_blocks, max_lag_blocks + 1)
    score = correlation[lags]
    best = int(np.argmax(score))
    quality = float(
        score[best] / (np.linalg.norm(measured_speed) * np.linalg.norm(reference_speed) + 1e-30)
    )
    return (float(lags[best]) + _parabola_vertex(score[best - 1 : best + 2])) * period_s, quality


def row_norms(rate: FloatArray) -> FloatArray:
    """Return the norm of each row, shape (n,)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", rate, rate)), dtype=np.float64)


def _parabola_vertex(neighbours: FloatArray) -> float:
    """Return the maximum of the parabola through three neighbours, relative to the middle one."""
    if neighbours.size < 3:
        return 0.0
    curvature = neighbours[0] - 2.0 * neighbours[1] + neighbours[2]
    return float(0.5 * (neighbours[0] - neighbours[2]) / curvature) if curvature < 0.0 else 0.0
