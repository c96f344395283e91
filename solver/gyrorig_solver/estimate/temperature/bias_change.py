"""Changes of the bias over time during recordings at rest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.temperature.slow_noise import transform
from gyrorig_solver.numerics import chi2_upper_tail

SLOW_SHARE = 0.05  # of the frequencies: the share of slow changes
MIN_SLOW_ROWS = 3
FALSE_ALARM = 1e-4  # probability of a change that is only white noise
MEDIAN_CHI2 = 0.4549364  # of a squared standard normal value


@dataclass(frozen=True, slots=True, eq=False)
class BiasChange:
    """The change of the bias of each axis, beyond white noise."""

    std: FloatArray  # (3,), rad/s, over the recordings; zero if it is not significant
    p_value: FloatArray  # (3,)

    @property
    def is_significant(self) -> BoolArray:
        """Which axes show a change, shape (3,)."""
        return np.asarray(self.std > 0.0, dtype=np.bool_)


def measure_bias_change(biases: Sequence[FloatArray]) -> BiasChange:
    """Compare the slow part of the bias with the white noise.

    Args:
        biases: means over successive windows of each recording, shape (n, 3).
    """
    white_rows, slow_rows, variances = [], [], []
    for bias in biases:
        rows = transform(bias)
        slow = min(max(MIN_SLOW_ROWS, round(SLOW_SHARE * len(rows))), len(rows))
        white_rows.append(rows[len(rows) // 2 :] ** 2)
        slow_rows.append(rows[:slow] ** 2)
        variances.append(np.sum(rows**2, axis=0))
    count = sum(len(bias) for bias in biases)
    white = np.maximum(np.median(np.concatenate(white_rows), axis=0) / MEDIAN_CHI2, 1e-30)
    squares = np.concatenate(slow_rows)
    p_value = np.array(
        [
            chi2_upper_tail(float(np.sum(s) / w), len(s))
            for s, w in zip(squares.T, white, strict=True)
        ]
    )
    excess = np.maximum(np.sum(variances, axis=0) / count - white, 0.0)
    std = np.where(p_value < FALSE_ALARM / 3.0, np.sqrt(excess), 0.0)
    return BiasChange(np.asarray(std, np.float64), np.asarray(p_value, np.float64))
