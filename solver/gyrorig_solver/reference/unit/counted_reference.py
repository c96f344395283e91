"""Reference motion of a pan-tilt unit from its counts alone.

What to use when: a recording has no commands, the unit was moved by another program or by hand,
or its counts do not follow the commands. Each segment of motion is a smoothing spline
(`spline_segment`). Its coefficients are unknowns with a prior from the counts, therefore the
samples of the board contribute and all uncertainties are included. The precision is lower: from
commands a ramp is known to 1e-4, from counts to a part of a step.
"""

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.sparse import csc_array

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.numerics import ArrowheadMatrix, solve_arrowhead
from gyrorig_solver.reference.reference_motion import EvaluatedMotion, LocalDerivative
from gyrorig_solver.reference.unit.move_fit import UnitPolls
from gyrorig_solver.reference.unit.poll_likelihood import STEP_VARIANCE
from gyrorig_solver.reference.unit.spline_segment import (
    REST_COEFFICIENTS,
    SplineSegment,
    find_moving_spans,
    fit_segment,
    interval_count,
    unknown_segment,
)
from gyrorig_solver.reference.unit.stage_kinematics import StageRateJacobian

LAG_PRIOR_STD_STEPS = 0.5 / np.sqrt(3.0)  # of the count behind the motion, within half a step
SLOW_SPEED_STEPS_S = 100.0  # below this speed the direction of the lag is uncertain
MAX_POLL_GAP_S = 0.25  # between two counts in motion; a longer gap can contain a ramp
# The rates in the span of a longer gap are not used, so its spline needs no knots every 20 ms.
MAX_SPLINE_GAP_S = 2.0
MAX_COEFFICIENTS = 10_000  # about six minutes of motion; a solve needs 0.1 MB for each


@dataclass(frozen=True, eq=False)
class CountedReference:
    """Pan and tilt over time. Unknowns: rests, inner coefficients, then the lag of the count."""

    segments: tuple[SplineSegment, ...]  # by axis, then by time
    rest_counts: tuple[tuple[int, ...], tuple[int, ...]]  # counts at the rests of each axis
    unknown_spans: tuple[tuple[float, float, str], ...]  # begin, end, reason
    rad_per_step: tuple[float, float]
    values: FloatArray  # current values of the unknowns, steps; rests relative to `rest_counts`
    prior_mean: FloatArray  # from the counts
    information: ArrowheadMatrix  # of that prior
    common_shift_std_s: float
    span_s: tuple[float, float]
    reason: str

    @property
    def description(self) -> str:
        """One sentence on the reference."""
        return f"{len(self.segments)} segments of motion from the counts of the pan-tilt unit"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on this reference."""
        messages = [
            f"the unit's motion is unknown for some time, because {reason}"
            for _, _, reason in self.unknown_spans
        ]
        return tuple(
            dict.fromkeys(
                [
                    f"{self.reason}, so the solver takes the motion from the position counts",
                    *messages,
                ]
            )
        )

    @property
    def prior_offset(self) -> FloatArray:
        """Prior mean minus current values."""
        return self.prior_mean - self.values

    @property
    def is_differentiated(self) -> bool:
        """False, because the spline has no noise; its coefficients are unknowns."""
        return False

    def with_step(self, step: FloatArray) -> Self:
        """Return the reference with its unknowns changed by `step`."""
        return replace(self, values=self.values + step)

    def angles_rad(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at sorted times, shape (2, n)."""
        angle = np.empty((2, time_s.size))
        for axis in (0, 1):
            segment_range = self._segments_between(axis, time_s)
            angle[axis] = self._rest_steps(axis, segment_range.start)
            for k in range(segment_range.start, segment_range.stop):
                segment = self._axis_segments[axis][k]
                coefficients = self._all_coefficients(axis, k)
                first, last = np.searchsorted(time_s, [segment.begin_s, segment.end_s])
                inside = time_s[first:last]
                angle[axis, first:last] = segment.position_steps(inside, coefficients)
                angle[axis, first:last] += self.values[-1] * _smoothed_direction(
                    segment, coefficients, inside
                )
                angle[axis, last:] = self._rest_steps(axis, k + 1)
        return np.asarray(angle * np.array(self.rad_per_step)[:, None], dtype=np.float64)

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> EvaluatedMotion:
        """Return mean stage rates between `edges_s` and, if requested, their derivatives."""
        rate, jacobian = StageRateJacobian.of_angles(
            self.angles_rad(edges_s), edges_s, self.rad_per_step
        )
        rate[~self._known_intervals(edges_s)] = np.nan
        if not derivatives:
            return EvaluatedMotion(rate, (), np.zeros((0, len(rate), 3)))
        local: list[LocalDerivative] = []
        lag = np.zeros((1, len(rate), 3))
        for axis in (0, 1):
            segment_range = self._segments_between(axis, edges_s)
            local += self._rest_derivatives(axis, segment_range, edges_s, jacobian)
            change = np.zeros(edges_s.size)
            for k in range(segment_range.start, segment_range.stop):
                segment = self._axis_segments[axis][k]
                coefficients = self._all_coefficients(axis, k)
                local += _inner_derivatives(
                    segment, self._first_inner_unknown[axis][k], edges_s, jacobian
                )
                first, last = np.searchsorted(edges_s, [segment.begin_s, segment.end_s])
                change[first:last] = _smoothed_direction(segment, coefficients, edges_s[first:last])
            lag[0] += jacobian.rate(axis, change, slice(0, len(rate)))
        return EvaluatedMotion(rate, tuple(sorted(local, key=lambda column: column.unknown)), lag)

    @cached_property
    def _axis_segments(self) -> tuple[list[SplineSegment], list[SplineSegment]]:
        pan, tilt = ([s for s in self.segments if s.axis == axis] for axis in (0, 1))
        return pan, tilt

    @cached_property
    def _first_inner_unknown(self) -> tuple[list[int], list[int]]:
        """Index of the first inner coefficient of each segment, among the unknowns."""
        count = np.array(
            [s.inner_count for segments in self._axis_segments for s in segments], dtype=np.int64
        )
        first = self._rest_unknown(1, len(self.rest_counts[1])) + np.cumsum(count) - count
        pan = len(self._axis_segments[0])
        return first[:pan].tolist(), first[pan:].tolist()

    def _rest_unknown(self, axis: int, k: int) -> int:
        return k + (len(self.rest_counts[0]) if axis else 0)

    def _rest_steps(self, axis: int, k: int) -> float:
        return self.rest_counts[axis][k] + float(self.values[self._rest_unknown(axis, k)])

    def _all_coefficients(self, axis: int, k: int) -> FloatArray:
        segment = self._axis_segments[axis][k]
        first = self._first_inner_unknown[axis][k]
        rest = self._rest_unknown(axis, k)
        ends = (float(self.values[rest]), float(self.values[rest + 1]))
        return segment.all_coefficients(ends, self.values[first : first + segment.inner_count])

    def _segments_between(self, axis: int, time_s: FloatArray) -> range:
        """Return the segments of an axis between the first and the last time."""
        if time_s.size == 0:
            return range(0)
        segments = self._axis_segments[axis]
        first = bisect_right(segments, float(time_s[0]), key=lambda segment: segment.end_s)
        last = bisect_right(segments, float(time_s[-1]), key=lambda segment: segment.begin_s)
        return range(first, max(first, last))

    def _rest_derivatives(
        self, axis: int, segment_range: range, edges_s: FloatArray, jacobian: StageRateJacobian
    ) -> Iterator[LocalDerivative]:
        segments, size = self._axis_segments[axis], edges_s.size
        for k in range(segment_range.start, segment_range.stop + 1):
            arrival = segments[k - 1] if k - 1 in segment_range else None
            departure = segments[k] if k in segment_range else None
            if axis == 0 and arrival is None and departure is None:
                continue  # a pan axis at rest does not change the rate
            first, last = 0, size
            if arrival or axis == 0:
                begin_s = (arrival or segments[k]).begin_s
                first = max(0, int(np.searchsorted(edges_s, begin_s)) - 1)
            if departure or axis == 0:
                end_s = (departure or segments[k - 1]).end_s
                last = min(size, int(np.searchsorted(edges_s, end_s)) + 1)
            inside = edges_s[first:last]
            share = np.ones(inside.size)
            if arrival:
                share -= 1.0 - _rest_share(arrival, inside, arrival.intervals)
            if departure:
                share -= 1.0 - _rest_share(departure, inside, 0)
            intervals = slice(first, max(first, last - 1))
            yield LocalDerivative(
                self._rest_unknown(axis, k), first, jacobian.rate(axis, share, intervals)
            )

    def _known_intervals(self, edges_s: FloatArray) -> BoolArray:
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.unknown_spans:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)


def counted_reference(
    polls: UnitPolls, rad_per_step: tuple[float, float], reason: str
) -> CountedReference:
    """Return the motion from the counts alone.

    Args:
        polls: of one recording, in the order of time.
        rad_per_step: pan and tilt, with the sign of the unit.
        reason: the defect of the commands, as text.
    """
    width = polls.latest_s - polls.earliest_s
    least_s = float(np.percentile(width, 1.0))
    extra_s = np.clip(width - least_s, 0.0, None)
    at_s, spread_s = polls.earliest_s + (least_s + extra_s) / 2.0, extra_s / np.sqrt(12.0)
    limit = (float(polls.earliest_s[0]), float(polls.latest_s[-1]))
    segments: list[SplineSegment] = []
    rest_counts: list[tuple[int, ...]] = []
    unknown_spans: list[tuple[float, float, str]] = []
    coefficients_left = MAX_COEFFICIENTS
    for axis in (0, 1):
        use = polls.valid[:, axis]
        time_s, steps, spread = at_s[use], polls.steps[use, axis], spread_s[use]
        spans = find_moving_spans(time_s, steps)
        counts = [round(float(steps[0]))]
        for begin_s, end_s in spans:
            inside = (time_s >= begin_s) & (time_s <= end_s)
            after = round(float(steps[np.searchsorted(time_s, end_s, side="right") - 1]))
            if begin_s < limit[0] or end_s > limit[1]:
                unknown_spans.append((begin_s, end_s, "the recording begins or ends during a move"))
            longest_s = float(np.max(np.diff(time_s[inside]), initial=0.0))
            if longest_s > MAX_POLL_GAP_S:
                unknown_spans.append((begin_s, end_s, "the unit did not reply during a move"))
            if longest_s > MAX_SPLINE_GAP_S:
                segment = unknown_segment(axis, (begin_s, end_s), (counts[-1], after))
                coefficients_left -= segment.inner_count
                segments.append(segment)
                counts.append(after)
                continue
            # Before the fit: its effort grows with the span.
            intervals = interval_count((begin_s, end_s), time_s[inside])
            if intervals + 3 - 2 * REST_COEFFICIENTS > coefficients_left:
                explanation = "the motion is too long for a fit without commands"
                unknown_spans.append((begin_s, np.inf, explanation))
                break
            segment = fit_segment(
                axis,
                (begin_s, end_s),
                (counts[-1], after),
                time_s[inside],
                steps[inside],
                spread[inside],
            )
            coefficients_left -= segment.inner_count
            segments.append(segment)
            counts.append(after)
        rest_counts.append(tuple(counts))
    centre, information = _join_segments(segments, rest_counts)
    constant_s = least_s + polls.constant_width_s + float(np.median(extra_s))
    return CountedReference(
        segments=tuple(segments),
        rest_counts=(rest_counts[0], rest_counts[1]),
        unknown_spans=tuple(unknown_spans),
        rad_per_step=rad_per_step,
        values=centre.copy(),
        prior_mean=centre,
        information=information,
        common_shift_std_s=constant_s / float(np.sqrt(12.0)),
        span_s=limit,
        reason=reason,
    )


def _join_segments(
    segments: list[SplineSegment], rest_counts: list[tuple[int, ...]]
) -> tuple[FloatArray, ArrowheadMatrix]:
    """Return the likeliest unknowns and their information, of all segments together."""
    rests = len(rest_counts[0]) + len(rest_counts[1])
    size = rests + sum(segment.inner_count for segment in segments)
    pull = np.zeros(size + 1)
    rows, columns = [np.arange(rests)], [np.arange(rests)]
    values = [np.full(rests, 1.0 / STEP_VARIANCE)]
    inner, rest = rests, {0: 0, 1: len(rest_counts[0])}
    for segment in segments:
        rest_before = rest[segment.axis]
        index = np.concatenate(
            [[rest_before], inner + np.arange(segment.inner_count), [rest_before + 1]]
        )
        diagonal, position = np.nonzero(segment.information)
        value, is_off_diagonal = segment.information[diagonal, position], diagonal > 0
        rows += [index[position + diagonal], index[position[is_off_diagonal]]]
        columns += [index[position], index[position[is_off_diagonal] + diagonal[is_off_diagonal]]]
        values += [value, value[is_off_diagonal]]
        pull[index] += segment.information_vector
        inner += segment.inner_count
        rest[segment.axis] += 1
    where = np.concatenate(rows), np.concatenate(columns)
    information = ArrowheadMatrix(
        csc_array((np.concatenate(values), where), shape=(size, size)),
        np.zeros((size, 1)),
        np.full((1, 1), LAG_PRIOR_STD_STEPS**-2.0),
    )
    return solve_arrowhead(information, pull), information


def _inner_derivatives(
    segment: SplineSegment, unknown: int, edges_s: FloatArray, jacobian: StageRateJacobian
) -> Iterator[LocalDerivative]:
    """Yield the derivatives by the inner coefficients that act between the edges."""
    begin, end = np.searchsorted(edges_s, [segment.begin_s, segment.end_s], side="right")
    values, first = segment.basis(edges_s[begin:end])
    # The k-th function is non-zero in four intervals, those with first index k - 3 to k.
    functions = np.arange(REST_COEFFICIENTS, REST_COEFFICIENTS + segment.inner_count)
    low = np.searchsorted(first, functions - 3)
    high = np.searchsorted(first, functions, side="right")
    for n in np.flatnonzero(high > low).tolist():
        inside = slice(int(low[n]), int(high[n]))
        rows = np.arange(inside.start, inside.stop)
        before, after = int(begin + inside.start > 0), int(begin + inside.stop < edges_s.size)
        change = np.zeros(before + rows.size + after)
        change[before : before + rows.size] = values[rows, functions[n] - first[inside]]
        intervals = slice(begin + inside.start - before, begin + inside.stop + after - 1)
        yield LocalDerivative(
            unknown + n, int(intervals.start), jacobian.rate(segment.axis, change, intervals)
        )


def _basis_function(segment: SplineSegment, time_s: FloatArray, k: int) -> FloatArray:
    """Return the k-th basis function at times, zero outside the segment."""
    values, first = segment.basis(time_s)
    column = k - first
    inside = (column >= 0) & (column < 4)
    inside &= (time_s >= segment.begin_s) & (time_s <= segment.end_s)
    return np.where(inside, values[np.arange(time_s.size), np.clip(column, 0, 3)], 0.0)


def _rest_share(segment: SplineSegment, time_s: FloatArray, first: int) -> FloatArray:
    """Return the sum of the three functions of the rest at one end, 1 beyond it."""
    clipped = np.clip(time_s, segment.begin_s, segment.end_s)
    total = np.zeros(time_s.size)
    for k in range(first, first + REST_COEFFICIENTS):
        total += _basis_function(segment, clipped, k)
    return total


def _smoothed_direction(
    segment: SplineSegment, coefficients: FloatArray, time_s: FloatArray
) -> FloatArray:
    """Return the sign of the speed, smoothed at low speed."""
    step_s = 1e-3
    later = segment.position_steps(time_s + step_s, coefficients)
    speed = (later - segment.position_steps(time_s - step_s, coefficients)) / (2.0 * step_s)
    return np.asarray(speed / np.hypot(speed, SLOW_SPEED_STEPS_S), dtype=np.float64)
