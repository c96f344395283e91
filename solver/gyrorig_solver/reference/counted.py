"""The pan-tilt unit as the reference where its commands do not explain it: counts alone.

What to use when: a recording without commands, moved by another program or by hand, or
whose counts do not follow what it was told. Each stretch of motion is a smoothing spline
(see `stretches`); its coefficients are unknowns held by what the counts say, so that the
board's own evidence takes part and every uncertainty is carried. It costs precision: the
commands know a ramp to 1e-4, counts know it to a part of a step.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.sparse import csc_array

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.arrow import Arrow, solve_arrow
from gyrorig_solver.reference.evidence import STEP_VARIANCE
from gyrorig_solver.reference.kinematics import AxisTurn
from gyrorig_solver.reference.motion import Evaluated, LocalColumn
from gyrorig_solver.reference.polls import Polls
from gyrorig_solver.reference.stretches import PINNED, Stretch, find_spans, fit_stretch

LAG_STD_STEPS = 0.5 / np.sqrt(3.0)  # of the count behind the motion: within half a step
SLOW_STEPS_S = 100.0  # slower than this, the direction that the lag has is not quite known
LONGEST_SILENCE_S = 0.25  # between two counts on the way; a ramp fits into more
MOST_COEFFICIENTS = 10_000  # some six minutes of motion; a solve holds 0.1 MB for each


@dataclass(frozen=True, eq=False)
class CountedReference:
    """Pan and tilt over time. Unknowns: rests, inner coefficients, then the count's lag."""

    stretches: tuple[Stretch, ...]  # by axis, then by time
    standing: tuple[tuple[int, ...], tuple[int, ...]]  # counts at each axis' rests
    unknown: tuple[tuple[float, float, str], ...]  # begin, end, why
    rad_per_step: tuple[float, float]
    values: FloatArray  # of the unknowns now, steps; rests counted from `standing`
    centre: FloatArray  # what the counts say of them
    information: Arrow  # and how well
    common_std_s: float
    span_s: tuple[float, float]
    why: str

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        return f"{len(self.stretches)} stretches of motion as the pan-tilt unit counted them"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of this reference."""
        said = [f"motion unknown for a while: {why}" for _, _, why in self.unknown]
        return tuple(dict.fromkeys([f"{self.why}: the motion is taken from its counts", *said]))

    @property
    def pull(self) -> FloatArray:
        """Back to what is known."""
        return self.centre - self.values

    @property
    def differentiated(self) -> bool:
        """False: the spline is exact, its coefficients are unknowns."""
        return False

    def moved(self, step: FloatArray) -> Self:
        """Return the reference with its unknowns changed by `step`."""
        return replace(self, values=self.values + step)

    def angles_rad(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at times that do not decrease, shape (2, n)."""
        angle = np.empty((2, time_s.size))
        for axis in (0, 1):
            touching = self._touching(axis, time_s)
            angle[axis] = self._standing_steps(axis, touching.start)
            for k in range(touching.start, touching.stop):
                stretch, full = self._own[axis][k], self._full(axis, k)
                first, last = np.searchsorted(time_s, [stretch.begin_s, stretch.end_s])
                inside = time_s[first:last]
                angle[axis, first:last] = stretch.position_steps(inside, full)
                angle[axis, first:last] += self.values[-1] * _direction(stretch, full, inside)
                angle[axis, last:] = self._standing_steps(axis, k + 1)
        return np.asarray(angle * np.array(self.rad_per_step)[:, None], dtype=np.float64)

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> Evaluated:
        """Return mean stage rates between `edges_s` and, if asked, their derivatives."""
        rate, turn = AxisTurn.along(self.angles_rad(edges_s), edges_s, self.rad_per_step)
        rate[~self._known(edges_s)] = np.nan
        if not derivatives:
            return Evaluated(rate, (), np.zeros((0, len(rate), 3)))
        local: list[LocalColumn] = []
        lag = np.zeros((1, len(rate), 3))
        for axis in (0, 1):
            touching = self._touching(axis, edges_s)
            local += self._rest_columns(axis, touching, edges_s, turn)
            change = np.zeros(edges_s.size)
            for k in range(touching.start, touching.stop):
                stretch, full = self._own[axis][k], self._full(axis, k)
                local += _inner_columns(stretch, self._inner[axis][k], edges_s, turn)
                first, last = np.searchsorted(edges_s, [stretch.begin_s, stretch.end_s])
                change[first:last] = _direction(stretch, full, edges_s[first:last])
            lag[0] += turn.rate(axis, change, slice(0, len(rate)))
        return Evaluated(rate, tuple(sorted(local, key=lambda column: column.unknown)), lag)

    @cached_property
    def _own(self) -> tuple[list[Stretch], list[Stretch]]:
        """Each axis' stretches."""
        pan, tilt = ([s for s in self.stretches if s.axis == axis] for axis in (0, 1))
        return pan, tilt

    @cached_property
    def _inner(self) -> tuple[list[int], list[int]]:
        """The first inner coefficient of each axis' stretches, among the unknowns."""
        count = np.array([s.inner for own in self._own for s in own], dtype=np.int64)
        first = self._rest(1, len(self.standing[1])) + np.cumsum(count) - count
        pan = len(self._own[0])
        return first[:pan].tolist(), first[pan:].tolist()

    def _rest(self, axis: int, k: int) -> int:
        return k + (len(self.standing[0]) if axis else 0)

    def _standing_steps(self, axis: int, k: int) -> float:
        return self.standing[axis][k] + float(self.values[self._rest(axis, k)])

    def _full(self, axis: int, k: int) -> FloatArray:
        """Return all coefficients of an axis' k-th stretch."""
        stretch, first, rest = self._own[axis][k], self._inner[axis][k], self._rest(axis, k)
        ends = (float(self.values[rest]), float(self.values[rest + 1]))
        return stretch.full(ends, self.values[first : first + stretch.inner])

    def _touching(self, axis: int, time_s: FloatArray) -> range:
        """Return which stretches of an axis lie between the first and the last time."""
        if time_s.size == 0:
            return range(0)
        own = self._own[axis]
        first = bisect_right(own, float(time_s[0]), key=lambda stretch: stretch.end_s)
        last = bisect_right(own, float(time_s[-1]), key=lambda stretch: stretch.begin_s)
        return range(first, max(first, last))

    def _rest_columns(
        self, axis: int, touching: range, edges_s: FloatArray, turn: AxisTurn
    ) -> Iterator[LocalColumn]:
        own, size = self._own[axis], edges_s.size
        for k in range(touching.start, touching.stop + 1):
            arrival = own[k - 1] if k - 1 in touching else None
            departure = own[k] if k in touching else None
            if axis == 0 and arrival is None and departure is None:
                continue  # a pan that stands changes no rate
            first, last = 0, size
            if arrival or axis == 0:
                begin_s = (arrival or own[k]).begin_s
                first = max(0, int(np.searchsorted(edges_s, begin_s)) - 1)
            if departure or axis == 0:
                end_s = (departure or own[k - 1]).end_s
                last = min(size, int(np.searchsorted(edges_s, end_s)) + 1)
            inside = edges_s[first:last]
            share = np.ones(inside.size)
            if arrival:
                share -= 1.0 - _held(arrival, inside, arrival.intervals)
            if departure:
                share -= 1.0 - _held(departure, inside, 0)
            at = slice(first, max(first, last - 1))
            yield LocalColumn(self._rest(axis, k), first, turn.rate(axis, share, at))

    def _known(self, edges_s: FloatArray) -> BoolArray:
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.unknown:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)


def counted_reference(
    polls: Polls, rad_per_step: tuple[float, float], why: str
) -> CountedReference:
    """Return the motion that the counts alone tell of.

    Args:
        polls: of one recording, in the order of time.
        rad_per_step: pan and tilt, with the sign of the unit.
        why: what is wrong with the commands, in words.
    """
    width = polls.hi_s - polls.lo_s
    least = float(np.percentile(width, 1.0))
    extra = np.clip(width - least, 0.0, None)
    at_s, spread_s = polls.lo_s + (least + extra) / 2.0, extra / np.sqrt(12.0)
    limit = (float(polls.lo_s[0]), float(polls.hi_s[-1]))
    stretches: list[Stretch] = []
    standing: list[tuple[int, ...]] = []
    unknown: list[tuple[float, float, str]] = []
    room = MOST_COEFFICIENTS
    for axis in (0, 1):
        use = polls.valid[:, axis]
        time_s, steps, spread = at_s[use], polls.steps[use, axis], spread_s[use]
        spans = find_spans(time_s, steps)
        counts = [round(float(steps[0]))]
        for begin_s, end_s in spans:
            inside = (time_s >= begin_s) & (time_s <= end_s)
            after = round(float(steps[np.searchsorted(time_s, end_s, side="right") - 1]))
            if begin_s < limit[0] or end_s > limit[1]:
                unknown.append((begin_s, end_s, "the recording begins or ends on the way"))
            longest_s = float(np.max(np.diff(time_s[inside]), initial=0.0))
            if longest_s > LONGEST_SILENCE_S:
                unknown.append((begin_s, end_s, "the unit did not answer on its way"))
            stretch = fit_stretch(
                axis,
                (begin_s, end_s),
                (counts[-1], after),
                time_s[inside],
                steps[inside],
                spread[inside],
            )
            if stretch.inner > room:
                words = "the counted motion is longer than can be fitted without commands"
                unknown.append((begin_s, np.inf, words))
                break
            room -= stretch.inner
            stretches.append(stretch)
            counts.append(after)
        standing.append(tuple(counts))
    centre, information = _joined(stretches, standing)
    constant_s = least + polls.constant_width_s + float(np.median(extra))
    return CountedReference(
        stretches=tuple(stretches),
        standing=(standing[0], standing[1]),
        unknown=tuple(unknown),
        rad_per_step=rad_per_step,
        values=centre.copy(),
        centre=centre,
        information=information,
        common_std_s=constant_s / float(np.sqrt(12.0)),
        span_s=limit,
        why=why,
    )


def _joined(stretches: list[Stretch], standing: list[tuple[int, ...]]) -> tuple[FloatArray, Arrow]:
    """Return the likeliest unknowns and their information, all stretches together."""
    rests = len(standing[0]) + len(standing[1])
    size = rests + sum(stretch.inner for stretch in stretches)
    pull = np.zeros(size + 1)
    rows, columns = [np.arange(rests)], [np.arange(rests)]
    values = [np.full(rests, 1.0 / STEP_VARIANCE)]
    inner, rest = rests, {0: 0, 1: len(standing[0])}
    for stretch in stretches:
        before = rest[stretch.axis]
        index = np.concatenate([[before], inner + np.arange(stretch.inner), [before + 1]])
        off, at = np.nonzero(stretch.information)
        value, twice = stretch.information[off, at], off > 0
        rows += [index[at + off], index[at[twice]]]
        columns += [index[at], index[at[twice] + off[twice]]]
        values += [value, value[twice]]
        pull[index] += stretch.pull
        inner += stretch.inner
        rest[stretch.axis] += 1
    where = np.concatenate(rows), np.concatenate(columns)
    information = Arrow(
        csc_array((np.concatenate(values), where), shape=(size, size)),
        np.zeros((size, 1)),
        np.full((1, 1), LAG_STD_STEPS**-2.0),
    )
    return solve_arrow(information, pull), information


def _inner_columns(
    stretch: Stretch, unknown: int, edges_s: FloatArray, turn: AxisTurn
) -> Iterator[LocalColumn]:
    """Return the columns by a stretch's inner coefficients that act between the edges."""
    begin, end = np.searchsorted(edges_s, [stretch.begin_s, stretch.end_s], side="right")
    values, first = stretch.basis(edges_s[begin:end])
    # The k-th function lives on four intervals: where the first one is k - 3 to k.
    functions = np.arange(PINNED, PINNED + stretch.inner)
    low = np.searchsorted(first, functions - 3)
    high = np.searchsorted(first, functions, side="right")
    for n in np.flatnonzero(high > low).tolist():
        inside = slice(int(low[n]), int(high[n]))
        one = np.arange(inside.start, inside.stop)
        before, after = int(begin + inside.start > 0), int(begin + inside.stop < edges_s.size)
        change = np.zeros(before + one.size + after)
        change[before : before + one.size] = values[one, functions[n] - first[inside]]
        at = slice(begin + inside.start - before, begin + inside.stop + after - 1)
        yield LocalColumn(unknown + n, int(at.start), turn.rate(stretch.axis, change, at))


def _one(stretch: Stretch, time_s: FloatArray, k: int) -> FloatArray:
    """Return the k-th basis function at times, zero outside its stretch."""
    values, first = stretch.basis(time_s)
    column = k - first
    inside = (column >= 0) & (column < 4)
    inside &= (time_s >= stretch.begin_s) & (time_s <= stretch.end_s)
    return np.where(inside, values[np.arange(time_s.size), np.clip(column, 0, 3)], 0.0)


def _held(stretch: Stretch, time_s: FloatArray, first: int) -> FloatArray:
    """Return the sum of the three functions of the rest at one end, 1 beyond that end."""
    clipped = np.clip(time_s, stretch.begin_s, stretch.end_s)
    total = np.zeros(time_s.size)
    for k in range(first, first + PINNED):
        total += _one(stretch, clipped, k)
    return total


def _direction(stretch: Stretch, full: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return the sign of the speed, smoothed where it is slow."""
    step_s = 1e-3
    later = stretch.position_steps(time_s + step_s, full)
    speed = (later - stretch.position_steps(time_s - step_s, full)) / (2.0 * step_s)
    return np.asarray(speed / np.hypot(speed, SLOW_STEPS_S), dtype=np.float64)
