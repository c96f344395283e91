"""Drift: what moves from night to night, first for rigs, lots and sites, then for boards.

What to use when: `Nights` for the history of one parameter, `chart` for what has moved at
its end. A rig that drifts shows in all its boards at once: so groups are asked first, and
what a group is found to have moved is taken off its boards before they are asked.

Each board has a baseline, the mean of its first nights. The chart is an exponentially
weighted mean of what comes after (EWMA; Roberts 1959) with lambda = 0.2, and its variance
is computed, not assumed: of the calibrations, of the ordinary scatter from night to night,
and of the baseline, which every night after it shares. So the first night after a baseline
and the hundredth have the same chance of a false alarm.

Boards are judged together by false-discovery rate (Benjamini and Hochberg 1995) over all
boards and parameters of a night: at a million boards the usual three sigma would raise
32 000 false alarms a night (reference: reliability.md section 5).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy import special

from gyrorig_solver.arrays import BoolArray, FloatArray

LAMBDA = 0.2  # reference: reliability.md section 5, drift charts
BASELINE_NIGHTS = 10
LEAST_BASELINE = 3
GROUP_ALPHA = 1e-4  # a night, over all groups and parameters of one kind of group
DISCOVERY_RATE = 0.01
# Less than this says nothing of a slope. A board's own cubic needs 10 degrees (reference:
# peers.md section 1); a line common to many boards needs no more than that it can be seen.
TEMPERATURE_SPAN_C = 2.0
MIDDLE_OF_SQUARES = 0.4549  # the median of chi-squared with one degree

IntArray = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Nights:
    """The history of one parameter: nights by boards, NaN where a board was not measured."""

    parameter: str
    value: FloatArray  # (nights, boards)
    variance: FloatArray  # (nights, boards), of the calibrations
    temperature_c: FloatArray | None = None  # (nights, boards)


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Where the boards of one parameter stand after the last night."""

    parameter: str
    scatter: float  # ordinary, from night to night, beside the calibrations' own
    slope_per_c: float | None  # taken off; None where temperatures say nothing of it
    slope_variance: float  # of that slope, whose error all boards share
    lever_c: FloatArray  # (boards,): how much warmer than in its baseline the EWMA is
    moved: FloatArray  # (boards,): the EWMA, in the parameter's unit
    variance: FloatArray  # (boards,), inf where there is no chart yet
    history: FloatArray  # (nights, boards): the EWMA of every night, NaN within baselines

    @property
    def z(self) -> FloatArray:
        """How far each board has moved, in standard deviations; 0 without a chart."""
        score: FloatArray = np.where(
            np.isfinite(self.variance), self.moved / np.sqrt(self.variance), 0.0
        )
        return score


@dataclass(frozen=True, slots=True)
class GroupMove:
    """A rig, lot or site, or the whole fleet, whose boards have moved together."""

    parameter: str
    kind: str
    group: str
    boards: int
    moved: float  # in the parameter's unit
    z: float
    p_value: float


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """One way to put boards together: the rigs, say."""

    kind: str
    names: Sequence[str]
    of: IntArray  # (boards,): which group each belongs to now, -1 for none

    @classmethod
    def by_name(cls, kind: str, names: Sequence[str]) -> Self:
        """Return the groups of boards by the name of each board's, "" for none."""
        groups = sorted({name for name in names if name})
        number = {name: at for at, name in enumerate(groups)}
        of = np.array([number.get(name, -1) for name in names], dtype=np.intp)
        return cls(kind, groups, of)


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """What the charts of all parameters show after the last night."""

    groups: list[GroupMove]  # the surest first
    drifting: BoolArray  # (boards, parameters), the groups' moves taken off
    z: FloatArray  # (boards, parameters)


def chart(nights: Nights) -> Chart:
    """Return the chart of one parameter.

    Boards with fewer than `LEAST_BASELINE` nights before the last have none.
    """
    value, warmth, slope, slope_variance = _without_temperature(nights)
    measured = np.isfinite(value)
    count = np.cumsum(measured, axis=0)
    base_length = np.clip(count[-1] - 1, 0, BASELINE_NIGHTS)
    in_base = measured & (count <= base_length)
    scatter2 = _scatter2(value, nights.variance, in_base)
    noise = np.where(measured, nights.variance + scatter2, np.inf)
    weight = np.where(in_base, 1.0 / noise, 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        base = (weight * np.where(measured, value, 0.0)).sum(axis=0) / total
        base_variance = 1.0 / total
        base_warmth = (weight * warmth).sum(axis=0) / total
    charted = base_length >= LEAST_BASELINE
    base_variance[~charted] = 0.0  # has no chart, and inf times 0 no value
    moved, lever = np.zeros(value.shape[1]), np.zeros(value.shape[1])
    own = np.zeros(value.shape[1])  # variance of the nights after the baseline
    share = np.zeros(value.shape[1])  # how much of the baseline's error is in it
    history = np.full(value.shape, np.nan)
    for night in range(len(value)):
        takes = measured[night] & ~in_base[night] & charted
        step = np.where(takes, LAMBDA, 0.0)
        left = np.where(takes, value[night] - base, 0.0)
        moved += step * (left - moved)
        lever += step * (np.where(takes, warmth[night] - base_warmth, 0.0) - lever)
        own = (1.0 - step) ** 2 * own + np.where(takes, LAMBDA**2 * noise[night], 0.0)
        share += step * (1.0 - share)
        history[night] = np.where(takes, moved, np.nan)
    variance = np.where(charted & (share > 0.0), own + share**2 * base_variance, np.inf)
    return Chart(
        parameter=nights.parameter,
        scatter=float(np.sqrt(scatter2)),
        slope_per_c=slope,
        slope_variance=slope_variance,
        lever_c=lever,
        moved=moved,
        variance=variance,
        history=history,
    )


def what_moved(charts: Sequence[Chart], groupings: Sequence[Grouping]) -> Moved:
    """Ask groups, then boards, over all parameters.

    Args:
        charts: one a parameter, of the same boards.
        groupings: the smaller groups first.
    """
    tests = len(charts) * sum(len(one.names) for one in groupings)
    told = [moved_groups(one, groupings, tests) for one in charts]
    left = [one for _, one in told]
    moves = sorted((move for found, _ in told for move in found), key=lambda one: -abs(one.z))
    return Moved(moves, discoveries(board_p_values(left)), np.stack([one.z for one in left], 1))


def moved_groups(
    one: Chart, groupings: Sequence[Grouping], tests: int, alpha: float = GROUP_ALPHA
) -> tuple[list[GroupMove], Chart]:
    """Return which groups' boards have moved together, and the chart without their moves.

    A group's move is the weighted mean of its boards' charts, and the square of its score
    is what that one number explains. So the group that explains most is taken first and its
    move taken off its boards, until no group explains enough: one drifting rig of eight
    moves the fleet's mean too, but explains more alone, and a whole site explains more than
    any of its rigs. A single odd board must not be taken for its rig: a group whose middle
    board has not moved with it is passed over.

    Args:
        one: the chart of one parameter.
        groupings: the smaller groups first: of two that explain the same, the first counts.
        tests: how many groups and parameters are asked on this night.
        alpha: chance of a false alarm in a night, over all of them.
    """
    moved = one.moved.copy()
    found: list[GroupMove] = []
    taken: set[tuple[str, str]] = set()
    limit = float(-special.ndtri(0.5 * alpha / max(tests, 1)))
    while True:
        best: GroupMove | None = None
        members: BoolArray | None = None
        for grouping in groupings:
            for move, here in _moves(one, grouping, moved, limit):
                better = best is None or abs(move.z) > abs(best.z) * (1.0 + 1e-9)
                if better and (move.kind, move.group) not in taken:
                    best, members = move, here
        if best is None or members is None:
            return found, replace(one, moved=moved)
        found.append(best)
        taken.add((best.kind, best.group))
        moved[members] -= best.moved


def _moves(
    one: Chart, grouping: Grouping, moved: FloatArray, limit: float
) -> Iterator[tuple[GroupMove, BoolArray]]:
    """Yield the groups that have moved by more than the limit, with their boards.

    What the common slope with temperature is wrong by does not average out over boards: it
    counts as much as the group's nights were warmer than its baseline.
    """
    variance = one.variance
    charted = np.isfinite(variance) & (grouping.of >= 0)
    weight = np.where(charted, 1.0 / variance, 0.0)
    group = np.where(charted, grouping.of, 0)
    count = len(grouping.names)
    boards = np.bincount(group, charted, count)
    total = np.bincount(group, weight, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean, lever = (
            np.bincount(group, weight * np.where(charted, each, 0.0), count) / total
            for each in (moved, one.lever_c)
        )
        z = mean / np.sqrt(1.0 / total + lever**2 * one.slope_variance)
    for index in np.flatnonzero((boards >= 2) & (np.abs(np.nan_to_num(z)) > limit)):
        here: BoolArray = charted & (grouping.of == index)
        middle = float(np.median(moved[here] / np.sqrt(variance[here]))) * np.sign(z[index])
        # the mean of n boards' scores is z / sqrt(n); their middle must be near it
        if middle > abs(z[index]) / np.sqrt(boards[index]) / 3.0:
            score = float(z[index])
            p = float(2.0 * special.ndtr(-abs(score)))
            move = GroupMove(
                one.parameter,
                grouping.kind,
                grouping.names[int(index)],
                int(boards[index]),
                float(mean[index]),
                score,
                p,
            )
            yield move, here


def discoveries(p_value: FloatArray, rate: float = DISCOVERY_RATE) -> BoolArray:
    """Return which of many tests to believe, so that of those believed `rate` are false.

    Args:
        p_value: any shape; NaN where nothing was tested.
        rate: of false ones among them, in the mean (Benjamini and Hochberg 1995).
    """
    tested = p_value[np.isfinite(p_value)]
    ordered = np.sort(tested)
    limits = rate * np.arange(1, len(ordered) + 1) / max(len(ordered), 1)
    below = np.flatnonzero(ordered <= limits)
    limit = ordered[below[-1]] if len(below) else -1.0
    believed: BoolArray = np.isfinite(p_value) & (p_value <= limit)
    return believed


def board_p_values(charts: Sequence[Chart]) -> FloatArray:
    """Return the two-sided tail of each board and parameter, shape (boards, parameters)."""
    columns = [
        np.where(np.isfinite(one.variance), 2.0 * special.ndtr(-np.abs(one.z)), np.nan)
        for one in charts
    ]
    return np.stack(columns, axis=1)


def _without_temperature(nights: Nights) -> tuple[FloatArray, FloatArray, float | None, float]:
    """Take off what the boards' common slope with temperature explains.

    The slope is that within boards (each has its own level), and only where the boards'
    own temperatures span enough: a slope from less is noise times a lever. It is the weighted
    median of the boards' own slopes: a rig that drifts while the season turns would pull a
    mean, and then all other boards would be called moved.

    Returns:
        The values, how warm each was, the slope and its variance.
    """
    value, temperature = nights.value, nights.temperature_c
    none = np.zeros_like(value)
    if temperature is None:
        return value, none, None, 0.0
    both = np.isfinite(value) & np.isfinite(temperature)
    if not both.any():
        return value, none, None, 0.0
    weight = np.where(both, 1.0 / nights.variance, 0.0)
    off, left = (_about_own_mean(one, weight) for one in (temperature, value))
    span = off.max(axis=0) - off.min(axis=0)
    several = both.sum(axis=0) > 1
    if not several.any() or np.median(span[several]) < TEMPERATURE_SPAN_C:
        return value, none, None, 0.0
    information = (weight * off * off).sum(axis=0)
    told = information > 0.0
    own = (weight * off * left).sum(axis=0)[told] / information[told]
    slope = _weighted_median(own, information[told])
    # how much more boards' own slopes scatter than calibrations alone would make them
    more = float(np.median((own - slope) ** 2 * information[told])) / MIDDLE_OF_SQUARES
    variance = 0.5 * np.pi * more / float(information.sum())  # a median's, of normal values
    return value - slope * off, off, slope, variance


def _weighted_median(values: FloatArray, weight: FloatArray) -> float:
    order = np.argsort(values)
    half = np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum())
    return float(values[order[min(int(half), order.size - 1)]])


def _about_own_mean(table: FloatArray, weight: FloatArray) -> FloatArray:
    """Return each board's values about its own weighted mean, 0 where they do not count."""
    counted = np.where(weight > 0.0, table, 0.0)
    mean = (weight * counted).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    about: FloatArray = np.where(weight > 0.0, counted - mean, 0.0)
    return about


def _scatter2(value: FloatArray, variance: FloatArray, in_base: BoolArray) -> float:
    """Return the ordinary variance from night to night beside the calibrations' own.

    From differences of neighbouring nights of a board, half of whose square is one night's
    variance: a drift hardly enters it. By the median of the squares, so that boards
    that step do not count.
    """
    squares: list[FloatArray] = []
    boards = value.shape[1]
    before = np.full(boards, np.nan)
    told_before = np.zeros(boards)
    for night in range(len(value)):
        here = in_base[night]
        pair = here & np.isfinite(before)
        step = value[night, pair] - before[pair]
        told = variance[night, pair] + told_before[pair]
        squares.append(0.5 * (step * step / MIDDLE_OF_SQUARES - told))
        before = np.where(here, value[night], before)
        told_before = np.where(here, variance[night], told_before)
    found = np.concatenate(squares)
    return max(float(np.median(found)), 0.0) if len(found) else 0.0
