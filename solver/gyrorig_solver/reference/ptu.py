"""The pan-tilt unit as the reference: the moves it was told, timed by its answers.

Unknowns, each held by what the polls know of it and fitted with the board's own parameters:

- when each order took hold: one for each move, one more for each change on the way;
- where the stage stands at each rest: the count's rest and what a detent adds to it;
- where the count has each rest, inside the one step that it names: known by polls only;
- the speed of each class of orders told the same speed, and each axis' acceleration
  (the polls see them to 1e-4: a timer cannot make every speed);
- how the counts follow the motion, their offset, lag and share of a delay: by polls only.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, cast

import numpy as np
from scipy.sparse import csc_array, diags_array

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.arrow import Arrow, eliminate
from gyrorig_solver.reference.columns import AxisColumns
from gyrorig_solver.reference.course import Course
from gyrorig_solver.reference.kinematics import AxisTurn
from gyrorig_solver.reference.motion import Evaluated, LocalColumn
from gyrorig_solver.reference.moves import Motion
from gyrorig_solver.reference.polls import LOG_ACCELERATION_STD, StartTimes
from gyrorig_solver.reference.table import Unknowns
from gyrorig_solver.reference.track import Track, lay_tracks

SAYS_MORE = 0.5  # of a prior deviation: what is known better than so is known by the answers
OWN_LAW = 0.005  # polls so much less sure: 50 us become 10 ms


@dataclass(frozen=True, eq=False)
class PtuReference:
    """Pan and tilt over time. Unknowns in order: see `StartTimes.information`."""

    motion: Motion
    starts: StartTimes
    rad_per_step: tuple[float, float]  # pan and tilt, with the sign of the unit
    shift: FloatArray  # unknowns minus what the polls say
    span_s: tuple[float, float]  # where the polls saw the unit
    own_law: bool = False  # the axes move by another law than the polls were read with

    @classmethod
    def of(
        cls,
        motion: Motion,
        starts: StartTimes,
        rad_per_step: tuple[float, float],
        span_s: tuple[float, float],
    ) -> Self:
        """Return the reference at what the polls say."""
        return cls(motion, starts, rad_per_step, np.zeros(sum(starts.information.size)), span_s)

    @cached_property
    def information(self) -> Arrow:
        """What the polls know of the unknowns.

        Counts follow what the controller does. Read by another law than its own they say a
        little wrong, and very surely, when moves began, how fast they were and how fast they
        sped up: then these are believed less, and the samples tell.
        """
        told = self.starts.information
        if not self.own_law:
            return told
        table = self.starts.table
        local, shared = np.ones(told.size[0]), np.ones(told.size[1])
        local[: table.starts] = shared[: table.classes + 2] = OWN_LAW
        scale = diags_array(local)
        return Arrow(
            csc_array(scale @ told.local @ scale),
            local[:, None] * told.cross * shared,
            shared[:, None] * told.shared * shared,
        )

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        count = len(self.starts.table.moves)
        return f"{count} moves as the pan-tilt unit was told, timed by its answers"

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

    def by_own_law(self, own: bool) -> Self:
        """Return the reference with its polls believed, or not so much: see `information`."""
        return self if own == self.own_law else replace(self, own_law=own)

    def angles_rad(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at times that do not decrease, shape (2, n)."""
        steps = np.stack([track.along(time_s).steps for track in self._tracks])
        return np.asarray(steps * np.array(self.rad_per_step)[:, None], dtype=np.float64)

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> Evaluated:
        """Return mean stage rates between `edges_s` and, if asked, their derivatives."""
        spots = [track.along(edges_s) for track in self._tracks]
        angle = np.stack([s.steps * r for s, r in zip(spots, self.rad_per_step, strict=True)])
        rate, turn = AxisTurn.along(angle, edges_s, self.rad_per_step)
        rate[~self._known(edges_s)] = np.nan
        if not derivatives:
            return Evaluated(rate, (), np.zeros((0, len(rate), 3)))
        table = self.starts.table
        shared = np.zeros((table.classes + 2, len(rate), 3))
        local: list[LocalColumn] = []
        for axis in (0, 1):
            columns = AxisColumns(axis, table, self._found, spots[axis], edges_s, turn)
            local += [*columns.starts(shared), *columns.rests()]
        return Evaluated(rate, tuple(sorted(local, key=lambda column: column.unknown)), shared)

    @cached_property
    def log_acceleration(self) -> tuple[FloatArray, FloatArray]:
        """How far pan's and tilt's ramps are from told, as a logarithm, and its deviation.

        By the answers alone: what else a model lacks pulls at the ramps of its fit. The
        deviation is inf where they say nothing beyond what was known beforehand.
        """
        table = self.starts.table
        beside = eliminate(self.information, np.zeros(sum(self.information.size))).information
        at = slice(table.classes, table.classes + 2)
        std = np.sqrt(np.diag(np.linalg.inv(beside))[at])
        held = LOG_ACCELERATION_STD / (OWN_LAW if self.own_law else 1.0)
        found = self.starts.found.log_acceleration
        return found, np.where(std < SAYS_MORE * held, std, np.inf)

    @cached_property
    def courses(self) -> tuple[tuple[int, Course], ...]:
        """Axis and course of every move, as the unknowns of now have it, counted steps."""
        found = self._found
        log_ramp = cast("tuple[float, float]", tuple(float(v) for v in found.log_acceleration))
        courses, first = [], 0
        for move in self.starts.table.moves:
            own = slice(first, first + len(move.orders))
            first = own.stop
            course = move.course(found.starts_s[own], found.log_speed, log_ramp[move.axis])
            courses.append((move.axis, course))
        return tuple(courses)

    @cached_property
    def _tracks(self) -> tuple[Track, Track]:
        return lay_tracks(self.starts.table, self._found)

    @cached_property
    def _found(self) -> Unknowns:
        """The unknowns of now, as the stage has them."""
        table, found, shift = self.starts.table, self.starts.found, self.shift
        rest, counted = table.starts, table.starts + table.rests
        speed = counted + table.rests
        ramp = speed + table.classes
        return Unknowns(
            found.starts_s + shift[:rest],
            found.rest_steps + shift[rest:counted],
            found.log_speed + shift[speed:ramp],
            found.log_acceleration + shift[ramp : ramp + 2],
        )

    def _known(self, edges_s: FloatArray) -> BoolArray:
        """Return True for each interval in which the motion is known from the commands."""
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.motion.unknown:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)
