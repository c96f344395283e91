"""Reference motion of a pan-tilt unit from its commands, timed by its position replies.

The unknowns have a prior from the polls and are fitted with the parameters of the board:

- the start time of each command, one per move and one per command in motion;
- the position of the stage at each rest: the counted rest plus an offset of the detent;
- the position of the count at each rest, inside its step, from polls only;
- the speed of each class of commands with the same speed, and the acceleration of each axis
  (the polls determine them to 1e-4);
- the relation of counts and motion, their offset, lag and share of a delay, from polls only.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self, cast

import numpy as np
from scipy.sparse import csc_array, diags_array

from gyrorig_solver.data.arrays import BoolArray, FloatArray
from gyrorig_solver.numerics.arrowhead import ArrowheadMatrix, eliminate_local
from gyrorig_solver.reference.reference_motion import EvaluatedMotion, LocalDerivative
from gyrorig_solver.reference.unit.axis_trajectory import Trajectory, build_trajectories
from gyrorig_solver.reference.unit.motion_profile import MotionProfile
from gyrorig_solver.reference.unit.move_derivatives import AxisDerivatives
from gyrorig_solver.reference.unit.move_fit import LOG_ACCELERATION_PRIOR_STD, MoveFit
from gyrorig_solver.reference.unit.move_table import MotionParameters
from gyrorig_solver.reference.unit.stage_kinematics import StageRateJacobian
from gyrorig_solver.reference.unit.unit_moves import UnitMotion

MAX_KNOWN_STD_RATIO = 0.5  # of a prior standard deviation; below it the replies determine a value
POLL_DOWNWEIGHT = 0.005  # of the information of the polls: 50 us become 10 ms


@dataclass(frozen=True, eq=False)
class PanTiltReference:
    """Pan and tilt over time. Unknowns in order: see `MoveFit.information`."""

    motion: UnitMotion
    move_fit: MoveFit
    rad_per_step: tuple[float, float]  # of pan and tilt, with the sign of the unit
    deviation: FloatArray  # unknowns minus their values from the polls
    span_s: tuple[float, float]  # time span of the polls
    polls_downweighted: bool = False  # the axes follow another motion law than that of the poll fit

    @classmethod
    def of(
        cls,
        motion: UnitMotion,
        move_fit: MoveFit,
        rad_per_step: tuple[float, float],
        span_s: tuple[float, float],
    ) -> Self:
        """Return the reference at the values from the polls."""
        return cls(motion, move_fit, rad_per_step, np.zeros(sum(move_fit.information.size)), span_s)

    @cached_property
    def information(self) -> ArrowheadMatrix:
        """Information of the polls about the unknowns.

        If the axes follow another motion law than that of the poll fit, the fitted start times,
        speeds and accelerations have a small error with a very small uncertainty. Then they get
        less weight, and the samples determine them.
        """
        poll_information = self.move_fit.information
        if not self.polls_downweighted:
            return poll_information
        table = self.move_fit.table
        local, shared = np.ones(poll_information.size[0]), np.ones(poll_information.size[1])
        local[: table.command_count] = shared[: table.speed_class_count + 2] = POLL_DOWNWEIGHT
        scale = diags_array(local)
        return ArrowheadMatrix(
            csc_array(scale @ poll_information.local @ scale),
            local[:, None] * poll_information.cross * shared,
            shared[:, None] * poll_information.shared * shared,
        )

    @property
    def description(self) -> str:
        """One sentence on the reference."""
        count = len(self.move_fit.table.moves)
        return f"{count} commanded moves of the pan-tilt unit, timed by its position replies"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on this reference."""
        messages = [
            f"the motion is unknown for some time, because {reason}"
            for _, _, reason in self.motion.unknown_spans
        ]
        if not self.move_fit.counts_follow_commands:
            messages.append("the polled positions do not follow the commands; check for lost steps")
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

    def with_polls_downweighted(self, downweighted: bool) -> Self:
        """Return the reference with or without downweighted polls; see `information`."""
        return (
            self
            if downweighted == self.polls_downweighted
            else replace(self, polls_downweighted=downweighted)
        )

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
        table = self.move_fit.table
        shared = np.zeros((table.speed_class_count + 2, len(rate), 3))
        local: list[LocalDerivative] = []
        for axis in (0, 1):
            derivatives_of_axis = AxisDerivatives(
                axis, table, self._parameters, samples[axis], edges_s, jacobian
            )
            local += [*derivatives_of_axis.by_starts(shared), *derivatives_of_axis.by_rests()]
        return EvaluatedMotion(
            rate, tuple(sorted(local, key=lambda column: column.unknown)), shared
        )

    @cached_property
    def log_acceleration(self) -> tuple[FloatArray, FloatArray]:
        """Logarithms of fitted over commanded acceleration, and their standard deviations.

        From the replies alone, because other model errors change the accelerations of a fit. The
        standard deviation is inf if the replies do not improve on the prior.
        """
        table = self.move_fit.table
        shared_information = eliminate_local(
            self.information, np.zeros(sum(self.information.size))
        ).information
        accelerations = slice(table.speed_class_count, table.speed_class_count + 2)
        std = np.sqrt(np.diag(np.linalg.inv(shared_information))[accelerations])
        prior_std = LOG_ACCELERATION_PRIOR_STD / (
            POLL_DOWNWEIGHT if self.polls_downweighted else 1.0
        )
        estimate = self.move_fit.parameters.log_acceleration
        return estimate, np.where(std < MAX_KNOWN_STD_RATIO * prior_std, std, np.inf)

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
        return build_trajectories(self.move_fit.table, self._parameters)

    @cached_property
    def _parameters(self) -> MotionParameters:
        """The current parameters, with the rests of the stage."""
        table, fitted, deviation = self.move_fit.table, self.move_fit.parameters, self.deviation
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
        """Return the mask of intervals with known motion."""
        begin, end = edges_s[:-1], edges_s[1:]
        known = (begin >= self.span_s[0]) & (end <= self.span_s[1])
        for lost_begin, lost_end, _ in self.motion.unknown_spans:
            known &= (end < lost_begin) | (begin > lost_end)
        return np.asarray(known, dtype=np.bool_)
