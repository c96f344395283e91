"""Reference motion of a pan-tilt unit from its commands, timed by its position replies.

The unknowns have a prior from the polls and are fitted with the parameters of the board:

- the start time of each command, one per move and one per command in motion;
- the position of the stage at each rest: the counted rest plus an offset of the detent;
- the position of the count at each rest, inside its step, from polls only;
- the speed of each class of commands with the same speed, and the acceleration of each axis
  (the polls determine them to 1e-4);
- the relation of counts and motion, their offset, lag and share of a delay, from polls only.

The unit can follow another motion law than that of the recorded settings. Then the unknowns are
relative to the fit of the replies under that law, and the replies have information about its
values. The planned motion stays that of the settings, because the causes in the model change it;
`executed` is the motion under the law.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, cast

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.numerics import ArrowheadMatrix, eliminate_local
from gyrorig_solver.reference.reference_motion import EvaluatedMotion, LocalDerivative
from gyrorig_solver.reference.unit.axis_trajectory import Trajectory
from gyrorig_solver.reference.unit.law_fit import LawFit, LawFits
from gyrorig_solver.reference.unit.law_information import LawProfile
from gyrorig_solver.reference.unit.motion_law import (
    LAW_VALUES,
    RECORDED_LAW,
    MotionLaw,
    law_scale,
)
from gyrorig_solver.reference.unit.motion_profile import MotionProfile
from gyrorig_solver.reference.unit.move_derivatives import AxisDerivatives
from gyrorig_solver.reference.unit.move_fit import LOG_ACCELERATION_PRIOR_STD, MoveFit
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.rounded_trajectory import build_executed_trajectories
from gyrorig_solver.reference.unit.stage_kinematics import StageRateJacobian
from gyrorig_solver.reference.unit.unit_moves import UnitMotion

# of a prior standard deviation; with a smaller ratio, the replies determine a value
MAX_KNOWN_STD_RATIO = 0.5


@dataclass(frozen=True, eq=False)
class PanTiltReference:
    """Pan and tilt over time. Unknowns in order: see `MoveFit.information`."""

    motion: UnitMotion
    move_fit: MoveFit  # with the recorded settings
    rad_per_step: tuple[float, float]  # of pan and tilt, with the sign of the unit
    deviation: FloatArray  # unknowns minus their values from the polls under the law
    span_s: tuple[float, float]  # time span of the polls
    law_fits: LawFits
    law: MotionLaw = RECORDED_LAW
    follows_law: bool = False  # whether angles and rates are those under the law

    @classmethod
    def of(
        cls,
        motion: UnitMotion,
        move_fit: MoveFit,
        rad_per_step: tuple[float, float],
        span_s: tuple[float, float],
    ) -> Self:
        """Return the reference at the values from the polls."""
        deviation = np.zeros(sum(move_fit.information.size))
        return cls(motion, move_fit, rad_per_step, deviation, span_s, LawFits(move_fit))

    @property
    def information(self) -> ArrowheadMatrix:
        """Information of the polls about the unknowns, under the law."""
        return self._polled_fit.information

    def law_profile(self, law_values: IntArray) -> LawProfile:
        """Return the information of the polls about some values of the law.

        The units are those of `MotionLaw.of_values`. `law_values`: their positions, shape (k,).

        Raises:
            ValueError: the law is that of the settings.
        """
        scale = law_scale(self.rad_per_step)
        information = self._law_fit.information.scaled(scale).subset(law_values)
        return LawProfile.of(information, self.information)

    @property
    def cost(self) -> float:
        """The negative log-likelihood of the polls, nats; zero at the fit with the settings."""
        deviation = self.deviation
        cost = 0.5 * float(deviation @ self.information.multiply(deviation))
        if self.law.is_recorded:
            return cost
        return cost + self._law_fit.cost - self.law_fits.recorded_cost

    def cost_decrease(self, after: "PanTiltReference") -> float:
        """Return the decrease of the cost by a step, with current weights of the polls, nats."""
        if self.law.is_recorded:
            return self.cost - after.cost
        objective, table = self._law_fit.objective, self.move_fit.table
        before_cost, after_cost = (
            objective.cost(
                table,
                reference._polled_fit.values + reference.deviation,
                reference.law,
                reference._law_fit.objective.prior,
            )
            for reference in (self, after)
        )
        return before_cost - after_cost

    @property
    def description(self) -> str:
        """One sentence on the reference."""
        count = len(self.move_fit.table.moves)
        return f"{count} commanded moves of the pan-tilt unit, timed by its position replies"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on this reference."""
        messages = [
            f"the unit's motion is unknown for some time, because {reason}"
            for _, _, reason in self.motion.unknown_spans
        ]
        if not self.move_fit.counts_follow_commands:
            messages.append(
                "the positions of the unit do not follow the commands; check for lost steps"
            )
        return tuple(dict.fromkeys(messages))

    @property
    def prior_offset(self) -> FloatArray:
        """Prior mean minus current values."""
        return -self.deviation

    @property
    def common_shift_std_s(self) -> float:
        """Uncertainty of the sampling time inside the shortest poll."""
        return self.move_fit.common_shift_std_s

    @property
    def is_differentiated(self) -> bool:
        """False, because the profile has no noise."""
        return False

    def with_step(self, step: FloatArray) -> Self:
        """Return the reference with its unknowns changed by `step`."""
        return replace(self, deviation=self.deviation + step)

    def with_law(self, law: MotionLaw) -> Self:
        """Return the reference under a motion law; the moves follow the polls under it."""
        return self if law == self.law else replace(self, law=law)

    @cached_property
    def executed(self) -> Self:
        """The reference whose angles and rates are those under the law."""
        return self if self.law.is_recorded else replace(self, follows_law=True)

    def angles_rad(self, time_s: FloatArray) -> FloatArray:
        """Return pan and tilt at sorted times, shape (2, n)."""
        steps = np.stack(
            [trajectory.sample_sorted(time_s).steps for trajectory in self._trajectories]
        )
        return np.asarray(steps * np.array(self.rad_per_step)[:, None], dtype=np.float64)

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> EvaluatedMotion:
        """Return mean stage rates between `edges_s` and, if requested, their derivatives."""
        samples = [trajectory.sample_sorted(edges_s) for trajectory in self._trajectories]
        angle = np.stack(
            [sampled.steps * r for sampled, r in zip(samples, self.rad_per_step, strict=True)]
        )
        rate, jacobian = StageRateJacobian.of_angles(angle, edges_s, self.rad_per_step)
        rate[~self._known_intervals(edges_s)] = np.nan
        if not derivatives:
            return EvaluatedMotion(rate, (), np.zeros((0, len(rate), 3)))
        table = self._table
        shared = np.zeros((table.speed_class_count + 2, len(rate), 3))
        law = np.zeros((LAW_VALUES if self.follows_law else 0, len(rate), 3))
        local: list[LocalDerivative] = []
        for axis in (0, 1):
            derivatives_of_axis = AxisDerivatives(
                axis, table, self._parameters, samples[axis], edges_s, jacobian
            )
            local += [*derivatives_of_axis.by_starts(shared), *derivatives_of_axis.by_rests()]
            if self.follows_law:
                derivatives_of_axis.add_by_law(law, self.law)
        if self.follows_law:
            law *= law_scale(self.rad_per_step)[:, None, None]
        return EvaluatedMotion(
            rate, tuple(sorted(local, key=lambda column: column.unknown)), shared, law
        )

    @cached_property
    def log_acceleration(self) -> tuple[FloatArray, FloatArray]:
        """Logarithms of fitted over commanded acceleration, and their standard deviations.

        They are from the replies alone, because other model errors change the accelerations of a
        fit. The standard deviation is inf if the replies do not improve on the prior.
        """
        table = self.move_fit.table
        shared_information = eliminate_local(
            self.information, np.zeros(sum(self.information.size))
        ).information
        accelerations = slice(table.speed_class_count, table.speed_class_count + 2)
        std = np.sqrt(np.diag(np.linalg.inv(shared_information))[accelerations])
        estimate = self._polled_fit.parameters.log_acceleration
        is_known = std < MAX_KNOWN_STD_RATIO * LOG_ACCELERATION_PRIOR_STD
        return estimate, np.where(is_known, std, np.inf)

    @property
    def start_delays_s(self) -> FloatArray:
        """The time from each command to the start of its motion under the law, by the polls."""
        return np.asarray(
            self._polled_fit.parameters.start_times_s - self.move_fit.table.command_times_s,
            dtype=np.float64,
        )

    @cached_property
    def profiles(self) -> tuple[tuple[int, MotionProfile], ...]:
        """Axis and profile of every move at the current values, in counted steps."""
        parameters = self._parameters
        log_acceleration = cast(
            "tuple[float, float]", tuple(float(v) for v in parameters.log_acceleration)
        )
        profiles, first = [], 0
        for move in self.move_fit.table.moves:
            command_range = slice(first, first + len(move.commands))
            first = command_range.stop
            profile = move.profile(
                parameters.start_times_s[command_range],
                parameters.log_speed,
                log_acceleration[move.axis],
            )
            profiles.append((move.axis, profile))
        return tuple(profiles)

    @cached_property
    def _trajectories(self) -> tuple[Trajectory, Trajectory]:
        law = self.law if self.follows_law else RECORDED_LAW
        return build_executed_trajectories(self._table, self._parameters, law)

    @cached_property
    def _table(self) -> MoveTable:
        """The moves; with the limits of the law if the reference follows it."""
        table = self.move_fit.table
        return table.with_law(self.law) if self.follows_law else table

    @property
    def _polled_fit(self) -> MoveFit:
        """The fit of the polls under the law."""
        return self.move_fit if self.law.is_recorded else self._law_fit.fit

    @property
    def _law_fit(self) -> LawFit:
        return self.law_fits.at(self.law)

    @cached_property
    def _parameters(self) -> MotionParameters:
        """The current parameters, with the rests of the stage."""
        table, fitted, deviation = self.move_fit.table, self._polled_fit.parameters, self.deviation
        rest, counted = table.command_count, table.command_count + table.rest_count
        speed = counted + table.rest_count
        acceleration = speed + table.speed_class_count
        return MotionParameters(
            fitted.start_times_s + deviation[:rest],
            fitted.rest_offset_steps + deviation[rest:counted],
            fitted.log_speed + deviation[speed:acceleration],
            fitted.log_acceleration + deviation[acceleration : acceleration + 2],
        )

    def _known_intervals(self, edges_s: FloatArray) -> BoolArray:
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.motion.unknown_spans:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)
