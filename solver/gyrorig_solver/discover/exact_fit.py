"""Exact fit of one candidate cause: sizes, shapes and event time by their nonlinear effect.

The base model follows to first order, because it is nearly linear at its optimum; the cause is
nonlinear. The gain is the rise of the log-likelihood. The evidence (Laplace's approximation, with
Occam factor) expects sizes about the typical one with long tails (Cauchy), and shapes and event
times uniform in their ranges.

What to use when: `fit_candidate` for a cause at a place from some of its templates.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28;
Levenberg-Marquardt with the scaling of More (1978).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.discover.score_tests import ScoreTest
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.model.causes.supply_hum import MIN_PERIODS, folded_periods
from gyrorig_solver.model.recording_context import RecordingContext
from gyrorig_solver.model.recording_scope import is_active_in
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import Term, value_indices, value_parameters

MAX_ITERATIONS = 12
MIN_STEP_GAIN_NATS = 1e-2  # nats won by a step: less is no reason for another
MIN_PREDICTED_GAIN_NATS = 1e-4  # nats that a step promises: a hundredth of a deviation, negligible
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-9, 1e6
EVENT_REFINEMENTS, EVENT_STEPS_PER_SIDE = (
    4,
    4,
)  # an event is looked for this many times, each so much finer
SMOOTH_EVENT_STD_S = (
    2e-3  # an event known better than this lies on one smooth hill of the likelihood
)
EVENT_SHIFTS_S = (0.02, 0.07, 0.25)  # an edge of a move, its ramp, a rest
MIN_EVENT_STD_S = 1e-6  # that an event is known to
EVENT_GRID_PER_SIDE = 20  # times to either side of one that is known worse
WHOLE_COUNT_SIGMA = 4.0  # deviations
MAX_OUTSIDE_GAIN_NATS = 2.0  # won by leaving what is possible, two deviations: it is something else
PERSISTENT_STAGES = (
    "mount",
    "clock",
)  # links at which an event changes what the fit itself follows


@dataclass(frozen=True, slots=True, eq=False)
class FittedCandidate:
    """A cause at its maximum-likelihood values, the base model eliminated."""

    extension: FittedTerm  # its sizes and shapes free, its event as found
    place: str | None
    delta_log_likelihood: float  # nats
    log_evidence: float  # nats, Occam's factor counted
    std: FloatArray  # (free,)
    absorbed: FloatArray  # (board,), what its effect makes of the fit's parameters
    infeasible: bool  # better still outside what is possible, or a part of what is whole
    event_std: float | None = None  # of its event's time, s; None where it has none


@dataclass(frozen=True, slots=True, eq=False)
class _LocalExpansion:
    """The objective, its gradient and its curvature at given values."""

    values: FloatArray  # (k,)
    cost: float  # minus the nats won
    curvature: FloatArray  # (f, f), of the data
    slope: FloatArray  # (f,), downhill
    absorbed: FloatArray  # (board,)


def fit_candidate(
    projection: NuisanceProjector,
    term: Term,
    place: str | None,
    starts: Sequence[FloatArray],
    search_event: bool = False,
) -> FittedCandidate | None:
    """Fit a cause from each of some templates; return the best fit, None if all fail.

    Args:
        projection: the nuisance projector at the fit.
        term: the cause.
        place: its sizes at this place alone; None: all.
        starts: values (k,) each; sizes that are not fitted are taken as zero.
        search_event: look for the event by its exact effect too, which is not smooth in its time.
    """
    sizes = np.array(value_indices(term, place, "size"), dtype=np.int64)
    shapes = np.array(value_indices(term, place, "shape"), dtype=np.int64)
    events = value_indices(term, role="event")
    best: _LocalExpansion | None = None
    best_with_event: _LocalExpansion | None = None
    for start in starts:
        values = _restrict_sizes(term, start, sizes)
        if events:
            values = _locate_event(projection, term, values, sizes, events[0])
        elif not values[sizes].any():
            values = _estimate_sizes(projection, term, values, sizes)
        state = _minimize(projection, term, values, np.concatenate([sizes, shapes]))
        with_event_free = state
        if events:
            if search_event:
                state = _search_event_nearby(
                    projection, term, state, np.concatenate([sizes, shapes]), events[0]
                )
            with_event = np.concatenate([sizes, shapes, np.array(events, dtype=np.int64)])
            with_event_free = _minimize(projection, term, state.values, with_event)
            state = _expand(
                projection, term, with_event_free.values, np.concatenate([sizes, shapes])
            )
        if best is None or state.cost < best.cost:
            best, best_with_event = state, with_event_free
    if best is None or best_with_event is None:
        return None
    candidate = _summarize(projection, term, place, best, sizes, shapes)
    if not events:
        return candidate
    std = _event_std(projection, term, best_with_event, sizes, events[0])
    return replace(
        candidate,
        event_std=std,
        log_evidence=candidate.log_evidence + _event_occam_factor(projection, term, std),
    )


def _event_occam_factor(projection: NuisanceProjector, term: Term, event_std: float) -> float:
    """Return the Occam factor of an event's time, in nats."""
    first, last = _event_interval(projection, term)
    return min(
        0.0, float(np.log(np.sqrt(2.0 * np.pi) * max(event_std, MIN_EVENT_STD_S) / (last - first)))
    )


def _restrict_sizes(term: Term, template: FloatArray, sizes: IntArray) -> FloatArray:
    values = template.copy()
    values[[k for k in value_indices(term, role="size") if k not in sizes]] = 0.0
    return values


def _estimate_sizes(
    projection: NuisanceProjector, term: Term, values: FloatArray, sizes: IntArray
) -> FloatArray:
    """Return values with one-step estimates of the sizes."""
    all_sizes = value_indices(term, role="size")
    positions = [all_sizes.index(k) for k in sizes]
    whitened = projection.evaluate_signals(
        lambda scene: term.tangent_signals(scene, values)[positions], term=term
    )
    estimated = values.copy()
    estimated[sizes] = ScoreTest.of(projection.score_statistics(whitened)).one_step_sizes
    return _clip_to_bounds(projection, term, estimated)


def _locate_event(
    projection: NuisanceProjector, term: Term, values: FloatArray, sizes: IntArray, event: int
) -> FloatArray:
    """Return values at the best event time near the given one, with one-step sizes."""
    all_sizes = value_indices(term, role="size")
    positions = [all_sizes.index(k) for k in sizes]
    setting = _context_of(projection, term)
    step_s = (setting.end_s - setting.begin_s) / 60.0
    best, statistic = values, -1.0
    for _ in range(EVENT_REFINEMENTS):
        middle = float(best[event])
        for shift in (
            np.arange(-EVENT_STEPS_PER_SIDE, EVENT_STEPS_PER_SIDE + 1) / EVENT_STEPS_PER_SIDE
        ):
            trial = values.copy()
            trial[event] = middle + shift * step_s

            def signal(scene: SignalState, trial: FloatArray = trial) -> FloatArray:
                return term.tangent_signals(scene, trial)[positions]

            test = ScoreTest.of(
                projection.score_statistics(projection.evaluate_signals(signal, term=term))
            )
            if test.statistic > statistic:
                statistic = test.statistic
                trial[sizes] = test.one_step_sizes
                best = _clip_to_bounds(projection, term, trial)
        step_s /= EVENT_STEPS_PER_SIDE
    return best


def _search_event_nearby(
    projection: NuisanceProjector, term: Term, state: _LocalExpansion, free: IntArray, event: int
) -> _LocalExpansion:
    """Return the fit with the best event time nearby, by its exact effect.

    To first order a large step in the middle of a move is as good as one before it.
    """
    best = state
    for _ in range(EVENT_REFINEMENTS):
        current = best
        for shift_s in (sign * distance_s for distance_s in EVENT_SHIFTS_S for sign in (-1.0, 1.0)):
            trial = current.values.copy()
            trial[event] += shift_s
            fitted = _minimize(projection, term, _clip_to_bounds(projection, term, trial), free)
            if fitted.cost < best.cost - MIN_STEP_GAIN_NATS:
                best = fitted
        if best is current:
            break
    return best


def _event_std(
    projection: NuisanceProjector, term: Term, state: _LocalExpansion, sizes: IntArray, event: int
) -> float:
    """Return the standard uncertainty of an event's time, s; `state` has it free, last.

    Where the likelihood is no smooth hill (a small step in noise, a stamp that jumps while
    all is at rest) it is the scatter of the times about, each by its likelihood.
    """
    variance = float(np.linalg.pinv(state.curvature, hermitian=True)[-1, -1])
    if state.curvature[-1, -1] > 0.0 and 0.0 < variance < SMOOTH_EVENT_STD_S**2:
        return float(np.sqrt(variance))
    all_sizes = value_indices(term, role="size")
    positions = [all_sizes.index(k) for k in sizes]
    setting = _context_of(projection, term)
    event_s = float(state.values[event])
    distances_s = np.geomspace(
        0.5 * SMOOTH_EVENT_STD_S, setting.end_s - setting.begin_s, EVENT_GRID_PER_SIDE
    )
    times = event_s + np.concatenate([-distances_s[::-1], [0.0], distances_s])
    times = times[(times >= setting.begin_s) & (times <= setting.end_s)]
    statistics = []
    for time_s in times:
        trial = state.values.copy()
        trial[event] = time_s

        def signal(scene: SignalState, trial: FloatArray = trial) -> FloatArray:
            return term.tangent_signals(scene, trial)[positions]

        test = ScoreTest.of(
            projection.score_statistics(projection.evaluate_signals(signal, term=term))
        )
        statistics.append(test.statistic)
    weight = np.exp(0.5 * (np.array(statistics) - max(statistics))) * np.gradient(times)
    return float(np.sqrt(np.sum(weight * (times - event_s) ** 2) / np.sum(weight)))


def _clip_to_bounds(projection: NuisanceProjector, term: Term, values: FloatArray) -> FloatArray:
    parameters = value_parameters(term)
    low, high = np.array([p.lower for p in parameters]), np.array([p.upper for p in parameters])
    for k in value_indices(term, role="event"):
        low[k], high[k] = _event_interval(projection, term)
    return np.clip(values, low, high)


def _event_interval(projection: NuisanceProjector, term: Term) -> tuple[float, float]:
    """Return the interval in which an event of a cause can be.

    A lasting change is a comparison of before and after. If the event changes the gain or the time
    offset, both sides need a whole move. Otherwise the base model absorbs an event of any size.
    """
    setting = _context_of(projection, term)
    if term.stage in PERSISTENT_STAGES and len(setting.motion_profiles) > 2:
        first = min(float(course.end_s) for _, course in setting.motion_profiles)
        last = max(float(course.start_s[0]) for _, course in setting.motion_profiles)
        if first < last:
            return first, last
    return setting.begin_s, setting.end_s


def _context_of(projection: NuisanceProjector, term: Term) -> RecordingContext:
    """Return the context of the first recording in which a cause acts."""
    return next(scene.context for scene in projection.states if is_active_in(term, scene))


def _expand(
    projection: NuisanceProjector, term: Term, values: FloatArray, free: IntArray
) -> _LocalExpansion:
    statistics = projection.score_statistics(projection.term_derivatives(term, values, free))
    count = free.size
    cost = 0.5 * float(statistics.information[count, count]) - float(statistics.score[count])
    slope = statistics.score[:count] - statistics.information[:count, count]
    parameters = value_parameters(term)
    # Shapes that the data do not determine stay near typical values.
    precision = np.array(
        [_prior_precision(parameters[k].role, parameters[k].prior_std) for k in free]
    )
    start = np.array([parameters[k].start for k in free])
    offset = values[free] - start
    return _LocalExpansion(
        values,
        cost + 0.5 * float(precision @ offset**2),
        statistics.information[:count, :count] + np.diag(precision),
        slope - precision * offset,
        statistics.absorbed[count],
    )


def _prior_precision(role: str, prior_std: float) -> float:
    return prior_std**-2.0 if role == "shape" and np.isfinite(prior_std) else 0.0


def _minimize(
    projection: NuisanceProjector, term: Term, values: FloatArray, free: IntArray
) -> _LocalExpansion:
    current = _expand(projection, term, values, free)
    parameters = value_parameters(term)
    typical = np.array([parameters[k].typical_size for k in free])
    damping, rejected = FIRST_DAMPING, False
    for _ in range(MAX_ITERATIONS):
        scale = np.maximum(np.diag(current.curvature), 1e-12 / typical**2)
        is_free = ~_at_active_bound(term, current, free)
        if not is_free.any():
            break
        free_positions = np.flatnonzero(is_free)
        damped = current.curvature[np.ix_(free_positions, free_positions)] + damping * np.diag(
            scale[free_positions]
        )
        step = np.zeros(free.size)
        step[free_positions] = np.linalg.lstsq(damped, current.slope[free_positions], rcond=None)[0]
        predicted_gain = float(current.slope @ step - 0.5 * step @ current.curvature @ step)
        if predicted_gain < (MIN_STEP_GAIN_NATS if rejected else MIN_PREDICTED_GAIN_NATS):
            break
        trial = current.values.copy()
        trial[free] += step
        trial = _clip_to_bounds(projection, term, trial)
        if np.array_equal(trial, current.values):
            break
        after = _expand(projection, term, trial, free)
        if after.cost < current.cost:
            gain = current.cost - after.cost
            current, damping = after, max(damping * 0.1, MIN_DAMPING)
            rejected = False
            if gain < MIN_STEP_GAIN_NATS:
                break
        else:
            rejected = True
            damping *= 10.0
            if damping > MAX_DAMPING:
                break
    return current


def _at_active_bound(term: Term, state: _LocalExpansion, free: IntArray) -> BoolArray:
    """Return which values are at a bound that the gradient pushes against (active set)."""
    parameters = value_parameters(term)
    low = np.array([parameters[k].lower for k in free])
    high = np.array([parameters[k].upper for k in free])
    value = state.values[free]
    return np.asarray(
        ((value <= low) & (state.slope < 0.0)) | ((value >= high) & (state.slope > 0.0))
    )


def _summarize(
    projection: NuisanceProjector,
    term: Term,
    place: str | None,
    state: _LocalExpansion,
    sizes: IntArray,
    shapes: IntArray,
) -> FittedCandidate:
    parameters = value_parameters(term)
    free = np.concatenate([sizes, shapes])
    setting = _context_of(projection, term)
    evidence = -state.cost
    width = np.empty(free.size)
    for k, index in enumerate(free):
        p = parameters[index]
        if p.role == "size":
            width[k] = p.prior_std
            relative = float(state.values[index]) / p.typical_size
            evidence -= float(np.log(np.pi * p.typical_size * (1.0 + relative**2)))
        else:
            span = p.upper - p.lower
            width[k] = span if np.isfinite(span) else setting.end_s - setting.begin_s
            evidence -= float(np.log(width[k]))
    posterior_information = state.curvature + np.diag(width**-2.0)
    covariance = np.linalg.pinv(posterior_information, hermitian=True)
    evidence += 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    at_bound = _at_active_bound(term, state, free)
    value = state.values[free]
    at_zero = np.array([parameters[k].role == "size" for k in free]) & (value == 0.0)
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    pushed = np.where(at_bound & ~at_zero, state.slope, 0.0)
    pushed[sizes.size :] = 0.0
    # An estimate scatters: that of a truth near a bound lies beyond it half of the time.
    outside = 0.5 * float(pushed @ covariance @ pushed) > MAX_OUTSIDE_GAIN_NATS
    return FittedCandidate(
        extension=FittedTerm(term, state.values, free),
        place=place,
        delta_log_likelihood=-state.cost,
        log_evidence=evidence,
        std=std,
        absorbed=state.absorbed,
        infeasible=outside
        or _event_at_boundary(projection, term, state.values)
        or _not_a_whole_count(term, value, free, std)
        or _line_too_slow(projection, term, state.values),
    )


def _event_at_boundary(projection: NuisanceProjector, term: Term, values: FloatArray) -> bool:
    """Return whether a persistent event is at the boundary of its interval."""
    events = value_indices(term, role="event")
    if term.stage not in PERSISTENT_STAGES or not events:
        return False
    interval = _event_interval(projection, term)
    return any(float(values[k]) in interval for k in events)


def _line_too_slow(projection: NuisanceProjector, term: Term, values: FloatArray) -> bool:
    """Return whether a spectral line is aliased to so low a frequency that any drift fits it."""
    if term.template_search != "spectral_lines":
        return False
    setting = _context_of(projection, term)
    rate_hz = projection.segments[0].noise.sampling.rate_hz
    line = values[value_indices(term, role="shape")]
    return bool(
        np.all(folded_periods(line, rate_hz, setting.end_s - setting.begin_s) < MIN_PERIODS)
    )


def _not_a_whole_count(term: Term, value: FloatArray, free: IntArray, std: FloatArray) -> bool:
    """Return whether a count is significantly different from every whole number."""
    parameters = value_parameters(term)
    counts = np.array([parameters[k].is_integer for k in free], dtype=np.bool_)
    distance = np.abs(
        value - np.maximum(np.round(np.abs(value)), 1.0) * np.where(value < 0, -1.0, 1.0)
    )
    return bool(np.any(counts & (value != 0.0) & (distance > WHOLE_COUNT_SIGMA * std)))
