"""Trajectory of an axis whose controller rounds the corners of the speed ramps.

The position is the mean of the planned position over a duration L about each instant, as in
`model.causes.s_curve`. The mean of a polynomial trajectory has a closed form: its integral is a
polynomial of the third degree in each segment.

What to use when: `build_executed_trajectories` for both axes under a motion law;
`RoundedTrajectory.of` for a planned trajectory. It is sampled in the same way as a planned one.
"""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.unit.axis_trajectory import (
    SampledTrajectory,
    Trajectory,
    build_trajectories,
)
from gyrorig_solver.reference.unit.motion_law import MotionLaw
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable

MIN_CORNER_S = 1e-5  # differences of integrals over shorter times are rounding errors


@dataclass(frozen=True, slots=True, eq=False)
class RoundedTrajectory(Trajectory):
    """A planned trajectory with rounded corners; its polynomials are those of the plan."""

    corner_s: float

    @classmethod
    def of(cls, planned: Trajectory, corner_s: float) -> Trajectory:
        """Return a trajectory with rounded corners; `planned` if `corner_s` is negligible."""
        if corner_s <= MIN_CORNER_S:
            return planned
        values = {field.name: getattr(planned, field.name) for field in fields(Trajectory)}
        # A move starts half a duration before its plan and ends half a duration after it.
        values["begin_s"] = planned.begin_s - corner_s / 2.0
        values["end_s"] = planned.end_s + corner_s / 2.0
        return cls(**values, corner_s=corner_s)

    def sample(self, time_s: FloatArray) -> SampledTrajectory:
        """Return the trajectory at times in any order."""
        early, middle, late = (
            self._segment_at(time_s + shift * self.corner_s) for shift in (-0.5, 0.0, 0.5)
        )
        return RoundedSample(
            self, middle, time_s - self.start_s[middle], self.corner_s, time_s, early, late
        )

    def sample_sorted(self, time_s: FloatArray) -> SampledTrajectory:
        """Return the trajectory at sorted times."""
        return self.sample(time_s)

    def _segment_at(self, time_s: FloatArray) -> IntArray:
        segment = np.searchsorted(self.start_s, time_s, side="right") - 1
        return np.maximum(segment, 0).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class RoundedSample(SampledTrajectory):
    """A trajectory with rounded corners at given times."""

    corner_s: float
    time_s: FloatArray  # (n,)
    early: IntArray  # (n,), the segment at the beginning of the mean
    late: IntArray  # (n,), the segment at its end

    def subset(self, selection: BoolArray | IntArray | slice) -> Self:
        """Return the selected times."""
        return type(self)(
            self.trajectory,
            self.segment[selection],
            self.since_s[selection],
            self.corner_s,
            self.time_s[selection],
            self.early[selection],
            self.late[selection],
        )

    @property
    def move(self) -> IntArray:
        """The current or last move; it starts half the duration before its plan."""
        return self.trajectory.move[self.late]

    @property
    def speed_steps_s(self) -> FloatArray:
        """Signed speed."""
        early, late = self._ends(self.trajectory.steps)
        return np.asarray((late - early) / self.corner_s, dtype=np.float64)

    @property
    def progress(self) -> FloatArray:
        """Covered share of the move, 0 to 1."""
        # The mean about the beginning of a move contains the previous rest, in which the share of
        # the previous move is 1. Whole moves are added, so that the share increases from move to
        # move.
        trajectory = self.trajectory
        number = np.concatenate([[0], np.cumsum(np.diff(trajectory.move) != 0)]).astype(np.float64)
        number -= trajectory.move >= 0
        whole = trajectory.progress.copy()
        whole[0] += number
        return np.asarray(self._value(whole) - number[self.late], dtype=np.float64)

    @property
    def by_corner(self) -> FloatArray:
        """Derivative of the position by the duration of the mean, steps/s."""
        early, late = self._ends(self.trajectory.steps)
        return np.asarray((0.5 * (early + late) - self.steps) / self.corner_s, dtype=np.float64)

    def _ends(self, polynomial: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a polynomial at the beginning and at the end of the mean."""
        half = 0.5 * self.corner_s
        start_s = self.trajectory.start_s
        pairs = ((self.early, self.time_s - half), (self.late, self.time_s + half))
        early, late = (
            _evaluate(polynomial, segment, at_s - start_s[segment]) for segment, at_s in pairs
        )
        return early, late

    def _value(self, polynomial: FloatArray) -> FloatArray:
        """Return the mean of a polynomial about each time."""
        start_s = self.trajectory.start_s
        integral = np.vstack([np.zeros(start_s.size), polynomial / [[1.0], [2.0], [3.0]]])
        # The first rest has no beginning, so its integral starts at its end.
        first_s = start_s[min(1, start_s.size - 1)]
        begin_s = np.concatenate([[first_s], start_s[1:]])
        width_s = np.diff(begin_s)
        rises = _evaluate(integral, np.arange(width_s.size), width_s)
        integral[0] = np.concatenate([[0.0], np.cumsum(rises)])
        half = 0.5 * self.corner_s
        early = _evaluate(integral, self.early, self.time_s - half - begin_s[self.early])
        late = _evaluate(integral, self.late, self.time_s + half - begin_s[self.late])
        return np.asarray((late - early) / self.corner_s, dtype=np.float64)


def _evaluate(polynomial: FloatArray, segment: IntArray, since_s: FloatArray) -> FloatArray:
    value = polynomial[-1].take(segment)
    for coefficient in polynomial[-2::-1]:
        value = value * since_s + coefficient.take(segment)
    return np.asarray(value, dtype=np.float64)


def build_executed_trajectories(
    table: MoveTable, parameters: MotionParameters, law: MotionLaw
) -> tuple[Trajectory, Trajectory]:
    """Return the trajectories of pan and tilt under a motion law."""
    pan, tilt = build_trajectories(table, parameters)
    return (
        RoundedTrajectory.of(pan, law.corner_s[0]),
        RoundedTrajectory.of(tilt, law.corner_s[1]),
    )
