"""Refits of a fit: with one more cause, with its events again, and with its gain again.

A threshold or a limit hides a part of the rates. For these rates, the derivative by the gain is
zero, and a fit that starts from the gain of the base model cannot change it. The search would then
explain the error of the gain by another cause that rotates or scales the rate, such as a slip of
the board before its first move, or a non-orthogonal axis. Therefore this module searches the gain
again as if all rates were visible, and judges the result by its exact likelihood.

If the fit of an added dead band does not converge, it is started from several widths. The reason
is that the likelihood jumps where the width passes the rate of a long move.

What to use when: `extend_fit` for a candidate of the search; `refit_events` afterwards, because
an event was found before the later causes; `refit_gain_exactly` for a fit to a motion with a
clipping cause.

Source: Levenberg-Marquardt with an approximate Jacobian; Dennis and Schnabel, Numerical Methods
for Unconstrained Optimization, chapter 10.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.candidate_fits import fitted_place
from gyrorig_solver.discover.checks.typical_noise import whittle_log_likelihood
from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.fit_space import SearchEffort, Space
from gyrorig_solver.discover.score_tests import ScoreTest
from gyrorig_solver.estimate import (
    GAIN_PARAMETERS,
    ConvergedFit,
    FittedTerm,
    NuisanceProjector,
    refit_with_terms,
)
from gyrorig_solver.estimate.cascade import CLIPPING_STAGES
from gyrorig_solver.model import (
    LinearTerm,
    Part,
    SignalState,
    Stage,
    TermParameter,
    value_indices,
)

MAX_RESTARTS = 2  # each from the end of the last one
# Standard deviations by which the score statistic of the gain must exceed its mean for a new fit.
SCORE_SIGMA = 4.0
MIN_GAIN_NATS = 2.0  # with a smaller gain, it is the same optimum, found more exactly
# Start values of the change of the gain. From 0, the fit begins with the best change to first
# order, which is far off if much of the rates is hidden. From 1e-9, it takes damped steps from
# almost no change, which can stay on a plateau of the likelihood if little is hidden.
START_VALUES = (0.0, 1e-9)
SCANNED_WIDTHS = np.geomspace(0.7, 1.7, 8)  # of a dead band, relative to the mean first width
SCAN_EVALUATIONS = 15  # of each scanned fit
MIN_EVENT_SHIFT_SIGMA = 0.1  # standard uncertainties; a smaller shift needs no refit of all causes
MAX_EVENT_REFITS = 6  # a large event moves less each time: the others adapt to its time
MIN_EVENT_GAIN_NATS = 0.5  # of a refit; a smaller gain does not move a size by its uncertainty
OBSERVABLE_SIGMA = 2.0  # standard deviations of an entry of the gain that the data determine
SAME_CHANGE_SIGMA = 0.5  # standard deviations of each entry of two changes that count as one
MAX_GAIN_CHANGE = 0.2  # a larger change of the gain means that the board is mounted another way


def extend_fit(space: Space, extension: FittedTerm) -> Space:
    """Refit with one more cause; hold its shapes if the fit does not converge with them free.

    If the cause hides rates, its fit can end at a local optimum of the gain. The gain is then
    searched again.
    """
    others = space.fitted_terms
    extended = space.refit([*others, extension])
    sizes = extension.free_sizes
    if not extended.convergence.converged and len(sizes) < extension.free_indices.size:
        sizes_only = replace(extension, free_indices=np.array(sizes, dtype=np.int64))
        extended = space.refit([*others, sizes_only])
    if not extended.convergence.converged:
        extended = _fit_from_scanned_widths(space, extension) or extended
    hides_rates = extension.term.stage in CLIPPING_STAGES
    return extended.refit_gain() if hides_rates and extended.convergence.converged else extended


def _fit_from_scanned_widths(space: Space, band: FittedTerm) -> Space | None:
    """Return the likeliest fit from several widths of a dead band; None if none converges.

    If the width passes the rate of a long move, the likelihood jumps, and no step of a fit crosses
    the jump. A fit that starts on the right side of all jumps is smooth. All axes start with equal
    widths.
    """
    if band.term.stage != "threshold":
        return None
    sizes = list(value_indices(band.term, role="size"))
    fits = []
    for factor in SCANNED_WIDTHS:
        values = band.values.copy()
        values[sizes] = factor * float(np.mean(band.values[sizes]))
        scanned = [*space.fitted_terms, replace(band, values=values)]
        fits.append(space.refit(scanned, SCAN_EVALUATIONS))
    converged = [fit for fit in fits if fit.convergence.converged]
    if not converged:
        return None
    return converged[int(np.argmax(space.log_likelihoods(converged)))]


def refit_events(space: Space) -> Space:
    """Refit the time of each event together with all other causes.

    The search finds an event before other causes, while its effect still biases the base model.
    Without a refit, later causes would absorb the error of the event time. The fit of the other
    causes and the times of the events alternate, until no time moves or the likelihood stays.
    """
    refitted = _refit_events_once(space, search_nearby=True)
    if refitted is space:
        return space
    for _ in range(MAX_EVENT_REFITS - 1):
        space, refitted = refitted, _refit_events_once(refitted, search_nearby=False)
        if refitted is space:
            break
        before_nats, after_nats = refitted.log_likelihoods([space, refitted])
        if after_nats < before_nats + MIN_EVENT_GAIN_NATS:
            break
    return space


def _refit_events_once(space: Space, search_nearby: bool) -> Space:
    """Fit the time of each event with the others held, then all causes with these times.

    Return the same fit if no time moves, or if the new fit does not converge.

    Args:
        space: the fit.
        search_nearby: also try times in the other parts of a move.
    """
    causes = list(space.fitted_terms)
    changed = False
    for k, extension in enumerate(causes):
        if not extension.free_indices.size or not value_indices(extension.term, role="event"):
            continue
        refitted = fit_candidate(
            space.projector_without(k),
            extension.term,
            fitted_place(extension),
            [extension.values],
            search_event=search_nearby,
        )
        if refitted is not None and not refitted.infeasible and _has_moved(extension, refitted):
            causes[k] = replace(extension, values=refitted.extension.values)
            changed = True
    if not changed:
        return space
    extended = space.refit(causes)
    return extended if extended.convergence.converged else space


def _has_moved(extension: FittedTerm, refitted: FittedCandidate) -> bool:
    """Return whether the new fit has another event time or another held shape.

    A shift by a small share of the time's standard uncertainty does not count.
    """
    is_event = np.isin(
        np.arange(extension.values.size), value_indices(extension.term, role="event")
    )
    is_held = ~np.isin(np.arange(extension.values.size), extension.free_indices)
    shift = np.abs(refitted.extension.values - extension.values)
    event_moved = shift[is_event] > MIN_EVENT_SHIFT_SIGMA * (refitted.event_std or 0.0)
    shape_moved = shift[is_held & ~is_event] > 0.0
    return bool(event_moved.any() or shape_moved.any())


class GainChange(LinearTerm):
    """An additive change of the gain matrix G, row by row."""

    cause = "gain_change"
    part: Part = "sensor"
    stage: Stage = "sensor"
    ignores_clipping: bool = True
    parameters = (
        TermParameter(
            name="gain",
            unit="1",
            typical_size=1e-2,
            lower=-MAX_GAIN_CHANGE,
            upper=MAX_GAIN_CHANGE,
            prior_std=MAX_GAIN_CHANGE,
            components=tuple(f"{row}{column}" for row in "xyz" for column in "xyz"),
        ),
    )
    title = "The gain changes"
    remedy = ""
    covariates = None
    picture = None
    excitation = "fast moves about every axis"
    effect_if_ignored = "none, because the gain is part of the calibration"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return each rate of the stage on each axis of the sensor, (9, blocks, 3)."""
        rates = state.measure_sensor_rate(state.rate_rad_s)
        signals = np.zeros((3, 3, *rates.shape))
        for row in range(3):
            signals[row, :, :, row] = rates.T
        return signals.reshape(GAIN_PARAMETERS, *rates.shape)

    def describe(self, values: FloatArray) -> str:
        """Describe the largest change."""
        return f"the gain is off by up to {np.abs(values).max():.2g}"


def refit_gain_exactly(solution: ConvergedFit, effort: SearchEffort) -> ConvergedFit:
    """Refit the gain by its exact effect; without clipping causes, return the fit unchanged.

    Args:
        solution: the fit.
        effort: of its search; it counts the refits.
    """
    clipping = (cause for cause in solution.fitted_terms if cause.term.stage in CLIPPING_STAGES)
    if not any(cause.is_active for cause in clipping):
        return solution
    for _ in range(MAX_RESTARTS):
        better = _fit_better_gain(solution, effort)
        if better is None:
            break
        solution = better
    return solution


def _fit_better_gain(solution: ConvergedFit, effort: SearchEffort) -> ConvergedFit | None:
    """Return a likelier fit that starts from another gain; None if there is none."""
    projector = NuisanceProjector.at_fit(solution)
    if not _is_gain_score_significant(projector):
        return None
    needed_nats = whittle_log_likelihood(solution) + MIN_GAIN_NATS
    for change in _gain_changes(projector):
        estimate = solution.estimate.copy()
        estimate[:GAIN_PARAMETERS] += change
        restarted = refit_with_terms(replace(solution, estimate=estimate), solution.fitted_terms)
        effort.count(restarted.convergence)
        if restarted.converged and whittle_log_likelihood(restarted) > needed_nats:
            return restarted
    return None


def _gain_changes(projector: NuisanceProjector) -> Iterator[FloatArray]:
    """Yield the changes of the gain to start from, (9,) each.

    If the fits from all start values end at the same change, it comes once.
    """
    fitted: list[FittedCandidate] = []
    for start in START_VALUES:
        candidate = fit_candidate(projector, GainChange(), None, [np.full(GAIN_PARAMETERS, start)])
        if candidate is None or candidate.delta_log_likelihood < MIN_GAIN_NATS:
            continue
        if not any(_is_same_change(candidate, other) for other in fitted):
            fitted.append(candidate)
            yield from _candidate_changes(candidate)


def _is_same_change(candidate: FittedCandidate, other: FittedCandidate) -> bool:
    distance = np.abs(candidate.extension.values - other.extension.values)
    return bool((distance < SAME_CHANGE_SIGMA * other.std).all())


def _candidate_changes(candidate: FittedCandidate) -> list[FloatArray]:
    """Return the change of the observable entries of the gain only, and the whole change.

    If hardly any motion determines an entry, it can have any value within its standard deviation.
    A fit that starts at this value would converge to another optimum.
    """
    whole = candidate.extension.values
    observable = np.where(np.abs(whole) > OBSERVABLE_SIGMA * candidate.std, whole, 0.0)
    return [observable, whole] if 0 < np.count_nonzero(observable) < GAIN_PARAMETERS else [whole]


def _is_gain_score_significant(projector: NuisanceProjector) -> bool:
    """Return whether the score of the gain is significant if all rates count as visible."""
    change = GainChange()
    whitened = projector.evaluate_signals(
        lambda scene: change.tangent_signals(scene, np.zeros(GAIN_PARAMETERS)), term=change
    )
    test = ScoreTest.of(projector.score_statistics(whitened))
    spread = float(np.sqrt(2.0 * max(test.degrees_of_freedom, 1)))
    return test.statistic > test.degrees_of_freedom + SCORE_SIGMA * spread
