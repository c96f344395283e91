"""What boards show with temperature: a slope common to a kind, and what their own differ by.

What to use when: `levelled` for values brought to each board's mean temperature, then
`slope_spread` for how much boards' own slopes differ from their kind's. A corrected value is
still off by the board's own difference times how much warmer the night was: that is no drift,
and it is as large as the spread says.

The slope of a kind is that within boards (each has its own level), and only where the boards'
own temperatures span enough: a slope from less is noise times a lever. It is the weighted
median of the boards' own slopes: a rig that drifts while the season turns would pull a mean,
and then all other boards would be called moved.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.fleet.population import LEAST_BOARDS

IntArray = npt.NDArray[np.intp]

# Less than this says nothing of a slope. A board's own cubic needs 10 degrees (reference:
# peers.md section 1); a line common to many boards needs no more than that it can be seen.
TEMPERATURE_SPAN_C = 2.0
MIDDLE_OF_SQUARES = 0.4549  # the median of chi-squared with one degree
_HALVINGS = 50


@dataclass(frozen=True, slots=True, eq=False)
class OwnSlopes:
    """The slopes that boards of one kind show each by itself."""

    boards: IntArray  # (n,): which boards
    slope_per_c: FloatArray  # (n,)
    variance: FloatArray  # (n,), by the calibrations alone
    per_scatter: FloatArray  # (n,): what a variance from night to night adds, times that


@dataclass(frozen=True, slots=True, eq=False)
class Levelled:
    """Values with their kind's slope taken off."""

    value: FloatArray  # (nights, boards)
    warmth_c: FloatArray  # (nights, boards): how much warmer than the board's mean
    warm_c: FloatArray  # (boards,): that mean; NaN where no slope is known
    slope_per_c: FloatArray  # (boards,): of the board's kind, NaN where none is known
    kinds: list[tuple[BoolArray, float]]  # boards with one slope, and its variance
    own: list[OwnSlopes]  # of each of those kinds


def levelled(
    value: FloatArray,
    variance: FloatArray,
    temperature_c: FloatArray | None,
    kind: IntArray | None = None,
) -> Levelled:
    """Take off what each kind's common slope with temperature explains.

    Args:
        value: nights by boards, NaN where a board was not measured.
        variance: of the calibrations, of the same shape.
        temperature_c: of the same shape.
        kind: which kind of sensor each board is, shape (boards,); None for one kind. Kinds of
            fewer than `LEAST_BOARDS` have one slope together: few say nothing of a spread.
    """
    boards = value.shape[1]
    slopes, warm_c = np.full(boards, np.nan), np.full(boards, np.nan)
    warmth_c = np.zeros_like(value)
    kinds: list[tuple[BoolArray, float]] = []
    slopes_of_boards: list[OwnSlopes] = []
    if temperature_c is None:
        return Levelled(value, warmth_c, warm_c, slopes, kinds, slopes_of_boards)
    both = np.isfinite(value) & np.isfinite(temperature_c)
    weight = np.where(both, 1.0 / variance, 0.0)
    off, warm = _about_own_mean(temperature_c, weight)
    left, _ = _about_own_mean(value, weight)
    span, several = off.max(axis=0) - off.min(axis=0), both.sum(axis=0) > 1
    for here in _kinds(np.zeros(boards, np.intp) if kind is None else kind):
        if not (here & several).any() or np.median(span[here & several]) < TEMPERATURE_SPAN_C:
            continue
        own = _own_slopes(off[:, here], left[:, here], weight[:, here], np.flatnonzero(here))
        slope = _weighted_median(own.slope_per_c, 1.0 / own.variance)
        # how much more boards' own slopes scatter than calibrations alone would make them
        squares = (own.slope_per_c - slope) ** 2 / own.variance
        more = float(np.median(squares)) / MIDDLE_OF_SQUARES
        # a median's, of normal values
        kinds.append((here, 0.5 * np.pi * more / float((1.0 / own.variance).sum())))
        slopes_of_boards.append(own)
        slopes[here], warm_c[here] = slope, warm[here]
        warmth_c[:, here] = off[:, here]
    level = value - np.nan_to_num(slopes) * warmth_c
    return Levelled(level, warmth_c, warm_c, slopes, kinds, slopes_of_boards)


def slope_spread(found: Levelled, scatter2: float) -> FloatArray:
    """Return how much boards' own slopes differ from their kind's, shape (boards,), per degree.

    One standard deviation for each kind, what calibrations and nights make of it taken off. By
    the median of the squares: a board that drifts has no slope of its own.

    Args:
        found: by `levelled`.
        scatter2: ordinary variance from night to night beside the calibrations' own.
    """
    spread = np.zeros(found.value.shape[1])
    for (here, _), own in zip(found.kinds, found.own, strict=True):
        squares = (own.slope_per_c - found.slope_per_c[own.boards]) ** 2
        noise = own.variance + scatter2 * own.per_scatter
        spread[here] = np.sqrt(_excess(squares, noise))
    return spread


def _excess(squares: FloatArray, noise: FloatArray) -> float:
    """Return the variance that makes the median of squares over it and noise what it should be."""

    def too_small(variance: float) -> bool:
        return bool(np.median(squares / (variance + noise)) > MIDDLE_OF_SQUARES)

    if not too_small(0.0):
        return 0.0
    low, high = 0.0, float(squares.max()) / MIDDLE_OF_SQUARES
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if too_small(middle) else (low, middle)
    return high


def _kinds(kind: IntArray) -> list[BoolArray]:
    """Return the boards of each kind with enough of them, and all others together."""
    count = np.bincount(kind, minlength=1)
    many = [np.asarray(kind == at) for at in np.flatnonzero(count >= LEAST_BOARDS)]
    few: BoolArray = count[kind] < LEAST_BOARDS
    return [*many, few] if few.any() else many


def _own_slopes(
    off: FloatArray, left: FloatArray, weight: FloatArray, boards: IntArray
) -> OwnSlopes:
    information = (weight * off * off).sum(axis=0)
    told = information > 0.0
    own = (weight * off * left).sum(axis=0)[told] / information[told]
    per_scatter = (weight * off) ** 2
    return OwnSlopes(
        boards[told],
        own,
        1.0 / information[told],
        per_scatter.sum(axis=0)[told] / information[told] ** 2,
    )


def _weighted_median(values: FloatArray, weight: FloatArray) -> float:
    order = np.argsort(values)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(values[order[min(int(half), order.size - 1)]])


def _about_own_mean(table: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each board's values about its own weighted mean, 0 where they do not count."""
    counted = np.where(weight > 0.0, table, 0.0)
    total = weight.sum(axis=0)
    mean = (weight * counted).sum(axis=0) / np.maximum(total, 1e-300)
    about: FloatArray = np.where(weight > 0.0, counted - mean, 0.0)
    return about, np.where(total > 0.0, mean, np.nan)
