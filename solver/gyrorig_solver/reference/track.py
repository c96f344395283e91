"""Where an axis is at any time of a recording: all its moves as one row of legs.

On each leg the position, the share of the move that is done, and both derivatives are
polynomials of the time since the leg began. Looking up a window costs in proportion to
the window, whatever the length of the recording.

What to use when: `lay_tracks` for both axes at given unknowns; `Track.along` for sorted
times, `Track.at` for a handful of any.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.course import Course
from gyrorig_solver.reference.table import MoveTable, Unknowns
from gyrorig_solver.reference.trapezoid import LEGS, Trapezoids

LONG_AGO_S = -1e9  # the first rest has no beginning


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One axis. Legs in the order of time; polynomials in seconds since a leg's start."""

    start_s: FloatArray  # (n,), not decreasing
    move: IntArray  # (n,), the move of a leg, or of the rest that it ends in; -1 before any
    moving: BoolArray  # (n,)
    steps: FloatArray  # (3, n), position, with what the rests lie off their counts
    share: FloatArray  # (3, n), of the move's way
    by_speed: FloatArray  # (3, n), by log speed; zero for moves with orders on the way
    by_acceleration: FloatArray  # (3, n)
    moves: IntArray  # (m,), of this axis, in the order of time
    begin_s: FloatArray  # (m,)
    end_s: FloatArray  # (m,)

    def at(self, time_s: FloatArray) -> "Spots":
        """Return where some times fall, in any order."""
        leg = np.searchsorted(self.start_s, time_s, side="right") - 1
        leg = np.maximum(leg, 0).astype(np.int64)
        return Spots(self, leg, time_s - self.start_s[leg])

    def along(self, time_s: FloatArray) -> "Spots":
        """Return where times that do not decrease fall."""
        if time_s.size == 0:
            return self.at(time_s)
        first, last = np.searchsorted(self.start_s, time_s[[0, -1]], side="right")
        legs = np.arange(max(0, int(first) - 1), max(1, int(last)))
        begun = np.maximum.accumulate(np.searchsorted(time_s, self.start_s[legs[1:]]))
        count = np.diff(np.concatenate([[0], begun, [time_s.size]]))
        return Spots(self, np.repeat(legs, count), time_s - np.repeat(self.start_s[legs], count))


@dataclass(frozen=True, slots=True, eq=False)
class Spots:
    """Some times on a track."""

    track: Track
    leg: IntArray  # (n,)
    since_s: FloatArray  # (n,)

    def only(self, where: BoolArray | IntArray | slice) -> "Spots":
        """Return some of them."""
        return Spots(self.track, self.leg[where], self.since_s[where])

    @property
    def moving(self) -> BoolArray:
        """True on the way."""
        return self.track.moving[self.leg]

    @property
    def move(self) -> IntArray:
        """Which move, or which was the last; -1 before the first."""
        return self.track.move[self.leg]

    @property
    def steps(self) -> FloatArray:
        """Position."""
        return self._value(self.track.steps)

    @property
    def speed_steps_s(self) -> FloatArray:
        """Signed speed."""
        rate = self.track.steps[2][self.leg] * self.since_s
        return np.asarray(self.track.steps[1][self.leg] + 2.0 * rate)

    @property
    def share(self) -> FloatArray:
        """Share of the move that is done, 0 to 1."""
        return self._value(self.track.share)

    @property
    def by_speed(self) -> FloatArray:
        """Change of position by log speed."""
        return self._value(self.track.by_speed)

    @property
    def by_acceleration(self) -> FloatArray:
        """Change of position by log acceleration."""
        return self._value(self.track.by_acceleration)

    def _value(self, polynomial: FloatArray) -> FloatArray:
        value: FloatArray = polynomial[2].take(self.leg)
        value *= self.since_s
        value += polynomial[1].take(self.leg)
        value *= self.since_s
        value += polynomial[0].take(self.leg)
        return value


def lay_tracks(table: MoveTable, unknowns: Unknowns) -> tuple[Track, Track]:
    """Return pan and tilt at the unknowns' values."""
    courses = {}
    for k in table.several:
        starts_s = unknowns.starts_s[table.orders(k)]
        log_ramp = float(unknowns.log_acceleration[table.axis[k]])
        courses[k] = table.moves[k].course(starts_s, unknowns.log_speed, log_ramp)
    pan, tilt = (_Legs(table, axis) for axis in (0, 1))
    return pan.track(unknowns, courses), tilt.track(unknowns, courses)


class _Legs:
    """The legs of one axis while they are laid: the first rest, then move by move."""

    def __init__(self, table: MoveTable, axis: int) -> None:
        self._table, self._axis, self._own = table, axis, table.own[axis]

    def track(self, unknowns: Unknowns, courses: Mapping[int, Course]) -> Track:
        """Return the axis' track."""
        table, own = self._table, self._own
        legs = np.array([courses[k].start_s.size if k in courses else LEGS for k in own], dtype=int)
        first = 1 + np.cumsum(legs) - legs
        size = 1 + int(legs.sum())
        self.start_s = np.full(size, LONG_AGO_S)
        self.move = np.repeat(np.concatenate([[-1], own]), np.concatenate([[1], legs]))
        self.gone = np.zeros((4, 3, size))  # steps, share, by speed, by acceleration
        self.gone[0, 0, 0] = table.rest_steps[self._axis]
        plain = table.plain[own]
        self._plain(unknowns, own[plain], first[plain])
        for k, at in zip(own[~plain], first[~plain], strict=True):
            self._course(int(k), courses[int(k)], int(at))
        begin_s, end_s = self.start_s[first], self.start_s[first + legs - 1]
        for counted_s, axis, count in table.recounts:
            if axis == self._axis:
                self._recount(counted_s, count)
        self._stand(unknowns.rest_steps)
        # A move that is not over when the next one begins gives way.
        start_s = np.minimum.accumulate(self.start_s[::-1])[::-1]
        moving = (self.gone[0, 1] != 0.0) | (self.gone[0, 2] != 0.0)
        steps, share, by_speed, by_acceleration = self.gone
        return Track(
            start_s,
            self.move,
            moving,
            steps,
            share,
            by_speed,
            by_acceleration,
            own,
            begin_s,
            end_s,
        )

    def _plain(self, unknowns: Unknowns, moves: IntArray, first: IntArray) -> None:
        """Lay the moves of one order."""
        table = self._table
        way = table.to_steps[moves] - table.from_steps[moves]
        found = Trapezoids.of(
            np.abs(way),
            table.speed[moves] * np.exp(unknowns.log_speed[table.speed_class[moves]]),
            table.acceleration[moves] * float(np.exp(unknowns.log_acceleration[self._axis])),
            table.base[moves],
        )
        at = first + np.arange(LEGS)[:, None]
        self.start_s[at] = unknowns.starts_s[table.first[moves]] + found.leg_s
        sign = np.sign(way)
        gone = found.gone
        self.gone[0][:, at] = sign * gone
        self.gone[0, 0, at] += table.from_steps[moves]
        self.gone[1][:, at] = gone / np.abs(way)
        self.gone[2][:, at] = sign * found.by_speed
        self.gone[3][:, at] = sign * found.by_acceleration

    def _course(self, k: int, course: Course, first: int) -> None:
        """Lay a move with orders on the way."""
        at = slice(first, first + course.start_s.size)
        self.start_s[at] = course.start_s
        half = 0.5 * course.acceleration
        self.gone[0][:, at] = course.steps, course.speed, half
        # On one leg an axis does not turn round.
        sign = np.where(course.speed != 0.0, np.sign(course.speed), np.sign(half))
        self.gone[1][:, at] = course.way, sign * course.speed, sign * half
        self.gone[1][:, at] /= max(float(course.way[-1]), 1e-12)

    def _recount(self, counted_s: float, steps: int) -> None:
        """Put in a rest of another count from a time on: the axis was homed."""
        now = int(self.move[np.searchsorted(self.start_s, counted_s, side="right") - 1])
        at = int(np.searchsorted(self.move, now, side="right"))
        self.start_s = np.insert(self.start_s, at, counted_s)
        self.move = np.insert(self.move, at, now)
        rest = np.zeros((4, 3))
        rest[0, 0], rest[1, 0] = steps, float(now >= 0)
        self.gone = np.insert(self.gone, at, rest, axis=2)

    def _stand(self, rest_steps: FloatArray) -> None:
        """Add what the rests lie off their counts, from one to the next along each move."""
        table = self._table
        before = np.full(self.move.size, rest_steps[table.first_rest(self._axis)])
        change = np.zeros(self.move.size)
        told = self.move >= 0
        moves = self.move[told]
        before[told] = rest_steps[table.departure[moves]]
        change[told] = rest_steps[table.arrival[moves]] - before[told]
        self.gone[0] += change * self.gone[1]
        self.gone[0, 0] += before
