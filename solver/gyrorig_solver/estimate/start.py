"""Where a fit begins: the lag by correlation, gain and bias by plain least squares.

What to use when: `correlation_lag` for one series; `Rough` for the sums over a recording and
`shared_gain` to put recordings together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.series import Series

SEARCH_S = 0.3  # the lag is looked for within this range first
WEAK = 1e-4  # weight of the nominal gain in a start, (rad/s)^2 times samples
CORRELATED = 1 << 17  # blocks: minutes tell the lag as well as hours
STILL_RAD_S = 0.003  # speeds that vary by less tell no lag


@dataclass(frozen=True, slots=True, eq=False)
class Rough:
    """Sums of plain least squares over one recording: (rate, 1) against measured."""

    gram: FloatArray  # (4, 4)
    moment: FloatArray  # (4, 3)
    square: float  # sum of what was measured, squared

    def centred(self) -> "Rough":
        """Return the same with the recording's own bias taken out, (3, 3) each."""
        count = max(float(self.gram[3, 3]), 1.0)
        mean, measured = self.gram[3, :3] / count, self.moment[3] / count
        return Rough(
            self.gram[:3, :3] - count * np.outer(mean, mean),
            self.moment[:3] - count * np.outer(mean, measured),
            self.square - count * float(measured @ measured),
        )

    def bias(self, gain: FloatArray) -> FloatArray:
        """Return the bias that goes with a gain, shape (3,)."""
        count = max(float(self.gram[3, 3]), 1.0)
        return np.asarray((self.moment[3] - gain @ self.gram[3, :3]) / count, dtype=np.float64)

    def misfit(self, gain: FloatArray, bias_rad_s: FloatArray) -> float:
        """Return the sum of squared residuals of all axes."""
        both = np.column_stack([gain, bias_rad_s])
        cross = 2.0 * float(np.sum(both * self.moment.T))
        return self.square - cross + float(np.sum((both @ self.gram) * both))


def shared_gain(sums: Sequence[Rough]) -> FloatArray:
    """Return the gain that fits recordings best, each with its own bias, shape (3, 3).

    What nothing excites stays nominal.
    """
    gram = np.eye(3) * WEAK
    moment = gram.copy()
    for one in (rough.centred() for rough in sums):
        gram += one.gram
        moment += one.moment
    return np.asarray(np.linalg.solve(gram, moment).T, dtype=np.float64)


def correlation_lag(
    series: Series, measured_rad_s: FloatArray, rate_rad_s: FloatArray, used: BoolArray
) -> tuple[float, float]:
    """Return the lag at which measured and reference speeds agree best, and how well.

    Speeds (norms) do not care how the sensor is mounted. The mean is taken out of both.
    """
    first = slice(0, CORRELATED)
    use, rate = used[first], rate_rad_s[first]
    if use.sum() < 10:
        return 0.0, -1.0
    turning = np.where(use, speeds(rate), 0.0)
    if np.std(turning[use]) < STILL_RAD_S:
        return 0.0, -1.0
    bias = np.median(measured_rad_s[first][use], axis=0)
    measured = np.where(use, speeds(measured_rad_s[first] - bias), 0.0)
    measured = np.where(use, measured - measured[use].mean(), 0.0)
    turning = np.where(use, turning - turning[use].mean(), 0.0)
    size = 1 << (2 * measured.size - 1).bit_length()
    product = np.fft.irfft(np.fft.rfft(measured, size) * np.conj(np.fft.rfft(turning, size)), size)
    period_s = series.period_s * series.block
    reach = int(SEARCH_S / period_s)
    lags = np.arange(-reach, reach + 1)
    score = product[lags]
    best = int(np.argmax(score))
    quality = float(score[best] / (np.linalg.norm(measured) * np.linalg.norm(turning) + 1e-30))
    return (float(lags[best]) + _vertex(score[best - 1 : best + 2])) * period_s, quality


def speeds(rate: FloatArray) -> FloatArray:
    """Return the norm of each row, shape (n,)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", rate, rate)), dtype=np.float64)


def _vertex(three: FloatArray) -> float:
    """Return where the parabola through three neighbours is highest, from the middle one."""
    if three.size < 3:
        return 0.0
    bend = three[0] - 2.0 * three[1] + three[2]
    return float(0.5 * (three[0] - three[2]) / bend) if bend < 0.0 else 0.0
