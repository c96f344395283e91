"""The log-likelihood of one candidate cause as a function of its values, and its maximum.

The effect of the cause is nonlinear. The parameters of the base model follow to first order,
because that model is nearly linear at its optimum.

What to use when: `CandidateObjective` for a cause at one of its places; `minimize` from start
values, `score_test` for the best sizes to first order.

Source: Levenberg-Marquardt with the scaling of More (1978).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.discover.score_tests import ScoreTest, score_batches
from gyrorig_solver.estimate import NuisanceProjector, WhitenedSignals
from gyrorig_solver.model import (
    RecordingContext,
    Term,
    is_active_in,
    value_indices,
    value_parameters,
)

MIN_STEP_GAIN_NATS = 1e-2  # gain of a step below which the fit ends
# Predicted gain of a step below which the fit ends: about a hundredth of a standard deviation.
MIN_PREDICTED_GAIN_NATS = 1e-4
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-9, 1e6
PERSISTENT_STAGES = ("mount", "clock")  # an event there changes the gain or the time offset


@dataclass(frozen=True, slots=True, eq=False)
class LocalExpansion:
    """The objective, its gradient and its curvature at given values."""

    values: FloatArray  # (k,)
    cost: float  # minus the gain in nats
    curvature: FloatArray  # (f, f), with that of the prior of the shapes
    slope: FloatArray  # (f,), negative gradient of the cost
    absorbed: FloatArray  # (board,), bias of the fit's parameters by the effect of the cause


class CandidateObjective:
    """A candidate cause at one of its places, or at all places, in the residual of a fit."""

    max_iterations = 12

    def __init__(self, projector: NuisanceProjector, term: Term, place: str | None) -> None:
        """Select the values that are fitted.

        Args:
            projector: the nuisance projector at the fit.
            term: the cause.
            place: fit only the sizes at this place; None: all sizes.
        """
        self.projector, self.term, self.place = projector, term, place
        self.parameters = value_parameters(term)
        self.sizes: IntArray = np.array(value_indices(term, place, "size"), dtype=np.int64)
        self.shapes: IntArray = np.array(value_indices(term, place, "shape"), dtype=np.int64)
        self.events = value_indices(term, role="event")
        self.free: IntArray = np.concatenate([self.sizes, self.shapes])

    @cached_property
    def context(self) -> RecordingContext:
        """The context of the first recording in which the cause acts."""
        states = self.projector.states
        return next(state.context for state in states if is_active_in(self.term, state))

    @cached_property
    def event_interval(self) -> tuple[float, float]:
        """The interval in which an event of the cause can be, s.

        A lasting change is detected by comparing the data before and after it. If the event changes
        the gain or the time offset, a whole move is necessary on both sides. Otherwise the base
        model absorbs an event of any size.
        """
        context = self.context
        if self.term.stage in PERSISTENT_STAGES and len(context.motion_profiles) > 2:
            first = min(float(course.end_s) for _, course in context.motion_profiles)
            last = max(float(course.start_s[0]) for _, course in context.motion_profiles)
            if first < last:
                return first, last
        return context.begin_s, context.end_s

    def restrict_sizes(self, template: FloatArray) -> FloatArray:
        """Return a template with the sizes that are not fitted set to zero."""
        values = template.copy()
        values[[k for k in value_indices(self.term, role="size") if k not in self.sizes]] = 0.0
        return values

    def clip(self, values: FloatArray) -> FloatArray:
        """Return values limited to their ranges."""
        low = np.array([parameter.lower for parameter in self.parameters])
        high = np.array([parameter.upper for parameter in self.parameters])
        for k in self.events:
            low[k], high[k] = self.event_interval
        return np.clip(values, low, high)

    def score_test(self, values: FloatArray) -> ScoreTest:
        """Test the sizes to first order, for given shapes and event."""
        all_sizes = value_indices(self.term, role="size")
        positions = [all_sizes.index(k) for k in self.sizes]
        whitened = self.projector.evaluate_signals(
            lambda state: self.term.tangent_signals(state, values)[positions], term=self.term
        )
        return ScoreTest.of(self.projector.score_statistics(whitened))

    def score_trials(self, trials: Sequence[FloatArray]) -> Iterator[ScoreTest]:
        """Yield the score test of each of some values; faster than one by one."""
        all_sizes = value_indices(self.term, role="size")
        positions = np.array([all_sizes.index(k) for k in self.sizes])
        for batch, statistics in score_batches(self.projector, self.term, np.array(trials)):
            count = statistics.score.size // len(batch)
            for k in range(len(batch)):
                yield ScoreTest.of(statistics.subset(k * count + positions))

    def with_one_step_sizes(self, values: FloatArray, test: ScoreTest) -> FloatArray:
        """Return values with the best sizes to first order."""
        estimated = values.copy()
        estimated[self.sizes] = test.one_step_sizes
        return self.clip(estimated)

    def derivatives(self, values: FloatArray, free: IntArray) -> WhitenedSignals:
        """Return the whitened derivatives by the free values; the last signal is the effect."""
        return self.projector.term_derivatives(self.term, values, free)

    def expand(self, values: FloatArray, free: IntArray) -> LocalExpansion:
        """Return the objective at given values, with its derivatives by the free values."""
        statistics = self.projector.score_statistics(self.derivatives(values, free))
        count = free.size
        cost = 0.5 * float(statistics.information[count, count]) - float(statistics.score[count])
        slope = statistics.score[:count] - statistics.information[:count, count]
        # Shapes that the data do not determine stay near typical values.
        parameters = [self.parameters[k] for k in free]
        precision = np.array([_prior_precision(p.role, p.prior_std) for p in parameters])
        offset = values[free] - np.array([p.start for p in parameters])
        return LocalExpansion(
            values,
            cost + 0.5 * float(precision @ offset**2),
            statistics.information[:count, :count] + np.diag(precision),
            slope - precision * offset,
            statistics.absorbed[count],
        )

    def useful_start(self, values: FloatArray) -> LocalExpansion:
        """Return the objective at given values, or with the best sizes to first order.

        The sizes are replaced if they are not better than no effect. `values`: of a template.
        """
        start = self.expand(values, self.free)
        if start.cost < 0.0:
            return start
        one_step = self.with_one_step_sizes(values, self.score_test(values))
        return min(start, self.expand(one_step, self.free), key=lambda state: state.cost)

    def minimize(self, values: FloatArray, free: IntArray | None = None) -> LocalExpansion:
        """Return the optimum near given values; `free`: by default the sizes and shapes."""
        free = self.free if free is None else free
        return self.minimize_from(self.expand(values, free), free)

    def minimize_from(self, current: LocalExpansion, free: IntArray) -> LocalExpansion:
        """Return the optimum near a start."""
        damping, rejected = FIRST_DAMPING, False
        for _ in range(self.max_iterations):
            step, predicted_gain = self.step_from(current, free, damping)
            if predicted_gain < (MIN_STEP_GAIN_NATS if rejected else MIN_PREDICTED_GAIN_NATS):
                break
            trial = current.values.copy()
            trial[free] += step
            trial = self.clip(trial)
            if np.array_equal(trial, current.values):
                break
            after = self.expand(trial, free)
            rejected = not after.cost < current.cost
            if rejected:
                damping *= 10.0
                if damping > MAX_DAMPING:
                    break
                continue
            gain = current.cost - after.cost
            current, damping = after, max(damping * 0.1, MIN_DAMPING)
            if gain < MIN_STEP_GAIN_NATS:
                break
        return current

    def step_from(
        self, current: LocalExpansion, free: IntArray, damping: float
    ) -> tuple[FloatArray, float]:
        """Return a step of the values that are not held at a bound, and its predicted gain.

        Args:
            current: the objective at the current values.
            free: the values of the step.
            damping: relative to the curvature by each value.
        """
        step = np.zeros(free.size)
        movable = np.flatnonzero(~self.at_active_bound(current, free))
        if not movable.size:
            return step, 0.0
        typical = np.array([self.parameters[k].typical_size for k in free])
        scale = np.maximum(np.diag(current.curvature), 1e-12 / typical**2)
        damped = current.curvature[np.ix_(movable, movable)] + damping * np.diag(scale[movable])
        step[movable] = np.linalg.lstsq(damped, current.slope[movable], rcond=None)[0]
        return step, float(current.slope @ step - 0.5 * step @ current.curvature @ step)

    def at_active_bound(self, expansion: LocalExpansion, free: IntArray) -> BoolArray:
        """Return which values are at a bound that the gradient pushes against (active set)."""
        low = np.array([self.parameters[k].lower for k in free])
        high = np.array([self.parameters[k].upper for k in free])
        value, slope = expansion.values[free], expansion.slope
        return np.asarray(((value <= low) & (slope < 0.0)) | ((value >= high) & (slope > 0.0)))


def _prior_precision(role: str, prior_std: float) -> float:
    return prior_std**-2.0 if role == "shape" and np.isfinite(prior_std) else 0.0
