"""The pan-tilt unit as the reference: told trapezoids, started when the polls say.

Unknowns, each held by what is known of it and fitted with the board's own parameters:

- one start time for each move (from the polls);
- where the axis stands at each rest, inside the one step that its count names. A count
  is an interval: a controller may round a target, a stepper rests off its detent;
- the speed of each class of moves told the same speed, and each axis' acceleration
  (from the polls, which see them to 1e-4: a timer cannot make every speed).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.reference.kinematics import stage_rate
from gyrorig_solver.reference.motion import Evaluated, LocalColumn
from gyrorig_solver.reference.moves import Motion, Move
from gyrorig_solver.reference.polls import STEP_VARIANCE, StartTimes, altered
from gyrorig_solver.reference.trapezoid import Trapezoid

_STEP = 1e-4  # relative step of the numerical derivatives by speed and acceleration


@dataclass(frozen=True, slots=True, eq=False)
class _Rest:
    """One rest of one axis: from the move that came here to the move that left."""

    axis: int
    arrival: int | None  # index of the move, None for the rest before the first
    departure: int | None


@dataclass(frozen=True, slots=True, eq=False)
class PtuReference:
    """Pan and tilt over time. Unknowns in order: starts, rests, log speeds, log ramps."""

    motion: Motion
    starts: StartTimes
    rests: tuple[_Rest, ...]
    rad_per_step: tuple[float, float]  # pan and tilt, with the sign of the unit
    information: FloatArray  # of all unknowns, squared
    shift: FloatArray  # unknowns minus what is known of them
    span_s: tuple[float, float]  # where the polls saw the unit

    @classmethod
    def of(
        cls,
        motion: Motion,
        starts: StartTimes,
        rad_per_step: tuple[float, float],
        span_s: tuple[float, float],
    ) -> Self:
        """Return the reference at what the polls say."""
        rests = _rests(starts.moves)
        count, size = len(starts.moves), starts.information.shape[0]
        information = np.zeros((size + len(rests), size + len(rests)))
        polled = np.concatenate([np.arange(count), len(rests) + np.arange(count, size)])
        information[np.ix_(polled, polled)] = starts.information
        standing = count + np.arange(len(rests))
        information[standing, standing] = 1.0 / STEP_VARIANCE
        shift = np.zeros(information.shape[0])
        return cls(motion, starts, rests, rad_per_step, information, shift, span_s)

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        return f"{len(self.starts.moves)} moves as the pan-tilt unit was told, timed by its answers"

    @property
    def pull(self) -> FloatArray:
        """Back to what is known."""
        return -self.shift

    @property
    def common_std_s(self) -> float:
        """The sample instant inside the shortest poll is unknown by this."""
        return self.starts.common_std_s

    @property
    def differentiated(self) -> bool:
        """False: the profile is exact."""
        return False

    def moved(self, step: FloatArray) -> Self:
        """Return the reference with its unknowns changed by `step`."""
        return replace(self, shift=self.shift + step)

    def angles_rad(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at times, shape (2, n)."""
        angle = np.repeat(
            np.array(self.motion.rest_steps, dtype=np.float64)[:, None], time_s.size, axis=1
        )
        for k, move in enumerate(self.starts.moves):
            start, profile = self._start(k), self._profile(move)
            first, last = np.searchsorted(time_s, [start, start + profile.duration_s])
            travel = profile.position_steps(time_s[first:last] - start)
            angle[move.axis, first:last] = move.from_steps + move.sign * travel
            # Until the next move of this axis writes over it.
            angle[move.axis, last : self._next_start(k, time_s)] = move.to_steps
        for k, rest in enumerate(self.rests):
            at, share = self._standing(rest, time_s)
            angle[rest.axis, at] += self.shift[len(self.starts.moves) + k] * share
        return np.asarray(angle * np.array(self.rad_per_step)[:, None], dtype=np.float64)

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> Evaluated:
        """Return mean stage rates between `edges_s` and, if asked, their derivatives."""
        angle = self.angles_rad(edges_s)
        width = np.diff(edges_s)
        axis_rate = np.diff(angle, axis=1) / width
        tilt = (angle[1, :-1] + angle[1, 1:]) / 2.0
        rate = stage_rate(tilt, axis_rate[0], axis_rate[1])
        rate[~self._known(edges_s)] = np.nan
        if not derivatives:
            return Evaluated(rate, (), np.zeros((0, width.size, 3)))
        turn = _Turn(self.rad_per_step, tilt, axis_rate[0], width)
        return Evaluated(rate, *self._columns(edges_s, turn))

    def _columns(
        self, edges_s: FloatArray, turn: "_Turn"
    ) -> tuple[tuple[LocalColumn, ...], FloatArray]:
        """Return the derivatives by each start and rest, and by speeds and accelerations."""
        classes = self.motion.classes
        shared = np.zeros((classes + 2, edges_s.size - 1, 3))
        local = []
        for k, move in enumerate(self.starts.moves):
            at = self._span(k, edges_s)
            since = edges_s[at.start : at.stop + 1] - self._start(k)
            profile = self._profile(move)
            earlier = -move.sign * profile.speed_at_steps_s(since)
            local.append(LocalColumn(at.start, turn.rate(move.axis, earlier, at)))
            for row, which in ((move.speed_class, 0), (classes + move.axis, 1)):
                slope = move.sign * _slope(profile, since, which)
                shared[row, at] += turn.rate(move.axis, slope, at)
        for rest in self.rests:
            spot, share = self._standing(rest, edges_s)
            at = slice(spot.start, max(spot.start, spot.stop - 1))
            local.append(LocalColumn(at.start, turn.rate(rest.axis, share, at)))
        return tuple(local), shared

    def _next_start(self, k: int, time_s: FloatArray) -> int:
        """Return the index at which the axis of move `k` sets off again, or the end."""
        own = self.starts.moves[k].axis
        for later in range(k + 1, len(self.starts.moves)):
            if self.starts.moves[later].axis == own:
                return int(np.searchsorted(time_s, self._start(later)))
        return int(time_s.size)

    def _start(self, k: int) -> float:
        return self.starts.moves[k].start_s + float(self.shift[k])

    def _profile(self, move: Move) -> Trapezoid:
        shared = len(self.starts.moves) + len(self.rests)
        speed = self.starts.log_speed[move.speed_class] + self.shift[shared + move.speed_class]
        ramp = (
            self.starts.log_acceleration[move.axis]
            + self.shift[shared + self.motion.classes + move.axis]
        )
        return altered(move.profile, float(speed), float(ramp))

    def _span(self, k: int, edges_s: FloatArray) -> slice:
        """Return the intervals that touch move `k`."""
        start = self._start(k)
        end = start + self._profile(self.starts.moves[k]).duration_s
        first = max(0, int(np.searchsorted(edges_s, start)) - 2)
        last = min(edges_s.size - 1, int(np.searchsorted(edges_s, end)) + 2)
        return slice(first, max(first, last))

    def _standing(self, rest: _Rest, time_s: FloatArray) -> tuple[slice, FloatArray]:
        """Return the times that a rest's own offset reaches, and its share there.

        The share rises with the arriving move's travel and falls with the leaving one's.
        """
        begin, end = 0, time_s.size
        if rest.arrival is not None:
            begin = max(0, int(np.searchsorted(time_s, self._start(rest.arrival))) - 1)
        if rest.departure is not None:
            leaving = self._profile(self.starts.moves[rest.departure])
            done_s = self._start(rest.departure) + leaving.duration_s
            end = min(end, int(np.searchsorted(time_s, done_s)) + 1)
        inside = time_s[begin : max(begin, end)]
        share = np.ones(inside.size)
        for move_index, sign in ((rest.arrival, 1.0), (rest.departure, -1.0)):
            if move_index is None:
                continue
            move = self.starts.moves[move_index]
            travel = self._profile(move).position_steps(inside - self._start(move_index))
            done = travel / move.profile.distance_steps
            share += (done - 1.0) if sign > 0.0 else -done
        return slice(begin, max(begin, end)), share

    def _known(self, edges_s: FloatArray) -> BoolArray:
        """Return True for each interval in which the motion is known from the commands."""
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.motion.unknown:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """How a small change of one axis' position changes the stage rate."""

    rad_per_step: tuple[float, float]
    tilt_rad: FloatArray  # (n,), at the intervals' middles
    pan_rate_rad_s: FloatArray  # (n,)
    width_s: FloatArray  # (n,)

    def rate(self, axis: int, change_steps: FloatArray, at: slice) -> FloatArray:
        """Return d(stage rate) over the intervals `at`, from the change at their edges."""
        angle = self.rad_per_step[axis] * change_steps
        speed = np.diff(angle) / self.width_s[at]
        sine, cosine = np.sin(self.tilt_rad[at]), np.cos(self.tilt_rad[at])
        if axis == 0:
            return np.column_stack([np.zeros_like(speed), speed * sine, speed * cosine])
        lean = (angle[:-1] + angle[1:]) / 2.0
        pan = self.pan_rate_rad_s[at]
        return np.column_stack([speed, pan * cosine * lean, -pan * sine * lean])


def _rests(moves: tuple[Move, ...]) -> tuple[_Rest, ...]:
    """Return every rest of both axes, in the order of axes and time."""
    rests = []
    for axis in (0, 1):
        own = [k for k, move in enumerate(moves) if move.axis == axis]
        pairs = zip([None, *own], [*own, None], strict=True)
        rests += [_Rest(axis, arrival, departure) for arrival, departure in pairs]
    return tuple(rests)


def _slope(profile: Trapezoid, since_s: FloatArray, which: int) -> FloatArray:
    """Return the position's derivative by log speed (0) or log acceleration (1)."""
    up = altered(profile, _STEP * (which == 0), _STEP * (which == 1))
    down = altered(profile, -_STEP * (which == 0), -_STEP * (which == 1))
    change = up.position_steps(since_s) - down.position_steps(since_s)
    return np.asarray(change / (2.0 * _STEP), dtype=np.float64)
