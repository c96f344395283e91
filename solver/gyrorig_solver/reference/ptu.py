"""The pan-tilt unit as the reference: the moves it was told, timed by its answers.

Unknowns, each held by what the polls know of it and fitted with the board's own parameters:

- when each order took hold: one for each move, one more for each change on the way;
- where the axis stands at each rest, inside the one step that its count names;
- the speed of each class of orders told the same speed, and each axis' acceleration
  (the polls see them to 1e-4: a timer cannot make every speed).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.reference.course import Course
from gyrorig_solver.reference.kinematics import AxisTurn
from gyrorig_solver.reference.motion import Evaluated, LocalColumn
from gyrorig_solver.reference.moves import Motion, Move, Rest
from gyrorig_solver.reference.polls import StartTimes
from gyrorig_solver.reference.slopes import slopes


@dataclass(frozen=True, eq=False)
class PtuReference:
    """Pan and tilt over time. Unknowns in order: starts, rests, log speeds, log ramps."""

    motion: Motion
    starts: StartTimes
    rad_per_step: tuple[float, float]  # pan and tilt, with the sign of the unit
    information: Arrow  # of all unknowns
    shift: FloatArray  # unknowns minus what the polls say
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
        shift = np.zeros(sum(starts.information.size))
        return cls(motion, starts, rad_per_step, starts.information, shift, span_s)

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        return f"{len(self.starts.moves)} moves as the pan-tilt unit was told, timed by its answers"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user should know of this reference."""
        said = [f"motion unknown for a while: {why}" for _, _, why in self.motion.unknown]
        if not self.starts.explained:
            said.append("the polled positions do not follow the commands; check for lost steps")
        return tuple(dict.fromkeys(said))

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
        for counted_s, axis, steps in self.motion.recounts:
            angle[axis, np.searchsorted(time_s, counted_s) :] = steps
        for k, move in enumerate(self.starts.moves):
            course = self._courses[k]
            first, last = np.searchsorted(time_s, [course.start_s[0], course.end_s])
            angle[move.axis, first:last] = course.position_steps(time_s[first:last])
            # Until the next move of this axis writes over it.
            until = np.searchsorted(time_s, self._left_s[k])
            angle[move.axis, last:until] = course.steps[-1]
        standing = self.starts.rest_steps + self.shift[self._rest : self._speed]
        for rest, off in zip(self._rests, standing, strict=True):
            at, share = self._standing(rest, time_s)
            angle[rest.axis, at] += off * share
        return np.asarray(angle * np.array(self.rad_per_step)[:, None], dtype=np.float64)

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> Evaluated:
        """Return mean stage rates between `edges_s` and, if asked, their derivatives."""
        rate, turn = AxisTurn.along(self.angles_rad(edges_s), edges_s, self.rad_per_step)
        rate[~self._known(edges_s)] = np.nan
        if not derivatives:
            return Evaluated(rate, (), np.zeros((0, len(rate), 3)))
        return Evaluated(rate, *self._columns(edges_s, turn))

    def _columns(
        self, edges_s: FloatArray, turn: AxisTurn
    ) -> tuple[tuple[LocalColumn, ...], FloatArray]:
        """Return the derivatives by each start and rest, and by speeds and accelerations."""
        classes = self.motion.classes
        shared = np.zeros((classes + 2, edges_s.size - 1, 3))
        local = []
        for k, move in enumerate(self.starts.moves):
            at = self._span(self._courses[k], edges_s)
            found = slopes(move, *self._unknowns(k), edges_s[at.start : at.stop + 1])
            local += [
                LocalColumn(self._first[k] + n, at.start, turn.rate(move.axis, slope, at))
                for n, slope in enumerate(found.starts)
            ]
            for row, slope in zip(move.classes, found.speeds, strict=True):
                shared[row, at] += turn.rate(move.axis, slope, at)
            shared[classes + move.axis, at] += turn.rate(move.axis, found.acceleration, at)
        for n, rest in enumerate(self._rests):
            spot, share = self._standing(rest, edges_s)
            at = slice(spot.start, max(spot.start, spot.stop - 1))
            local.append(LocalColumn(self._rest + n, at.start, turn.rate(rest.axis, share, at)))
        return tuple(local), shared

    @cached_property
    def _rests(self) -> tuple[Rest, ...]:
        return self.motion.rests

    @cached_property
    def _rest(self) -> int:
        return sum(len(move.orders) for move in self.starts.moves)

    @cached_property
    def _speed(self) -> int:
        return self._rest + len(self._rests)

    @cached_property
    def _courses(self) -> tuple[Course, ...]:
        """Each move's course at the unknowns of now."""
        moves = self.starts.moves
        return tuple(move.course(*self._unknowns(k)) for k, move in enumerate(moves))

    @cached_property
    def _first(self) -> tuple[int, ...]:
        """Each move's first start among the unknowns."""
        counts = [len(move.orders) for move in self.starts.moves]
        return tuple(int(n) for n in np.concatenate([[0], np.cumsum(counts)]))

    def _unknowns(self, k: int) -> tuple[FloatArray, FloatArray, float]:
        """Return what a course of move `k` needs: starts, log speeds, its log acceleration."""
        move: Move = self.starts.moves[k]
        own = slice(self._first[k], self._first[k + 1])
        ramp = self._speed + self.motion.classes
        log_speed = self.starts.log_speed + self.shift[self._speed : ramp]
        log_ramp = self.starts.log_acceleration[move.axis] + self.shift[ramp + move.axis]
        return move.starts_s + self.shift[own], log_speed, float(log_ramp)

    @cached_property
    def _left_s(self) -> tuple[float, ...]:
        """When each move's axis sets off again after it, or is counted anew."""
        left = [np.inf, np.inf]
        found = []
        for move, course in zip(self.starts.moves[::-1], self._courses[::-1], strict=True):
            counted = [
                at
                for at, axis, _ in self.motion.recounts
                if axis == move.axis and at > course.end_s
            ]
            found.append(min([left[move.axis], *counted]))
            left[move.axis] = float(course.start_s[0])
        return tuple(found[::-1])

    def _span(self, course: Course, edges_s: FloatArray) -> slice:
        """Return the intervals that touch a course."""
        first = max(0, int(np.searchsorted(edges_s, course.start_s[0])) - 2)
        last = min(edges_s.size - 1, int(np.searchsorted(edges_s, course.end_s)) + 2)
        return slice(first, max(first, last))

    def _standing(self, rest: Rest, time_s: FloatArray) -> tuple[slice, FloatArray]:
        """Return the times that a rest's own offset reaches, and its share there.

        The share rises with the arriving move's way and falls with the leaving one's.
        """
        begin, end = 0, time_s.size
        if rest.arrival is not None:
            begin = max(0, int(np.searchsorted(time_s, self._courses[rest.arrival].start_s[0])) - 1)
        if rest.departure is not None:
            done_s = self._courses[rest.departure].end_s
            end = min(end, int(np.searchsorted(time_s, done_s)) + 1)
        inside = time_s[begin : max(begin, end)]
        share = np.ones(inside.size)
        if rest.arrival is not None:
            share += self._courses[rest.arrival].share(inside) - 1.0
        if rest.departure is not None:
            share -= self._courses[rest.departure].share(inside)
        return slice(begin, max(begin, end)), share

    def _known(self, edges_s: FloatArray) -> BoolArray:
        """Return True for each interval in which the motion is known from the commands."""
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.motion.unknown:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)
