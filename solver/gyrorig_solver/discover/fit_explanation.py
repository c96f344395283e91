"""Explain a fit: search for causes, test them, and assemble the findings.

What to use when: `explain_fit` from a fit of the base model; `assemble_findings` where the search
was made for several boards together.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.discover.calibration_changes import CalibrationValues, last_recording_part
from gyrorig_solver.discover.cause_findings import (
    Attribution,
    CauseFindings,
    DependenceTest,
    FitExplanation,
    FittedValue,
    HeldOutGain,
    NamedCause,
    UnexplainedResidual,
    Verdict,
)
from gyrorig_solver.discover.cause_search import (
    FALSE_ALARM_RATE,
    RankedCause,
    SearchResult,
    count_tests,
    global_p_value,
    search_causes,
    testable_terms,
)
from gyrorig_solver.discover.checks.jitter_cause import detect_jitter
from gyrorig_solver.discover.checks.nonparametric_dominance import dominated_by_nonparametric
from gyrorig_solver.discover.checks.ramp_acceleration import (
    ACCELERATION_ERROR,
    detect_ramp_error,
    without_grid_uncertainty,
)
from gyrorig_solver.discover.checks.random_walk import detect_random_walk
from gyrorig_solver.discover.checks.residual_dependence import residual_dependence_tests
from gyrorig_solver.discover.checks.specification_tests import (
    find_partial_explanations,
    refit_without,
    reject_misnamed,
)
from gyrorig_solver.discover.checks.typical_noise import (
    build_projector,
    has_typical_noise,
    measure_bias_walk,
)
from gyrorig_solver.discover.detection_limits import find_detection_limits
from gyrorig_solver.discover.held_out_gain import cross_validate_causes
from gyrorig_solver.discover.rival_causes import describe_rivals
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fit_summary import BASE_TERMS
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.estimate.uncertainty_widening import reduced_chi2
from gyrorig_solver.model.recording_scope import recording_index_of, term_label
from gyrorig_solver.model.term import components_of, value_indices, value_names, value_parameters

VARIANCE_COVARIATES = ("moving", "acceleration_scatter", "line", "wandering")  # no shape of a mean
DEPENDENCE_FALSE_ALARM_RATE = 0.001  # as `search.ALPHA`, of unexplained dependences
MIN_EXPLAINED_SHARE = 0.8  # minimum share of the dependences that the names must explain
ACTING_SIGMA = 3.0  # a part this many deviations from zero is where a cause acts


def explain_fit(base: ConvergedFit, board: str, start_s: float | None = None) -> FitExplanation:
    """Search for the causes of a base fit's residual.

    Args:
        base: the fit; it is left as it is.
        board: its name.
        start_s: when the work began, `time.monotonic`.
    """
    start_s = time.monotonic() if start_s is None else start_s
    return assemble_findings(base, search_causes(base), board, start_s)


def assemble_findings(
    base: ConvergedFit,
    result: SearchResult,
    board: str,
    start_s: float,
    attributions: Mapping[str, Attribution] | None = None,
) -> FitExplanation:
    """Assemble the findings of a search: checks, limits, gains and calibration changes.

    Args:
        base: the fit of the base model.
        result: where the search ended.
        board: its name.
        start_s: when the work began, `time.monotonic`.
        attributions: of causes by label, where several boards were searched together.
    """
    result, rejecting_tests = reject_misnamed(base, result)
    if any(unobservable := _unobservable_causes(result)):
        result = refit_without(base, result, unobservable)
    tests = count_tests(testable_terms(result.projector))
    jitter = detect_jitter(result.projector, tests, FALSE_ALARM_RATE)
    rejecting_tests += jitter.rejecting_tests
    all_tests = dependence_tests(result.solution, result.projector)
    walk = detect_random_walk(result.solution, tests, FALSE_ALARM_RATE, result.noise_alternatives)
    if walk is not None:
        # The noise levels contain it. Other dependences are separate and come first.
        walk_tests = residual_dependence_tests(NuisanceProjector.at_fit(result.solution))
        if any(test.p_value < DEPENDENCE_FALSE_ALARM_RATE for test in walk_tests):
            walk = None
        else:
            all_tests = walk_tests
    base_tests = (
        dependence_tests(base, NuisanceProjector.at_fit(base))
        if result.ranked_causes
        else all_tests
    )
    remaining_tests = jitter.unexplained_tests(all_tests)
    unexplained = _unexplained_residual(result, remaining_tests, rejecting_tests)
    if unexplained is not None and result.ranked_causes:
        dependences = (unexplained.leading, *unexplained.others)
        dominated = dominated_by_nonparametric(result, dependences, tests, MIN_EXPLAINED_SHARE)
        if unexplained.named_share < MIN_EXPLAINED_SHARE:
            dominated = [
                a or b
                for a, b in zip(
                    dominated,
                    find_partial_explanations(result, dependences, MIN_EXPLAINED_SHARE),
                    strict=True,
                )
            ]
        if any(dominated):
            result = refit_without(base, result, dominated)
            jitter = detect_jitter(result.projector, tests, FALSE_ALARM_RATE)
            remaining_tests = jitter.unexplained_tests(
                dependence_tests(result.solution, result.projector)
                if result.ranked_causes
                else base_tests
            )
            unexplained = (
                _unexplained_residual(result, remaining_tests, rejecting_tests) or unexplained
            )
    calibration = CalibrationValues.of(result.solution)
    fitted = _fitted_causes(result)
    cross_validated = cross_validate_causes(result.projector, [k for k, _ in fitted])
    gain_by_cause = {} if cross_validated is None else cross_validated.by_cause
    causes = [
        _named_cause(result.solution, k, ranked, calibration, tests, gain_by_cause.get(k))
        for k, ranked in fitted
    ]
    owners = attributions or {}
    causes = [replace(cause, attribution=owners.get(term_label(cause.term))) for cause in causes]
    ramps = detect_ramp_error(result.solution, tests, FALSE_ALARM_RATE)
    ramp_error = without_grid_uncertainty(ramps.named)
    causes += [cause for cause in (jitter.named, ramp_error, walk) if cause is not None]
    causes.sort(key=lambda cause: (-cause.parameter_bias_sigma, cause.p_value))
    detection_limits, untestable = find_detection_limits(
        result.projector, result.scores, calibration, len(base.sessions)
    )
    detection_limits += () if jitter.detection_limit is None else (jitter.detection_limit,)
    covered = (
        {ACCELERATION_ERROR} if ramps.named is None else {ACCELERATION_ERROR, ramps.named.cause}
    )
    detection_limits = (
        *(limit for limit in detection_limits if limit.cause not in covered),
        *ramps.detection_limits,
    )
    verdict: Verdict = "explained" if causes else "adequate"
    findings = CauseFindings(
        verdict="unexplained" if unexplained is not None else verdict,
        causes=tuple(causes),
        unexplained=unexplained,
        dependence_tests=tuple(base_tests),
        detection_limits=detection_limits,
        untestable=untestable,
        base_terms=(
            *BASE_TERMS,
            "time_offset",
            *(extension.term.cause for extension in base.fitted_terms),
        ),
        base_reduced_chi2=reduced_chi2(base),
        base_whiteness_p=base_tests[0].p_value,
        extended_reduced_chi2=reduced_chi2(result.solution),
        gain=None if cross_validated is None else cross_validated.combined,
        changes=calibration.changes_from(CalibrationValues.of(base).values),
        duration_s=time.monotonic() - start_s,
    )
    return FitExplanation(board, findings, base, result.solution, result.remarks)


def _unobservable_causes(result: SearchResult) -> list[bool]:
    """Return which causes that are confounded with the gain have no observable size.

    A relative error of the steps equals one of the gain; only the unit's replies separate them.
    Such a name can be accepted before the others; afterwards its effect belongs to the gain.
    """
    unobservable: list[bool] = []
    for k, standing in _fitted_causes(result):
        extension, stds = (
            result.solution.fitted_terms[k],
            _value_stds(result.solution, k, standing.candidate.event_std),
        )
        sizes = [
            j for j in extension.free_indices if j in value_indices(extension.term, role="size")
        ]
        is_share = extension.term.confounded_with_gain and bool(sizes)
        unobservable.append(is_share and all(math.isinf(stds[j]) for j in sizes))
    return unobservable


def _fitted_causes(result: SearchResult) -> list[tuple[int, RankedCause]]:
    """Return each fitted cause's index in the fit, with its ranking."""
    free = [
        k for k, extension in enumerate(result.solution.fitted_terms) if extension.free_indices.size
    ]
    return list(zip(free, result.ranked_causes, strict=True))


def _named_cause(
    solution: ConvergedFit,
    k: int,
    ranked: RankedCause,
    calibration: CalibrationValues,
    tests: int,
    gain: HeldOutGain | None,
) -> NamedCause:
    extension = solution.fitted_terms[k]
    candidate, term = ranked.candidate, extension.term
    sizes = [j for j in extension.free_indices if j in value_indices(term, role="size")]
    left_out = last_recording_part(candidate.absorbed, len(solution.sessions))
    statistic = 2.0 * max(candidate.delta_log_likelihood, 0.0)
    return NamedCause(
        term=term,
        where=_acting_parts(solution, k),
        extension=extension,
        values=_fitted_values(solution, k, candidate.event_std),
        statistic=statistic,
        degrees_of_freedom=len(sizes),
        p_value=global_p_value(candidate, ranked.effective_trials, tests),
        posterior=ranked.posterior,
        one_of=ranked.one_of,
        rivals=describe_rivals(candidate, ranked.rivals),
        changes=calibration.changes_from(calibration.values + calibration.propagate(left_out)),
        gain=gain,
        recording=_recording_name(solution, extension),
    )


def _recording_name(solution: ConvergedFit, extension: FittedTerm) -> str | None:
    """Return the name of the recording to which a cause is limited."""
    number = recording_index_of(extension.term)
    context = None if number is None else solution.sessions[number].context
    return None if context is None else context.recording_name


def _value_stds(solution: ConvergedFit, k: int, event_std: float | None = None) -> list[float]:
    """Return the standard uncertainty of each value of a cause; inf if not observable.

    Args:
        solution: the fit.
        k: which of its causes.
        event_std: of the time of an event, which the fit itself holds.
    """
    extension: FittedTerm = solution.fitted_terms[k]
    first = solution.estimate.size - sum(e.free_indices.size for e in solution.fitted_terms[k:])
    variance = np.diag(solution.observability.covariance)[
        first : first + extension.free_indices.size
    ]
    stds = np.full(extension.values.size, np.inf)
    observable = [
        solution.observability.is_observable(first + j) for j in range(extension.free_indices.size)
    ]
    stds[extension.free_indices] = np.where(
        observable, np.sqrt(np.clip(variance, 0.0, None)), np.inf
    )
    if event_std is not None:
        stds[
            [
                j
                for j in value_indices(extension.term, role="event")
                if j not in extension.free_indices
            ]
        ] = event_std
    return [float(v) for v in stds]


def _fitted_values(
    solution: ConvergedFit, k: int, event_std: float | None
) -> tuple[FittedValue, ...]:
    extension = solution.fitted_terms[k]
    return tuple(
        FittedValue(name, float(value), std, parameter.unit, parameter.typical_size)
        for name, value, std, parameter in zip(
            value_names(extension.term),
            extension.values,
            _value_stds(solution, k, event_std),
            value_parameters(extension.term),
            strict=True,
        )
    )


def _acting_parts(solution: ConvergedFit, k: int) -> tuple[str, ...]:
    """Return the parts with significant sizes of a cause, at least the most significant."""
    extension, stds = solution.fitted_terms[k], _value_stds(solution, k)
    strength = {
        place: max(
            abs(float(extension.values[j])) / stds[j]
            for j in value_indices(extension.term, place, "size")
        )
        for place in components_of(extension.term)
    }
    acting = tuple(place for place, sigma in strength.items() if sigma > ACTING_SIGMA)
    if acting or not strength:
        return acting
    return (max(strength, key=lambda place: strength[place]),)


def dependence_tests(
    solution: ConvergedFit, fitted_noise_projector: NuisanceProjector
) -> list[DependenceTest]:
    """Return the residual dependence tests of a fit, with the bias random walk test."""
    if has_typical_noise(solution):
        return residual_dependence_tests(fitted_noise_projector)
    walk = measure_bias_walk(solution)
    tests = residual_dependence_tests(
        build_projector(solution), None if walk.is_excessive else fitted_noise_projector
    )
    return sorted([*tests, walk.dependence_test], key=lambda test: (test.p_value, -test.statistic))


def _unexplained_residual(
    result: SearchResult, remaining: Sequence[DependenceTest], rejecting: Sequence[DependenceTest]
) -> UnexplainedResidual | None:
    significant = {test.covariate: test for test in rejecting}
    significant |= {
        test.covariate: test for test in remaining if test.p_value < DEPENDENCE_FALSE_ALARM_RATE
    }
    if not significant:
        return None
    # A dependence of the mean also increases the scatter, and is the better hint.
    # Of several that pass for one another the likeliest is, not the least likely by chance.
    ordered = tuple(
        sorted(
            significant.values(),
            key=lambda test: (test.covariate in VARIANCE_COVARIATES, -test.log_evidence),
        )
    )
    named_statistic = sum(
        2.0 * max(_board_gain_nats(ranked), 0.0) for ranked in result.ranked_causes
    )
    largest_excess = max(test.statistic - test.degrees_of_freedom for test in ordered)
    return UnexplainedResidual(
        ordered[0],
        ordered[1:],
        named_statistic / (named_statistic + largest_excess) if named_statistic > 0.0 else 0.0,
    )


def _board_gain_nats(ranked: RankedCause) -> float:
    return (
        ranked.candidate.delta_log_likelihood
        if ranked.board_gain_nats is None
        else ranked.board_gain_nats
    )
