"""Scatter from night to night: its variance per sensor, and how well it is known.

What to use when: `estimate_night_scatter` for the scatter of every board. Limits in standard
deviations are wider by `numerics.student_factor`, because the scatter is estimated.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.fleet.drift.temperature_slopes import CHI2_1_MEDIAN

IntArray = npt.NDArray[np.intp]

MIN_NIGHT_PAIRS = 8  # of a sensor; fewer determine no scatter
# Degrees of freedom per pair of nights of the median of the squared differences. With it, Student's
# t has the tails of a deviation divided by this estimate, simulated for 4 to 144 pairs of 1 to 16
# boards, at probabilities from 1e-3 to 1e-5.
_DEGREES_PER_PAIR = 0.35


@dataclass(frozen=True, slots=True, eq=False)
class NightScatter:
    """Scatter from night to night, in addition to the uncertainty of the calibrations."""

    variance: FloatArray  # (boards,), of each board's sensor
    degrees_of_freedom: FloatArray  # (boards,), of that estimate; 0 with too few pairs of nights


def estimate_night_scatter(
    value: FloatArray, variance: FloatArray, in_baseline: BoolArray, kind: IntArray
) -> NightScatter:
    """Return the scatter of each board's sensor.

    It is estimated from differences of consecutive nights of a board, half of whose square is
    the variance of one night; a drift hardly affects them. The median of the squares excludes
    boards with steps.

    Args:
        value: nights by boards, NaN where a board was not measured.
        variance: of the calibrations, of the same shape.
        in_baseline: which nights are used, of the same shape.
        kind: number of each board's sensor, shape (boards,).
    """
    squares, board = _squared_differences(value, variance, in_baseline)
    scatter_variance, degrees_of_freedom = np.zeros(kind.shape), np.zeros(kind.shape)
    for number in np.unique(kind):
        of_kind = kind == number
        squares_of_kind = squares[of_kind[board]]
        if squares_of_kind.size < MIN_NIGHT_PAIRS:
            continue
        scatter_variance[of_kind] = max(float(np.median(squares_of_kind)), 0.0)
        degrees_of_freedom[of_kind] = _DEGREES_PER_PAIR * squares_of_kind.size
    return NightScatter(scatter_variance, degrees_of_freedom)


def _squared_differences(
    value: FloatArray, variance: FloatArray, in_baseline: BoolArray
) -> tuple[FloatArray, IntArray]:
    """Return an estimate of the scatter's variance from each pair of nights, and its board."""
    squares: list[FloatArray] = []
    pair_boards: list[IntArray] = []
    boards = value.shape[1]
    previous, previous_variance = np.full(boards, np.nan), np.zeros(boards)
    for night in range(len(value)):
        is_measured = in_baseline[night]
        pair = np.flatnonzero(is_measured & np.isfinite(previous))
        step = value[night, pair] - previous[pair]
        calibration_variance = variance[night, pair] + previous_variance[pair]
        squares.append(0.5 * (step * step / CHI2_1_MEDIAN - calibration_variance))
        pair_boards.append(pair)
        previous = np.where(is_measured, value[night], previous)
        previous_variance = np.where(is_measured, variance[night], previous_variance)
    return np.concatenate(squares), np.concatenate(pair_boards)
