"""Temperature slopes: one slope per sensor, and the spread of the boards' slopes about it.

What to use when: `correct_temperature` for values corrected to each board's mean temperature, then
`slope_spread` for the standard deviation of the boards' slopes about their sensor's. A corrected
value still has the error of the board's own slope difference times the temperature offset of the
night. This is not a drift, and its size follows from the spread.

The slope of a sensor is estimated within boards, because each has its own level, and only if the
boards' temperatures span enough. It is the weighted median of the boards' slopes: a rig that
drifts while the season changes would bias a mean, and then all other boards would seem to drift.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.fleet.drift.population import MIN_BOARDS

IntArray = npt.NDArray[np.intp]

# A smaller span does not determine a slope. A straight line that many boards share needs much less
# than a temperature model of one board.
TEMPERATURE_SPAN_C = 2.0
CHI2_1_MEDIAN = 0.4549  # median of chi-square with one degree of freedom
_BISECTIONS = 50


@dataclass(frozen=True, slots=True, eq=False)
class BoardSlopes:
    """Temperature slopes of the boards of one sensor, one by one."""

    boards: IntArray  # (n,): indices of the boards
    slope_per_c: FloatArray  # (n,)
    variance: FloatArray  # (n,), from the calibrations alone
    scatter_variance_factor: FloatArray  # (n,): times the night-to-night variance, is added


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureCorrection:
    """Values after subtraction of their sensor's temperature slope."""

    value: FloatArray  # (nights, boards)
    temperature_offset_c: FloatArray  # (nights, boards): temperature minus the board's mean
    mean_temperature_c: FloatArray  # (boards,): that mean; NaN without a slope
    slope_per_c: FloatArray  # (boards,): of the board's sensor; NaN without a slope
    slope_variances: list[tuple[BoolArray, float]]  # boards of a sensor, variance of its slope
    board_slopes: list[BoardSlopes]  # of each of those sensors


def correct_temperature(
    value: FloatArray,
    variance: FloatArray,
    temperature_c: FloatArray | None,
    kind: IntArray | None = None,
) -> TemperatureCorrection:
    """Subtract the common temperature slope of each sensor.

    Args:
        value: nights by boards, NaN where a board was not measured.
        variance: of the calibrations, of the same shape.
        temperature_c: of the same shape.
        kind: number of each board's sensor, shape (boards,); None for one sensor. Sensors with
            fewer than `MIN_BOARDS` boards share one slope.
    """
    boards = value.shape[1]
    slopes, mean_temperature_c = np.full(boards, np.nan), np.full(boards, np.nan)
    temperature_offset_c = np.zeros_like(value)
    slope_variances: list[tuple[BoolArray, float]] = []
    board_slopes: list[BoardSlopes] = []
    if temperature_c is None:
        return TemperatureCorrection(
            value, temperature_offset_c, mean_temperature_c, slopes, slope_variances, board_slopes
        )
    is_measured = np.isfinite(value) & np.isfinite(temperature_c)
    weight = np.where(is_measured, 1.0 / variance, 0.0)
    offset_c, mean_c = _about_weighted_mean(temperature_c, weight)
    deviation, _ = _about_weighted_mean(value, weight)
    span, has_several = offset_c.max(axis=0) - offset_c.min(axis=0), is_measured.sum(axis=0) > 1
    for of_kind in _sensor_kinds(np.zeros(boards, np.intp) if kind is None else kind):
        usable = of_kind & has_several
        if not usable.any() or np.median(span[usable]) < TEMPERATURE_SPAN_C:
            continue
        fitted = _fit_board_slopes(
            offset_c[:, of_kind], deviation[:, of_kind], weight[:, of_kind], np.flatnonzero(of_kind)
        )
        slope = _weighted_median(fitted.slope_per_c, 1.0 / fitted.variance)
        # scatter of the boards' slopes relative to the uncertainty of the calibrations
        squares = (fitted.slope_per_c - slope) ** 2 / fitted.variance
        excess_ratio = float(np.median(squares)) / CHI2_1_MEDIAN
        # pi / 2: variance of a median of normal values, relative to that of their mean
        slope_variance = 0.5 * np.pi * excess_ratio / float((1.0 / fitted.variance).sum())
        slope_variances.append((of_kind, slope_variance))
        board_slopes.append(fitted)
        slopes[of_kind], mean_temperature_c[of_kind] = slope, mean_c[of_kind]
        temperature_offset_c[:, of_kind] = offset_c[:, of_kind]
    level = value - np.nan_to_num(slopes) * temperature_offset_c
    return TemperatureCorrection(
        level, temperature_offset_c, mean_temperature_c, slopes, slope_variances, board_slopes
    )


def slope_spread(corrected: TemperatureCorrection, scatter_variance: FloatArray) -> FloatArray:
    """Return the standard deviation of boards' slopes about their sensor's, (boards,), per degree.

    The uncertainty from calibrations and nights is subtracted. The median of the squares is used,
    because a board that drifts has no meaningful slope.
    """
    spread = np.zeros(corrected.value.shape[1])
    for (of_kind, _), fitted in zip(corrected.slope_variances, corrected.board_slopes, strict=True):
        squares = (fitted.slope_per_c - corrected.slope_per_c[fitted.boards]) ** 2
        noise = fitted.variance + scatter_variance[fitted.boards] * fitted.scatter_variance_factor
        spread[of_kind] = np.sqrt(_excess_variance(squares, noise))
    return spread


def _excess_variance(squares: FloatArray, noise: FloatArray) -> float:
    """Return the excess variance: a robust moment estimate.

    With it, the median of the standardised squares is the median of chi-square with one degree
    of freedom.
    """

    def too_small(variance: float) -> bool:
        return bool(np.median(squares / (variance + noise)) > CHI2_1_MEDIAN)

    if not too_small(0.0):
        return 0.0
    low, high = 0.0, float(squares.max()) / CHI2_1_MEDIAN
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_small(middle) else (low, middle)
    return high


def _sensor_kinds(kind: IntArray) -> list[BoolArray]:
    """Return the boards of each sensor that has enough of them, and all other boards together."""
    count = np.bincount(kind, minlength=1)
    large_kinds = [np.asarray(kind == number) for number in np.flatnonzero(count >= MIN_BOARDS)]
    in_small_kind: BoolArray = count[kind] < MIN_BOARDS
    return [*large_kinds, in_small_kind] if in_small_kind.any() else large_kinds


def _fit_board_slopes(
    offset_c: FloatArray, deviation: FloatArray, weight: FloatArray, boards: IntArray
) -> BoardSlopes:
    information = (weight * offset_c * offset_c).sum(axis=0)
    has_slope = information > 0.0
    slope_per_c = (weight * offset_c * deviation).sum(axis=0)[has_slope] / information[has_slope]
    scatter_sum = (weight * offset_c) ** 2
    return BoardSlopes(
        boards[has_slope],
        slope_per_c,
        1.0 / information[has_slope],
        scatter_sum.sum(axis=0)[has_slope] / information[has_slope] ** 2,
    )


def _weighted_median(values: FloatArray, weight: FloatArray) -> float:
    order = np.argsort(values)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(values[order[min(int(half), order.size - 1)]])


def _about_weighted_mean(table: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each board's values minus its weighted mean, 0 without weight; and the means."""
    values = np.where(weight > 0.0, table, 0.0)
    total = weight.sum(axis=0)
    mean = (weight * values).sum(axis=0) / np.maximum(total, 1e-300)
    deviation: FloatArray = np.where(weight > 0.0, values - mean, 0.0)
    return deviation, np.where(total > 0.0, mean, np.nan)
