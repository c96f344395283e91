"""Exact fit of one candidate cause: sizes, shapes and event time by their nonlinear effect.

The gain is the increase of the log-likelihood. The evidence is Laplace's approximation, with an
Occam factor. Its priors are a Cauchy distribution with the typical size for sizes, and uniform
distributions over the ranges of shapes and event times.

What to use when: `fit_candidate` for a cause at a place from some of its templates.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.candidate_objective import (
    MIN_STEP_GAIN_NATS,
    PERSISTENT_STAGES,
    CandidateObjective,
    LocalExpansion,
)
from gyrorig_solver.discover.template_choice import MIN_PERIODS, folded_periods
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector
from gyrorig_solver.model import Term, value_indices

WHOLE_COUNT_SIGMA = 4.0  # standard deviations from the nearest whole number
# Gain by sizes outside their ranges, two standard deviations: more shows that another cause acts.
MAX_OUTSIDE_GAIN_NATS = 2.0
# Grids of event times that are searched, and steps to each side; each grid is finer by the latter.
REFINEMENTS, STEPS_PER_SIDE = 4, 4
FIRST_STEPS_PER_SIDE = 8  # of the first grid of two event times that are searched together
SHAPE_SHARE = 0.04  # of a period, searched to each side of an event
SMOOTH_STD_S = 2e-3  # below this uncertainty of an event, the likelihood has one smooth peak
SHIFTS_S = (0.02, 0.07, 0.25)  # of an event: durations of an edge of a move, of a ramp, of a rest
MIN_STD_S = 1e-6  # smallest standard uncertainty of an event time: resolution of the timestamps
GRID_PER_SIDE = 20  # times to each side of an event with a larger uncertainty than SMOOTH_STD_S


@dataclass(frozen=True, slots=True, eq=False)
class FittedCandidate:
    """A cause at its maximum-likelihood values, with the base model eliminated."""

    extension: FittedTerm  # its sizes are free, and its shapes unless held; its event is fixed
    place: str | None
    delta_log_likelihood: float  # nats
    log_evidence: float  # nats, with the Occam factor
    std: FloatArray  # (free,)
    absorbed: FloatArray  # (board,), bias of the fit's parameters by the effect of the cause
    infeasible: bool  # the best values are outside their ranges, or a count is not whole
    event_std: float | None = None  # of the time of its event, s; None if it has no event


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
        place: fit only the sizes at this place; None: all sizes.
        starts: values (k,) each; sizes that are not fitted are set to zero.
        search_event: also search for the event by its exact effect, which is not a smooth
            function of its time.
    """
    objective = CandidateObjective(projection, term, place)
    fits = [_fit_from(objective, start, search_event) for start in starts]
    if not fits:
        return None
    best, best_with_event = min(fits, key=lambda fit: fit[0].cost)
    candidate = _summarize(objective, best)
    if not objective.events:
        return candidate
    std = event_std(objective, best_with_event)
    evidence = candidate.log_evidence + event_occam_nats(objective, std)
    return replace(candidate, event_std=std, log_evidence=evidence)


def _fit_from(
    objective: CandidateObjective, start: FloatArray, search_event: bool
) -> tuple[LocalExpansion, LocalExpansion]:
    """Return the optimum from one template, and the same with the event free."""
    values = objective.restrict_sizes(start)
    if objective.term.holds_shapes:
        values = locate_shapes(objective, values)
    elif objective.events:
        values = locate_event(objective, values)
    fitted = objective.minimize_from(objective.useful_start(values), objective.free)
    if not objective.events:
        return fitted, fitted
    if search_event and not objective.term.holds_shapes:  # `locate_shapes` used the exact effect
        fitted = search_event_nearby(objective, fitted)
    with_event = np.concatenate([objective.free, np.array(objective.events, dtype=np.int64)])
    event_free = objective.minimize(fitted.values, with_event)
    return objective.expand(event_free.values, objective.free), event_free


def _summarize(objective: CandidateObjective, state: LocalExpansion) -> FittedCandidate:
    free, context = objective.free, objective.context
    evidence = -state.cost
    width = np.empty(free.size)
    for k, index in enumerate(free):
        p = objective.parameters[index]
        if p.role == "size":
            width[k] = p.prior_std
            evidence += p.log_prior_of_size(float(state.values[index]))
        else:
            span = p.upper - p.lower
            width[k] = span if np.isfinite(span) else context.end_s - context.begin_s
            evidence -= float(np.log(width[k]))
    posterior_information = state.curvature + np.diag(width**-2.0)
    covariance = np.asarray(np.linalg.pinv(posterior_information, hermitian=True), np.float64)
    evidence += 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    fitted = objective.sizes if objective.term.holds_shapes else free
    return FittedCandidate(
        extension=FittedTerm(objective.term, state.values, fitted),
        place=objective.place,
        delta_log_likelihood=-state.cost,
        log_evidence=evidence,
        std=std[: fitted.size],
        absorbed=state.absorbed,
        infeasible=_is_outside(objective, state, covariance)
        or is_event_at_boundary(objective, state.values)
        or _is_not_whole_count(objective, state.values[free], std)
        or _is_line_too_slow(objective, state.values),
    )


def _is_outside(
    objective: CandidateObjective, state: LocalExpansion, covariance: FloatArray
) -> bool:
    """Return whether sizes outside their ranges are clearly better.

    Noise alone moves an estimate. If the true size is near a bound, the estimate is outside the
    range in half of all recordings.
    """
    sizes, free = objective.sizes, objective.free
    at_zero = np.isin(np.arange(free.size), np.arange(sizes.size)) & (state.values[free] == 0.0)
    pushed = np.where(objective.at_active_bound(state, free) & ~at_zero, state.slope, 0.0)
    pushed[sizes.size :] = 0.0
    return 0.5 * float(pushed @ covariance @ pushed) > MAX_OUTSIDE_GAIN_NATS


def _is_line_too_slow(objective: CandidateObjective, values: FloatArray) -> bool:
    """Return whether aliasing puts a spectral line at such a low frequency that a drift fits it."""
    if objective.term.template_search != "spectral_lines":
        return False
    context = objective.context
    rate_hz = objective.projector.segments[0].noise.sampling.rate_hz
    line = values[value_indices(objective.term, role="shape")]
    periods = folded_periods(line, rate_hz, context.end_s - context.begin_s)
    return bool(np.all(periods < MIN_PERIODS))


def _is_not_whole_count(objective: CandidateObjective, value: FloatArray, std: FloatArray) -> bool:
    """Return whether a count differs significantly from every whole number."""
    counts = np.array([objective.parameters[k].is_integer for k in objective.free], dtype=np.bool_)
    nearest = np.maximum(np.round(np.abs(value)), 1.0) * np.where(value < 0, -1.0, 1.0)
    distance = np.abs(value - nearest)
    return bool(np.any(counts & (value != 0.0) & (distance > WHOLE_COUNT_SIGMA * std)))


def locate_event(objective: CandidateObjective, values: FloatArray) -> FloatArray:
    """Return values at the best event time near the given one, with one-step sizes."""
    step_s = (objective.context.end_s - objective.context.begin_s) / 60.0
    event = objective.events[0]
    best, statistic = values, -1.0
    for _ in range(REFINEMENTS):
        shifts_s = step_s * np.arange(-STEPS_PER_SIDE, STEPS_PER_SIDE + 1) / STEPS_PER_SIDE
        trials = [_with_value(values, event, float(best[event]) + s) for s in shifts_s]
        best, statistic = _best_trial(objective, trials, best, statistic)
        step_s /= STEPS_PER_SIDE
    return best


def locate_shapes(objective: CandidateObjective, values: FloatArray) -> FloatArray:
    """Return values at the best period and event time near the given ones, with one-step sizes.

    The statistic has a narrow ridge along which the period and the time of one event compensate
    each other. Therefore this function searches the times of the first and the last event
    together.
    """
    (period,), event = objective.shapes, objective.events[0]
    context = objective.context
    events_before = np.floor((float(values[event]) - context.begin_s) / values[period])
    events_after = np.floor((context.end_s - float(values[event])) / values[period])
    periods = max(events_before + events_after, 1.0)  # from the first event to the last
    best, statistic = values, -1.0
    span_s, steps = SHAPE_SHARE * float(values[period]), FIRST_STEPS_PER_SIDE
    for _ in range(REFINEMENTS):
        shifts_s = span_s * np.arange(-steps, steps + 1) / steps
        trials = []
        for first_s, last_s in product(shifts_s, shifts_s):
            trial = best.copy()
            trial[event] += first_s + (last_s - first_s) * events_before / periods
            trial[period] += (last_s - first_s) / periods
            trials.append(trial)
        best, statistic = _best_trial(objective, trials, best, statistic)
        span_s, steps = span_s / steps, STEPS_PER_SIDE
    return best


def _best_trial(
    objective: CandidateObjective, trials: Sequence[FloatArray], best: FloatArray, statistic: float
) -> tuple[FloatArray, float]:
    """Return the values with the greatest statistic, with one-step sizes, and the statistic."""
    for trial, test in zip(trials, objective.score_trials(trials), strict=True):
        if test.statistic > statistic:
            statistic, best = test.statistic, objective.with_one_step_sizes(trial, test)
    return best, statistic


def _with_value(values: FloatArray, index: int, value: float) -> FloatArray:
    changed = values.copy()
    changed[index] = value
    return changed


def search_event_nearby(objective: CandidateObjective, expansion: LocalExpansion) -> LocalExpansion:
    """Return the fit with the best event time nearby, by its exact effect.

    To first order, a large step in the middle of a move fits as well as one before the move.
    """
    best = expansion
    for _ in range(REFINEMENTS):
        current = best
        for shift_s in (sign * distance_s for distance_s in SHIFTS_S for sign in (-1.0, 1.0)):
            trial = current.values.copy()
            trial[objective.events[0]] += shift_s
            fitted = objective.minimize(objective.clip(trial))
            if fitted.cost < best.cost - MIN_STEP_GAIN_NATS:
                best = fitted
        if best is current:
            break
    return best


def event_std(objective: CandidateObjective, expansion: LocalExpansion) -> float:
    """Return the standard uncertainty of an event's time, s; the time is the last free value.

    The likelihood may have no smooth peak, for example for a small step in noise, or for a jump of
    the timestamps during a rest. Then the result is the rms deviation of times of a grid from the
    event, weighted by their likelihood.
    """
    information = _information_of_last(expansion.curvature)
    if information > SMOOTH_STD_S**-2.0:
        return float(information**-0.5)
    context, event = objective.context, objective.events[0]
    event_s = float(expansion.values[event])
    distances_s = np.geomspace(0.5 * SMOOTH_STD_S, context.end_s - context.begin_s, GRID_PER_SIDE)
    times = event_s + np.concatenate([-distances_s[::-1], [0.0], distances_s])
    times = times[(times >= context.begin_s) & (times <= context.end_s)]
    trials = [_with_value(expansion.values, event, time_s) for time_s in times]
    statistics = [test.statistic for test in objective.score_trials(trials)]
    weight = np.exp(0.5 * (np.array(statistics) - max(statistics))) * np.gradient(times)
    return float(np.sqrt(np.sum(weight * (times - event_s) ** 2) / np.sum(weight)))


def _information_of_last(curvature: FloatArray) -> float:
    """Return the information of the last value with the other values free.

    It is the Schur complement. A pseudo-inverse of the curvature would give a value without
    information a variance of zero.
    """
    others, cross = curvature[:-1, :-1], curvature[:-1, -1]
    eliminated = cross @ np.linalg.pinv(others, hermitian=True) @ cross
    return float(curvature[-1, -1] - eliminated)


def event_occam_nats(objective: CandidateObjective, std_s: float) -> float:
    """Return the logarithm of the Occam factor of an event's time."""
    first, last = objective.event_interval
    ratio = np.sqrt(2.0 * np.pi) * max(std_s, MIN_STD_S) / (last - first)
    return min(0.0, float(np.log(ratio)))


def is_event_at_boundary(objective: CandidateObjective, values: FloatArray) -> bool:
    """Return whether a persistent event is at the boundary of its interval."""
    if objective.term.stage not in PERSISTENT_STAGES or not objective.events:
        return False
    return any(float(values[k]) in objective.event_interval for k in objective.events)
