"""Step train that a controller sends to a motor: the planned motion, averaged or not.

A plan is a list of parabolas, exact at any time. With an S-curve the controller sends the mean of
the plan over a window of length L: the common way to limit jerk in a step generator. The motion is
then late by L / 2 on average and ends L later; the counted position is averaged too. The plan
consists of parabolas x(t), so that the mean is exact: the difference of the antiderivative at t and
at t - L, divided by L. Positions are counted ones; homing changes the count of a position without
motion (`recount`).
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]

_SHORTEST_INTERVAL_S = 1e-9


class StepTrain:
    """The plan so far, in order of time."""

    def __init__(self, s_curve_s: float = 0.0) -> None:
        """Start at rest at count zero; average the plan over `s_curve_s`."""
        self._window_s = s_curve_s
        self._segments = [Segment(0.0, 0.0, 0.0, 0.0)]
        self._starts = [0.0]
        self._home_times = [float("-inf")]
        self._home_offsets = [
            0.0
        ]  # position on one common scale minus the count, from each time on

    @property
    def target_steps(self) -> float:
        """The counted position at which the plan ends."""
        return self._segments[-1].steps

    @property
    def rests_at_s(self) -> float:
        """When the train ends."""
        return self._starts[-1] + self._window_s

    def append(self, segments: list[Segment]) -> None:
        """Replace all segments that begin after the first new one."""
        kept_count = len(self._starts)
        while kept_count and self._starts[kept_count - 1] >= segments[0].start_s:
            kept_count -= 1
        self._segments[kept_count:] = segments
        self._starts[kept_count:] = [s.start_s for s in segments]

    def recount(self, time_s: float, count: float) -> float:
        """Set the count at a time; return by how much it decreases."""
        steps, speed = self.planned_state(time_s)
        self._home_times.append(time_s)
        self._home_offsets.append(self._home_offsets[-1] + steps - count)
        self.append([Segment(time_s, count, speed, 0.0)])
        return steps - count

    def planned_state(self, time_s: float) -> tuple[float, float]:
        """Return planned position in counted steps and speed in steps/s."""
        return self._segments[bisect_right(self._starts, time_s) - 1].at(time_s)

    def state(self, time_s: float) -> tuple[float, float]:
        """Return sent position in counted steps and speed in steps/s."""
        if self._window_s == 0.0:
            return self.planned_state(time_s)
        steps, speed = self.evaluate(time_s, np.zeros(1))
        return float(steps[0]), float(speed[0])

    def evaluate(self, start_s: float, offsets_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return sent position and speed at `start_s + offsets_s` (ascending), each (n,)."""
        if self._window_s == 0.0:
            return self._trapezoid(start_s, offsets_s)
        return self._smoothed(start_s, offsets_s)

    def planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """Return the segments in [after, until], each with the speed before it."""
        first = max(bisect_right(self._starts, after_s) - 1, 0)
        last = max(bisect_right(self._starts, until_s), first + 1)
        segments = []
        for k in range(first, last):
            segment = self._segments[k]
            speed_before = self._segments[k - 1].at(segment.start_s)[1] if k else 0.0
            segments.append((segment, speed_before))
        return segments

    def reversal_times_s(self, after_s: float, until_s: float) -> list[float]:
        """Return times in (after, until], in order, between which the train is monotonic."""
        first = bisect_right(self._starts, after_s - self._window_s)
        last = bisect_right(self._starts, until_s)
        if self._window_s == 0.0:
            return self._starts[first:last]
        nearby_starts = self._starts[max(first - 1, 0) : last]
        knots = sorted({t + delay_s for t in nearby_starts for delay_s in (0.0, self._window_s)})
        reversals = {*knots, *self._smooth_reversals_s(knots)}
        return sorted(t for t in reversals if after_s < t <= until_s)

    def _trapezoid(self, start_s: float, offsets_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        first = max(bisect_right(self._starts, start_s) - 1, 0)
        last = max(bisect_right(self._starts, start_s + float(offsets_s[-1])), first + 1)
        segment = self._segments[first]
        if last == first + 1:  # nearly always
            return segment.during(offsets_s + (start_s - segment.start_s))
        edges = [s - start_s for s in self._starts[first + 1 : last]]
        cuts = [0, *np.searchsorted(offsets_s, edges).tolist(), len(offsets_s)]
        steps, speeds = np.empty_like(offsets_s), np.empty_like(offsets_s)
        for i, segment in enumerate(self._segments[first:last]):
            interval = slice(cuts[i], cuts[i + 1])
            elapsed_s = offsets_s[interval] + (start_s - segment.start_s)
            steps[interval], speeds[interval] = segment.during(elapsed_s)
        return steps, speeds

    def _smoothed(self, start_s: float, offsets_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the mean of the plan over the window before each time."""
        window_s = self._window_s
        begin_s = start_s - window_s
        planned = self.planned(begin_s, start_s + float(offsets_s[-1]))
        if len(planned) == 1:  # the mean of one parabola
            acceleration = planned[0][0].acceleration_steps_s2
            steps, speed = self._trapezoid(start_s, offsets_s)
            integral_before = 0.5 * window_s * (speed - acceleration * window_s / 3.0)
            return steps - integral_before, speed - 0.5 * acceleration * window_s
        pieces = [
            replace(segment, steps=segment.steps + float(self._home_steps(segment.start_s).item()))
            for segment, _ in planned
        ]
        reference = pieces[0].at(begin_s)[0]
        integral_before, integral_now = (
            antiderivative(pieces, begin_s, offsets_s + ahead, reference)
            for ahead in (0.0, window_s)
        )
        times = start_s + offsets_s
        steps = reference + (integral_now - integral_before) / window_s - self._home_steps(times)
        ends = (
            self._trapezoid(at_s, offsets_s)[0] + self._home_steps(at_s + offsets_s)
            for at_s in (start_s, begin_s)
        )
        return steps, (next(ends) - next(ends)) / window_s

    def _home_steps(self, time_s: FloatArray | float) -> FloatArray:
        if len(self._home_offsets) == 1:
            return np.zeros(1)
        indices = np.searchsorted(self._home_times, time_s, side="right") - 1
        return np.asarray(self._home_offsets, dtype=np.float64)[indices]

    def _smooth_reversals_s(self, knots_s: list[float]) -> list[float]:
        """Return where the averaged speed, a parabola between knots, changes its sign."""
        reversals: list[float] = []
        for begin_s, end_s in pairwise(knots_s):
            length_s = end_s - begin_s
            if length_s < _SHORTEST_INTERVAL_S:
                continue
            _, (low, mid, high) = self._smoothed(begin_s, length_s * np.array([0.25, 0.5, 0.75]))
            if low * mid > 0.0 and mid * high > 0.0 and abs(low - 2.0 * mid + high) == 0.0:
                continue
            # speed = curve * u^2 + slope * u + mid, with u = -1/2 .. 1/2 over the interval
            roots = np.roots([8.0 * (low - 2.0 * mid + high), 2.0 * (high - low), mid])
            real = roots[np.isreal(roots)].real
            reversals += (begin_s + length_s * (0.5 + real[np.abs(real) < 0.5])).tolist()
        return reversals


def antiderivative(
    segments: Sequence[Segment], start_s: float, offsets_s: FloatArray, reference_steps: float
) -> FloatArray:
    """Return the integral of planned position minus a reference from `start_s` on, (n,).

    Args:
        segments: the segments from `start_s` to the last offset; their positions have a common
            zero.
        start_s: lower limit of the integral.
        offsets_s: ascending, not negative, (n,).
        reference_steps: subtracted from the position, so that the sum stays small.
    """
    starts = [segment.start_s - start_s for segment in segments[1:]]
    edges = [0, *np.searchsorted(offsets_s, starts).tolist(), len(offsets_s)]
    result = np.empty_like(offsets_s)
    total = 0.0
    for k, segment in enumerate(segments):
        begin_s = start_s if k == 0 else segment.start_s
        steps, speed = segment.at(begin_s)
        steps -= reference_steps
        half, sixth = 0.5 * speed, segment.acceleration_steps_s2 / 6.0
        dt = offsets_s[edges[k] : edges[k + 1]] + (start_s - begin_s)
        result[edges[k] : edges[k + 1]] = total + dt * (steps + dt * (half + dt * sixth))
        if k + 1 < len(segments):
            length = segments[k + 1].start_s - begin_s
            total += length * (steps + length * (half + length * sixth))
    return result
