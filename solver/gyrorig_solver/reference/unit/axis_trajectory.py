"""Trajectory of an axis over a recording: all moves as one series of segments.

In each segment the position, the covered share of the move and the derivatives are polynomials
of the time since the start of the segment. The cost of a window does not depend on the length of
the recording.

What to use when: `build_trajectories` for both axes at given unknowns; `Trajectory.sample_sorted`
for sorted times, `Trajectory.sample` for times in any order.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.unit.motion_profile import MotionProfile
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.trapezoidal_moves import SEGMENTS, TrapezoidalMoves

FIRST_REST_START_S = -1e9  # the first rest has no beginning


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """One axis. Segments sorted by time; polynomials in seconds since their starts."""

    start_s: FloatArray  # (n,), not decreasing
    move: IntArray  # (n,), the move of a segment, or of the rest after it; -1 before the first move
    is_moving: BoolArray  # (n,)
    steps: FloatArray  # (3, n), position, with the offsets of the rests
    progress: FloatArray  # (3, n), covered share of the move
    by_speed: FloatArray  # (3, n), by log speed; zero for moves with several commands
    by_acceleration: FloatArray  # (3, n)
    by_base_speed: FloatArray  # (3, n), s
    moves: IntArray  # (m,), of this axis, in the order of time
    begin_s: FloatArray  # (m,)
    end_s: FloatArray  # (m,)

    def sample(self, time_s: FloatArray) -> "SampledTrajectory":
        """Return the trajectory at times in any order."""
        segment = np.searchsorted(self.start_s, time_s, side="right") - 1
        segment = np.maximum(segment, 0).astype(np.int64)
        return SampledTrajectory(self, segment, time_s - self.start_s[segment])

    def sample_sorted(self, time_s: FloatArray) -> "SampledTrajectory":
        """Return the trajectory at sorted times."""
        if time_s.size == 0:
            return self.sample(time_s)
        first, last = np.searchsorted(self.start_s, time_s[[0, -1]], side="right")
        segments = np.arange(max(0, int(first) - 1), max(1, int(last)))
        first_of_segment = np.maximum.accumulate(
            np.searchsorted(time_s, self.start_s[segments[1:]])
        )
        count = np.diff(np.concatenate([[0], first_of_segment, [time_s.size]]))
        return SampledTrajectory(
            self, np.repeat(segments, count), time_s - np.repeat(self.start_s[segments], count)
        )


@dataclass(frozen=True, slots=True, eq=False)
class SampledTrajectory:
    """A trajectory at given times."""

    trajectory: Trajectory
    segment: IntArray  # (n,)
    since_s: FloatArray  # (n,)

    def subset(self, selection: BoolArray | IntArray | slice) -> "SampledTrajectory":
        """Return the selected times."""
        return SampledTrajectory(self.trajectory, self.segment[selection], self.since_s[selection])

    @property
    def is_moving(self) -> BoolArray:
        """Mask of times in motion."""
        return self.trajectory.is_moving[self.segment]

    @property
    def move(self) -> IntArray:
        """The current or last move; -1 before the first."""
        return self.trajectory.move[self.segment]

    @property
    def steps(self) -> FloatArray:
        """Position."""
        return self._value(self.trajectory.steps)

    @property
    def speed_steps_s(self) -> FloatArray:
        """Signed speed."""
        rate = self.trajectory.steps[2][self.segment] * self.since_s
        return np.asarray(self.trajectory.steps[1][self.segment] + 2.0 * rate)

    @property
    def progress(self) -> FloatArray:
        """Covered share of the move, 0 to 1."""
        return self._value(self.trajectory.progress)

    @property
    def by_speed(self) -> FloatArray:
        """Derivative of the position by log speed."""
        return self._value(self.trajectory.by_speed)

    @property
    def by_acceleration(self) -> FloatArray:
        """Derivative of the position by log acceleration."""
        return self._value(self.trajectory.by_acceleration)

    @property
    def by_base_speed(self) -> FloatArray:
        """Derivative of the position by the base speed, s."""
        return self._value(self.trajectory.by_base_speed)

    @property
    def by_corner(self) -> FloatArray:
        """Derivative of the position by the duration of rounded corners, steps/s."""
        return np.zeros(self.segment.size)

    def _value(self, polynomial: FloatArray) -> FloatArray:
        value: FloatArray = polynomial[2].take(self.segment)
        value *= self.since_s
        value += polynomial[1].take(self.segment)
        value *= self.since_s
        value += polynomial[0].take(self.segment)
        return value


def build_trajectories(
    table: MoveTable, parameters: MotionParameters
) -> tuple[Trajectory, Trajectory]:
    """Return the trajectories of pan and tilt for the parameters."""
    profiles = {}
    for k in table.multi_command_moves:
        start_times_s = parameters.start_times_s[table.commands_of(k)]
        log_acceleration = float(parameters.log_acceleration[table.axis[k]])
        profiles[k] = table.moves[k].profile(start_times_s, parameters.log_speed, log_acceleration)
    pan, tilt = (_TrajectoryBuilder(table, axis) for axis in (0, 1))
    return pan.build(parameters, profiles), tilt.build(parameters, profiles)


class _TrajectoryBuilder:
    """Builds the segments of one axis: the first rest, then move by move."""

    def __init__(self, table: MoveTable, axis: int) -> None:
        self._table, self._axis, self._axis_moves = table, axis, table.moves_of_axis[axis]

    def build(
        self, parameters: MotionParameters, profiles: Mapping[int, MotionProfile]
    ) -> Trajectory:
        """Return the trajectory of the axis."""
        table, axis_moves = self._table, self._axis_moves
        segment_counts = np.array(
            [profiles[k].start_s.size if k in profiles else SEGMENTS for k in axis_moves], dtype=int
        )
        first = 1 + np.cumsum(segment_counts) - segment_counts
        size = 1 + int(segment_counts.sum())
        self.start_s = np.full(size, FIRST_REST_START_S)
        self.move = np.repeat(
            np.concatenate([[-1], axis_moves]), np.concatenate([[1], segment_counts])
        )
        # Steps, share, then the derivatives by speed, acceleration and base speed.
        self.polynomials = np.zeros((5, 3, size))
        self.polynomials[0, 0, 0] = table.initial_steps[self._axis]
        is_single = table.has_single_command[axis_moves]
        self._add_single_command_moves(parameters, axis_moves[is_single], first[is_single])
        for k, first_segment in zip(axis_moves[~is_single], first[~is_single], strict=True):
            self._add_profile(int(k), profiles[int(k)], int(first_segment))
        begin_s, end_s = self.start_s[first], self.start_s[first + segment_counts - 1]
        for counted_s, axis, count in table.count_resets:
            if axis == self._axis:
                self._add_count_reset(counted_s, count)
        self._add_rest_offsets(parameters.rest_offset_steps)
        # A move ends at the latest when the next one starts.
        start_s = np.minimum.accumulate(self.start_s[::-1])[::-1]
        is_moving = (self.polynomials[0, 1] != 0.0) | (self.polynomials[0, 2] != 0.0)
        steps, progress, by_speed, by_acceleration, by_base_speed = self.polynomials
        return Trajectory(
            start_s,
            self.move,
            is_moving,
            steps,
            progress,
            by_speed,
            by_acceleration,
            by_base_speed,
            axis_moves,
            begin_s,
            end_s,
        )

    def _add_single_command_moves(
        self, parameters: MotionParameters, moves: IntArray, first: IntArray
    ) -> None:
        table = self._table
        distance = table.to_steps[moves] - table.from_steps[moves]
        trapezoids = TrapezoidalMoves.of(
            np.abs(distance),
            table.speed_steps_s[moves] * np.exp(parameters.log_speed[table.speed_class[moves]]),
            table.acceleration_steps_s2[moves]
            * float(np.exp(parameters.log_acceleration[self._axis])),
            table.base_speed_steps_s[moves],
        )
        segments = first + np.arange(SEGMENTS)[:, None]
        self.start_s[segments] = (
            parameters.start_times_s[table.first_command[moves]] + trapezoids.segment_start_s
        )
        sign = np.sign(distance)
        steps = trapezoids.position
        self.polynomials[0][:, segments] = sign * steps
        self.polynomials[0, 0, segments] += table.from_steps[moves]
        self.polynomials[1][:, segments] = steps / np.abs(distance)
        self.polynomials[2][:, segments] = sign * trapezoids.by_speed
        self.polynomials[3][:, segments] = sign * trapezoids.by_acceleration
        self.polynomials[4][:, segments] = sign * trapezoids.by_base_speed

    def _add_profile(self, k: int, profile: MotionProfile, first: int) -> None:
        """Add a move with several commands."""
        segments = slice(first, first + profile.start_s.size)
        self.start_s[segments] = profile.start_s
        half_acceleration = 0.5 * profile.acceleration_steps_s2
        self.polynomials[0][:, segments] = (
            profile.start_steps,
            profile.start_speed_steps_s,
            half_acceleration,
        )
        # An axis does not reverse within a segment.
        sign = np.where(
            profile.start_speed_steps_s != 0.0,
            np.sign(profile.start_speed_steps_s),
            np.sign(half_acceleration),
        )
        self.polynomials[1][:, segments] = (
            profile.distance_steps,
            sign * profile.start_speed_steps_s,
            sign * half_acceleration,
        )
        self.polynomials[1][:, segments] /= max(float(profile.distance_steps[-1]), 1e-12)

    def _add_count_reset(self, counted_s: float, steps: int) -> None:
        """Insert a rest with a new count, because the axis was homed."""
        current_move = int(self.move[np.searchsorted(self.start_s, counted_s, side="right") - 1])
        position = int(np.searchsorted(self.move, current_move, side="right"))
        self.start_s = np.insert(self.start_s, position, counted_s)
        self.move = np.insert(self.move, position, current_move)
        rest = np.zeros((len(self.polynomials), 3))
        rest[0, 0], rest[1, 0] = steps, float(current_move >= 0)
        self.polynomials = np.insert(self.polynomials, position, rest, axis=2)

    def _add_rest_offsets(self, rest_offset_steps: FloatArray) -> None:
        """Add the offsets of the rests, interpolated along each move."""
        table = self._table
        offset = np.full(self.move.size, rest_offset_steps[table.first_rest(self._axis)])
        change = np.zeros(self.move.size)
        has_move = self.move >= 0
        moves = self.move[has_move]
        offset[has_move] = rest_offset_steps[table.departure[moves]]
        change[has_move] = rest_offset_steps[table.arrival[moves]] - offset[has_move]
        self.polynomials[0] += change * self.polynomials[1]
        self.polynomials[0, 0] += offset
