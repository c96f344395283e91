"""Fit of start times, rests, speeds and accelerations to the polled counts.

A poll states that the count was c at some time between the last byte of the request and the first
byte of the reply. The model of both errors is: the count is uniform over one step, and the
sampling time is lo + W_min/2 + phi (W - W_min). Here W is the width of the window, and phi
(fitted) is the share of the extra delay before the sample. The smallest width W_min leaves one
constant that no poll can determine, uniform with the standard deviation W_min/sqrt(12). It
only adds to the uncertainty of the time offset. The counter of a controller replaces all
windows by one (see `controller_counter`).

A controller can count a step at its beginning or at its end. Therefore the count can lag behind the
motion, and can be truncated instead of rounded, by up to half a step; both are fitted. If all moves
have one speed, the lag cannot be separated from late starts, and the covariance of the start times
shows this.

Speed and acceleration are also fitted, each with a tight prior at the commanded value, because
the timer of a controller has a finite resolution (about 0.1 % of a speed).

A rest can be anywhere within its count, because a unit can round a target. The polls in motion
determine it, and the variance of the rests is chosen by the likelihood of all polls (see
`rest_variance`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.numerics import ArrowheadMatrix
from gyrorig_solver.reference.unit.axis_trajectory import Trajectory, build_trajectories
from gyrorig_solver.reference.unit.law_information import LawInformation
from gyrorig_solver.reference.unit.motion_law import LAW_VALUES, RECORDED_LAW, MotionLaw
from gyrorig_solver.reference.unit.move_equations import BandedNormalEquations
from gyrorig_solver.reference.unit.move_table import MotionParameters, MoveTable
from gyrorig_solver.reference.unit.poll_likelihood import (
    COUNT_PARAMETERS,
    STEP_VARIANCE,
    AxisCounts,
    CountParameters,
    PollLikelihood,
)
from gyrorig_solver.reference.unit.poll_objective import GaussianWeights, PollObjective
from gyrorig_solver.reference.unit.rest_variance import add_detent_offsets, likeliest_rest_variance
from gyrorig_solver.reference.unit.start_delays import initial_delays
from gyrorig_solver.reference.unit.unit_moves import Move, UnitMotion, with_start_times

LOG_SPEED_PRIOR_STD = 1e-2
LOG_ACCELERATION_PRIOR_STD = 1e-2
FIXED_LOG_STD = 1e-6  # of a logarithm, practically fixed
COUNT_PRIOR_STD_STEPS = 0.5  # of the lag and the offset of the count
DELAY_SHARE_PRIOR_STD = 0.3  # of phi, about one half
POLLED_START_PRIOR_STD_S = 1.0  # of a polled start, practically free
UNPOLLED_START_PRIOR_STD_S = 0.02  # of other starts, relative to the delay of the polled ones
INITIAL_ERROR_S = 0.2  # largest error of the initial delays
MAX_ITERATIONS = 8
MAX_STEP_FOR_VARIANCE_S = 5e-3  # largest step of the starts before the rest variance is estimated
LAST_VARIANCE_ITERATION = 3  # from this iteration on, the rest variance is estimated in any case
VARIANCE_ESTIMATES = 2
CONVERGENCE_S = 5e-7  # rms step of the starts, a hundredth of their uncertainty


@dataclass(frozen=True, slots=True, eq=False)
class UnitPolls:
    """Polled counts of one recording; times in s on the capture clock."""

    earliest_s: FloatArray  # (n,), earliest sampling time
    latest_s: FloatArray  # (n,), latest sampling time
    steps: FloatArray  # (n, 2), pan and tilt
    valid: BoolArray  # (n, 2), True if the reply contains the axis
    constant_width_s: float = 0.0  # common error of all times, up to half of this

    def count_at_rest(self, axis: int, after_s: float, before_s: float) -> int | None:
        """Return the median count of an axis between two times, None without polls."""
        first, last = np.searchsorted(self.earliest_s, [after_s, before_s], side="right")
        candidates = slice(int(first), int(last))
        inside = (self.latest_s[candidates] < before_s) & self.valid[candidates, axis]
        counts = self.steps[candidates, axis][inside]
        if counts.size < 2:
            return None
        ordered, middle = np.sort(counts), counts.size // 2
        return round(float(ordered[(counts.size - 1) // 2] + ordered[middle]) / 2.0)


@dataclass(frozen=True, eq=False)
class MoveFit:
    """The fitted moves, with their information matrix."""

    table: MoveTable
    parameters: MotionParameters
    # Over starts, rests of the stage, rests of the count. Shared unknowns: log speeds, log
    # accelerations, offset and lag of the count, and phi.
    information: ArrowheadMatrix
    common_shift_std_s: float  # of a common shift of all starts, which polls cannot determine
    instant_std_s: float  # scatter of the sampling time inside its window
    count_parameters: CountParameters
    rest_variance: float  # of a rest about its count, steps^2
    counts_follow_commands: bool  # whether the counts agree with the commanded moves
    polls: UnitPolls | None = None  # the fitted polls

    @cached_property
    def values(self) -> FloatArray:
        """All unknowns, in the order of `information`."""
        rests = self.parameters.rest_offset_steps
        first = self.table.command_count
        return np.insert(self.count_values, first, rests)

    @cached_property
    def count_values(self) -> FloatArray:
        """The unknowns on which the counts depend: all but the rests of the stage."""
        fitted, count = self.parameters, self.count_parameters
        return np.concatenate(
            [
                fitted.start_times_s,
                fitted.rest_offset_steps,
                fitted.log_speed,
                fitted.log_acceleration,
                [count.offset_steps, count.lag_steps, count.delay_share],
            ]
        )

    @cached_property
    def moves(self) -> tuple[Move, ...]:
        """The moves with fitted starts."""
        return with_start_times(self.table.moves, self.parameters.start_times_s)


@dataclass(frozen=True, slots=True, eq=False)
class _UnknownLayout:
    """Slices of the unknowns: starts, rests, log speeds, log accelerations, count, phi."""

    starts: slice
    rests: slice
    speeds: slice
    accelerations: slice

    @classmethod
    def of(cls, table: MoveTable) -> "_UnknownLayout":
        rest = table.command_count
        speed = rest + table.rest_count
        acceleration = speed + table.speed_class_count
        return cls(
            slice(0, rest),
            slice(rest, speed),
            slice(speed, acceleration),
            slice(acceleration, acceleration + 2),
        )

    @property
    def size(self) -> int:
        return int(self.accelerations.stop) + COUNT_PARAMETERS

    def parameters(self, values: FloatArray) -> MotionParameters:
        return MotionParameters(
            values[self.starts], values[self.rests], values[self.speeds], values[self.accelerations]
        )


def fit_moves(motion: UnitMotion, polls: UnitPolls) -> MoveFit:
    """Fit starts, rests, speeds and accelerations to the polled counts.

    Gauss-Newton iteration. The weight of a poll contains the quantum of the count and the scatter
    of the sampling time at the current speed; the scatter is estimated from the residuals.
    """
    fit = MoveFitIteration(MoveTable.of(motion), polls)
    fit.iterate()
    return replace(fit.result(), polls=polls)


class MoveFitIteration:
    """The Gauss-Newton iteration of a fit of moves to the polled counts, under one motion law."""

    def __init__(
        self,
        table: MoveTable,
        polls: UnitPolls,
        law: MotionLaw | None = None,
        rest_variance: float | None = None,
    ) -> None:
        """Start at the initial delays.

        Args:
            table: of the moves, with the recorded settings.
            polls: of both axes.
            law: motion law that the unit executes; None: the recorded settings.
            rest_variance: of rests about their counts; None: estimated.
        """
        self._law = law or RECORDED_LAW
        self._table = table if self._law.is_recorded else table.with_law(self._law)
        table, self._layout = self._table, _UnknownLayout.of(table)
        self._counts, least_s = _counts_per_axis(polls)
        self._delays = _StartDelays(table, initial_delays(table, self._counts))
        self._prior_weight = _prior_weights(self._layout, self._delays.is_polled)
        for axis in np.flatnonzero(self._law.has_known_acceleration):
            self._prior_weight[self._layout.accelerations.start + axis] = FIXED_LOG_STD**-2
        self._prior_mean = np.zeros(self._layout.size)
        self._prior_mean[self._layout.starts] = self._delays.guess_s
        self._prior_mean[-1] = 0.5
        self._values = self._prior_mean.copy()
        tracks = build_trajectories(table, self._layout.parameters(self._values))
        pan, tilt = (
            _counts_near_moves(counts, track)
            for counts, track in zip(self._counts, tracks, strict=True)
        )
        self._counts = (pan, tilt)
        self._instant_std_s = max(least_s / float(np.sqrt(12.0)), 1e-6)
        self._common_shift_std_s = (least_s + polls.constant_width_s) / float(np.sqrt(12.0))
        self._poll_spacing_s: FloatArray | None = None
        self._law_information: LawInformation | None = None
        self._rest_variance = STEP_VARIANCE
        self._variance_estimates = 0
        self._start_change_s = np.inf
        if rest_variance is not None:
            self._rest_variance, self._variance_estimates = rest_variance, VARIANCE_ESTIMATES

    def iterate(self) -> None:
        """Take steps until convergence."""
        for iteration in range(MAX_ITERATIONS):
            self.step(iteration >= LAST_VARIANCE_ITERATION)
            if self.converged:
                break

    @property
    def converged(self) -> bool:
        """Whether the iteration has converged."""
        return (
            self._variance_estimates == VARIANCE_ESTIMATES and self._start_change_s < CONVERGENCE_S
        )

    def step(self, estimate_variance: bool) -> None:
        """Take one step; estimate the rest variance if the starts are near or on request."""
        layout, values = self._layout, self._values
        self._equations = self._normal_equations()
        self._prior_mean[layout.starts] = self._delays.expected_s(values[layout.starts])
        self._equations.add_prior(self._prior_weight, self._prior_mean - values)
        if self._variance_estimates < VARIANCE_ESTIMATES and (
            self._start_change_s < MAX_STEP_FOR_VARIANCE_S or estimate_variance
        ):
            self._rest_variance = likeliest_rest_variance(
                self._equations, layout.rests, values[layout.rests]
            )
            self._variance_estimates += 1
        rest_weight = np.zeros(layout.size)
        rest_weight[layout.rests] = 1.0 / self._rest_variance
        self._equations.add_prior(rest_weight, -values)
        step = self._equations.solve()
        self._values = values + step
        if self._law_information is not None:
            self._law_information = self._law_information.after_step(step)
        # The rms of all starts, because a poll at the outlier limit can oscillate.
        start_change = step[layout.starts]
        self._start_change_s = (
            float(np.sqrt(np.mean(start_change**2))) if start_change.size else 0.0
        )

    def result(self) -> MoveFit:
        """Return the result of the last iteration."""
        return MoveFit(
            table=self._table,
            parameters=self._layout.parameters(self._values),
            information=add_detent_offsets(self._equations, self._table.command_count),
            common_shift_std_s=self._common_shift_std_s,
            instant_std_s=self._instant_std_s,
            count_parameters=CountParameters(*self._values[-COUNT_PARAMETERS:].tolist()),
            rest_variance=self._rest_variance,
            counts_follow_commands=self._counts_follow_commands,
        )

    @property
    def law_information(self) -> LawInformation:
        """The information of the counts about the values of the law.

        Raises:
            ValueError: the law is that of the settings, or no step was taken.
        """
        if self._law_information is None:
            raise ValueError("the fit has no information about the motion law")
        return self._law_information.with_stage_rests(
            self._table.command_count, self._table.rest_count
        )

    def objective(self) -> PollObjective:
        """Return the cost of other values of the unknowns, with current weights of the counts."""
        prior_weight = self._prior_weight.copy()
        prior_weight[self._layout.rests] = 1.0 / self._rest_variance
        spacing_s = self._poll_spacing_s
        likelihood = self._likelihood()
        return PollObjective.of(
            likelihood,
            self._instant_std_s,
            likelihood.poll_spacing_s() if spacing_s is None else spacing_s,
            GaussianWeights(prior_weight, self._prior_mean),
        )

    def _likelihood(self) -> PollLikelihood:
        parameters = self._layout.parameters(self._values)
        count_parameters = CountParameters(*self._values[-COUNT_PARAMETERS:])
        return PollLikelihood.of(self._table, self._counts, parameters, count_parameters, self._law)

    def _normal_equations(self) -> BandedNormalEquations:
        """Return the normal equations of the polls at the current values."""
        likelihood = self._likelihood()
        if self._poll_spacing_s is None:
            self._poll_spacing_s = likelihood.poll_spacing_s()
        self._instant_std_s = likelihood.scatter_s(self._instant_std_s)
        self._counts_follow_commands = likelihood.counts_follow_commands(self._instant_std_s)
        equations = likelihood.normal_equations(self._instant_std_s, self._poll_spacing_s)
        if self._law.is_recorded:
            return equations
        self._law_information = LawInformation.of(equations)
        return equations.without_last_shared(LAW_VALUES)


def _counts_per_axis(polls: UnitPolls) -> tuple[tuple[AxisCounts, AxisCounts], float]:
    """Return the counts per axis, and the smallest width of an exchange."""
    width = polls.latest_s - polls.earliest_s
    least_s = float(np.percentile(width, 1.0)) if width.size else 0.0
    base_s, extra_s = polls.earliest_s + least_s / 2.0, np.clip(width - least_s, 0.0, None)
    pan, tilt = (AxisCounts(base_s, extra_s, polls.steps[:, axis]) for axis in (0, 1))
    if polls.valid.all():
        return (pan, tilt), least_s
    return (pan.subset(polls.valid[:, 0]), tilt.subset(polls.valid[:, 1])), least_s


def _counts_near_moves(counts: AxisCounts, track: Trajectory) -> AxisCounts:
    """Return the counts that can be in motion, about half of all."""
    if track.begin_s.size == 0:
        return counts.subset(slice(0, 0))
    at_s = counts.base_s + 0.5 * counts.extra_s
    move = np.searchsorted(track.begin_s - INITIAL_ERROR_S, at_s, side="right") - 1
    return counts.subset((move >= 0) & (at_s <= track.end_s[move] + INITIAL_ERROR_S))


class _StartDelays:
    """Expected start times; those without polls have the median delay of the others.

    The counts determine the first command of a move. They may not determine a command in motion,
    nor the start of a move without polls (awaited, or too short).
    """

    def __init__(self, table: MoveTable, delay_s: FloatArray) -> None:
        """Start with the initial delay of each move, nan without polls."""
        self._command_s = table.command_times_s
        delays = np.repeat(delay_s, np.diff(table.first_command))
        self.is_polled = np.zeros(delays.size, dtype=np.bool_)
        self.is_polled[table.first_command[:-1]] = True
        self.is_polled &= np.isfinite(delays)
        usual_delay_s = float(np.median(delays[self.is_polled])) if self.is_polled.any() else 0.0
        self.guess_s = self._command_s + np.where(np.isfinite(delays), delays, usual_delay_s)

    def expected_s(self, starts_s: FloatArray) -> FloatArray:
        """Return the prior means of the starts, from the median delay of the polled ones."""
        if not self.is_polled.any():
            return self.guess_s
        usual_delay_s = float(np.median((starts_s - self._command_s)[self.is_polled]))
        return np.where(self.is_polled, self.guess_s, self._command_s + usual_delay_s)


def _prior_weights(layout: _UnknownLayout, is_polled: BoolArray) -> FloatArray:
    """Return one over the prior variance of every unknown except the rests."""
    weight = np.zeros(layout.size)
    weight[layout.starts] = np.where(
        is_polled, POLLED_START_PRIOR_STD_S**-2, UNPOLLED_START_PRIOR_STD_S**-2
    )
    weight[layout.speeds] = LOG_SPEED_PRIOR_STD**-2
    weight[layout.accelerations] = LOG_ACCELERATION_PRIOR_STD**-2
    weight[-COUNT_PARAMETERS:] = [
        COUNT_PRIOR_STD_STEPS**-2,
        COUNT_PRIOR_STD_STEPS**-2,
        DELAY_SHARE_PRIOR_STD**-2,
    ]
    return weight
