"""Drift: what moves from night to night, first for rigs, lots and sites, then for boards.

What to use when: `Nights` for the history of one parameter, `chart` for what has moved at
its end. A rig that drifts shows in all its boards at once: so groups are asked first, and
what a group is found to have moved is taken off its boards before they are asked.

Each board has a baseline, the mean of its first nights. The chart is an exponentially
weighted mean of what comes after (EWMA; Roberts 1959) with lambda = 0.2, and its variance
is computed, not assumed: of the calibrations, of the ordinary scatter from night to night,
of the baseline, which every night after it shares, and of what the board's own slope with
temperature differs from its kind's (`temperature`). So the first night after a baseline and
the hundredth have the same chance of a false alarm, in any season.

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
from gyrorig_solver.fleet.temperature import MIDDLE_OF_SQUARES, levelled, slope_spread

LAMBDA = 0.2  # reference: reliability.md section 5, drift charts
BASELINE_NIGHTS = 10
LEAST_BASELINE = 3
GROUP_ALPHA = 1e-4  # a night, over all groups and parameters of one kind of group
DISCOVERY_RATE = 0.01
HISTORY_NIGHTS = 60  # the latest, which are drawn: all nights of many boards take gigabytes

IntArray = npt.NDArray[np.intp]
HistoryArray = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Nights:
    """The history of one parameter: nights by boards, NaN where a board was not measured."""

    parameter: str
    value: FloatArray  # (nights, boards)
    variance: FloatArray  # (nights, boards), of the calibrations
    temperature_c: FloatArray | None = None  # (nights, boards)
    kind: IntArray | None = None  # (boards,): which kind of sensor each is; None: all of one


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """Where the boards of one parameter stand after the last night."""

    parameter: str
    scatter: float  # ordinary, from night to night, beside the calibrations' own
    slope_per_c: FloatArray  # (boards,): of its kind, taken off; NaN where nothing is known of it
    slope_spread: FloatArray  # (boards,): how much boards' own slopes differ from it
    slopes: list[tuple[BoolArray, float]]  # boards of a kind; variance of its slope, all share it
    lever_c: FloatArray  # (boards,): how much warmer than in its baseline the EWMA is
    moved: FloatArray  # (boards,): the EWMA, in the parameter's unit
    variance: FloatArray  # (boards,), inf where there is no chart yet
    base: FloatArray  # (boards,): the mean of the first nights, at `warm_c`
    warm_c: FloatArray  # (boards,): to which temperature values are brought, NaN for none
    # Of the last nights, (at most HISTORY_NIGHTS, boards), float32, NaN within baselines:
    history: HistoryArray  # the EWMA
    history_std: HistoryArray  # its standard deviation
    history_lever_c: HistoryArray  # `lever_c` of that night

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
    level = levelled(nights.value, nights.variance, nights.temperature_c, nights.kind)
    value, warmth = level.value, level.warmth_c
    measured = np.isfinite(value)
    count = np.cumsum(measured, axis=0)
    base_length = np.clip(count[-1] - 1, 0, BASELINE_NIGHTS)
    in_base = measured & (count <= base_length)
    scatter2 = _scatter2(value, nights.variance, in_base)
    noise = np.where(measured, nights.variance + scatter2, np.inf)
    spread = slope_spread(level, scatter2)
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
    first = max(len(value) - HISTORY_NIGHTS, 0)
    history = np.full((3, len(value) - first, value.shape[1]), np.nan, dtype=np.float32)
    for night in range(len(value)):
        takes = measured[night] & ~in_base[night] & charted
        step = np.where(takes, LAMBDA, 0.0)
        left = np.where(takes, value[night] - base, 0.0)
        moved += step * (left - moved)
        lever += step * (np.where(takes, warmth[night] - base_warmth, 0.0) - lever)
        own = (1.0 - step) ** 2 * own + np.where(takes, LAMBDA**2 * noise[night], 0.0)
        share += step * (1.0 - share)
        if night >= first:
            here = (moved, np.sqrt(_variance(own, share, base_variance, lever, spread)), lever)
            history[:, night - first] = np.where(takes, here, np.nan)
    total = _variance(own, share, base_variance, lever, spread)
    variance = np.where(charted & (share > 0.0), total, np.inf)
    return Chart(
        parameter=nights.parameter,
        scatter=float(np.sqrt(scatter2)),
        slope_per_c=level.slope_per_c,
        slope_spread=spread,
        slopes=level.kinds,
        lever_c=lever,
        moved=moved,
        variance=variance,
        base=base,
        warm_c=level.warm_c,
        history=history[0],
        history_std=history[1],
        history_lever_c=history[2],
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

    What a kind's slope with temperature is wrong by does not average out over its boards: it
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
        mean = np.bincount(group, weight * np.where(charted, moved, 0.0), count) / total
        common = np.zeros(count)
        for here, slope_variance in one.slopes:
            warmer = np.where(charted & here, weight * one.lever_c, 0.0)
            common += (np.bincount(group, warmer, count) / total) ** 2 * slope_variance
        z = mean / np.sqrt(1.0 / total + common)
    for index in np.flatnonzero((boards >= 2) & (np.abs(np.nan_to_num(z)) > limit)):
        members: BoolArray = charted & (grouping.of == index)
        middle = float(np.median(moved[members] / np.sqrt(variance[members]))) * np.sign(z[index])
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
            yield move, members


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


def _variance(
    own: FloatArray, share: FloatArray, base: FloatArray, lever_c: FloatArray, spread: FloatArray
) -> FloatArray:
    """Return the variance of an EWMA: of its nights, its baseline and the board's own slope."""
    return own + share**2 * base + (lever_c * spread) ** 2


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
