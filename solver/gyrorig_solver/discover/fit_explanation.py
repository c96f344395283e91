"""Explain a fit: search for causes, check them, and assemble the findings.

What to use when: `explain_fit` from a base fit to a motion; `explain_search` if the search was
made for several boards together; `assemble_findings` for a judged model of any kind of reference.
"""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.discover.calibration_changes import (
    CALIBRATION_PARAMETERS,
    CalibrationValues,
)
from gyrorig_solver.discover.cause_findings import (
    Attribution,
    CauseFindings,
    DetectionLimit,
    FitExplanation,
    UntestableCause,
    Verdict,
)
from gyrorig_solver.discover.cause_search import SearchResult, search_causes
from gyrorig_solver.discover.checks.jitter_cause import JitterCheck
from gyrorig_solver.discover.checks.model_check import Check, JudgedModel, judge_model
from gyrorig_solver.discover.checks.ramp_check import RampCheck
from gyrorig_solver.discover.checks.random_walk import RandomWalkCheck
from gyrorig_solver.discover.checks.redundancy import RedundancyCheck
from gyrorig_solver.discover.checks.shared_covariate import SharedCovariateCheck
from gyrorig_solver.discover.checks.specification_tests import SpecificationCheck
from gyrorig_solver.discover.checks.unobservable_share import UnobservableShareCheck
from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.discover.held_out_gain import cross_validate_causes
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.named_causes import name_cause
from gyrorig_solver.discover.score_tests import CandidateScore, scan_catalogue
from gyrorig_solver.discover.testable_terms import form_of, select_testable
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector, nominal_levels
from gyrorig_solver.model import (
    DEG,
    XYZ,
    Term,
    components_of,
    format_list,
    recording_index_of,
    term_label,
    value_indices,
    value_parameters,
    why_not_testable,
)

MOTION_CHECKS: tuple[Check[MotionFitSpace], ...] = (
    SpecificationCheck(),
    SharedCovariateCheck(),
    UnobservableShareCheck(),
    JitterCheck(),
    RampCheck(),
    RandomWalkCheck(),
    RedundancyCheck(),
)


def explain_fit(base: ConvergedFit, board: str) -> FitExplanation:
    """Search for the causes of the residual of a fit to a motion.

    Args:
        base: the fit; the search does not change it.
        board: name of the board.
    """
    start_s, space = time.monotonic(), MotionFitSpace(base)
    return explain_search(space, search_causes(space), board, start_s)


def explain_search(
    base: MotionFitSpace,
    result: SearchResult[MotionFitSpace],
    board: str,
    start_s: float,
    attributions: Mapping[str, Attribution] | None = None,
) -> FitExplanation:
    """Check the result of a search for one board, and assemble its findings.

    Args:
        base: the fit of the base model.
        result: the result of the search.
        board: name of the board.
        start_s: when the work began, `time.monotonic`.
        attributions: of causes by label, if several boards were searched together.
    """
    model = judge_model(JudgedModel(base, result), MOTION_CHECKS)
    findings = assemble_findings(model, start_s, attributions)
    return FitExplanation(
        board, findings, base.solution, model.space.solution, model.result.remarks
    )


def assemble_findings(
    model: JudgedModel[Space],
    start_s: float,
    attributions: Mapping[str, Attribution] | None = None,
) -> CauseFindings:
    """Assemble the findings of a judged model: causes, limits, gains and calibration changes.

    Args:
        model: the model with the verdicts of all checks.
        start_s: when the work began, `time.monotonic`.
        attributions: of causes by label, if several boards were searched together.
    """
    base, space, result = model.base, model.space, model.result
    verdicts = tuple(model.verdicts.values())
    base_tests = (
        base.dependence_tests(base.projector()) if result.ranked_causes else model.dependence_tests
    )
    calibration = space.calibration()
    fitted = [(k, ranked) for k, ranked in model.fitted_causes if model.is_named(k)]
    cross_validated = cross_validate_causes(result.projector, [k for k, _ in fitted])
    gain_by_cause = {} if cross_validated is None else cross_validated.by_cause
    owners = attributions or {}
    causes = [
        replace(
            name_cause(space, k, ranked, calibration, model.tests, gain_by_cause.get(k)),
            attribution=owners.get(term_label(space.fitted_terms[k].term)),
        )
        for k, ranked in fitted
    ]
    causes += [cause for verdict in verdicts for cause in verdict.named]
    causes.sort(key=lambda cause: (-cause.parameter_bias_sigma, cause.p_value))
    limits, untestable = find_detection_limits(space, result.projector, result.scores, calibration)
    covered = frozenset[str]().union(*(verdict.covered_causes for verdict in verdicts))
    limits = (
        *(limit for limit in limits if limit.cause not in covered),
        *(limit for verdict in verdicts for limit in verdict.detection_limits),
    )
    untestable += tuple(cause for verdict in verdicts for cause in verdict.untestable)
    stated = covered | {cause.cause for cause in causes} | {limit.cause for limit in limits}
    stated |= {entry.cause for entry in untestable}
    stated |= {fitted_term.term.cause for fitted_term in space.fitted_terms}
    others = [
        term
        for term in space.terms.values()
        if term.cause not in stated and not term.nameless_description
    ]
    unexplained = model.unexplained
    verdict: Verdict = "explained" if causes else "adequate"
    return CauseFindings(
        verdict="unexplained" if unexplained is not None else verdict,
        causes=tuple(causes),
        unexplained=unexplained,
        dependence_tests=tuple(base_tests),
        detection_limits=limits,
        untestable=(*untestable, *_absorbed_causes(others, result.projector)),
        base_terms=base.base_terms,
        base_reduced_chi2=base.reduced_chi2(),
        base_whiteness_p=base_tests[0].p_value,
        gain=None if cross_validated is None else cross_validated.combined,
        changes=calibration.changes_from(base.calibration().values),
        duration_s=time.monotonic() - start_s,
    )


def find_detection_limits(
    space: FitSpace,
    projection: NuisanceProjector,
    scores: Sequence[CandidateScore],
    calibration: CalibrationValues,
) -> tuple[tuple[DetectionLimit, ...], tuple[UntestableCause, ...]]:
    """Return the minimum detectable size of each cause, and the causes that are not testable.

    Args:
        space: the last fit.
        projection: the nuisance projector at that fit.
        scores: the scores of all candidates at that fit.
        calibration: the calibration of that fit.
    """
    limits: list[DetectionLimit] = []
    untestable: list[UntestableCause] = []
    # The calibration states the bias of the last recording and the time offset of one of them.
    # Causes of the other recordings do not bias it.
    stated = (None, len(space.recording_names) - 1, space.offset_recording)
    scores = [
        score
        for score in scores
        if recording_index_of(score.term) in stated and score.term.occurrence == 1
    ]
    separate_causes = {score.term.cause for score in scores if score.place is not None}
    for score in scores:
        if score.place is None and score.term.cause in separate_causes:
            continue  # reported for each place separately
        parameter = value_parameters(score.term)[value_indices(score.term, score.place, "size")[0]]
        detectable = score.detectable_size
        size = detectable.detectable * parameter.typical_size
        if not np.isfinite(size) or size > max(abs(parameter.lower), abs(parameter.upper)):
            untestable.append(UntestableCause(score.term.cause, score.place, score.term.excitation))
            continue
        bias_sigma = np.abs(calibration.propagate(detectable.parameter_shift)) / calibration.std
        worst = int(np.nanargmax(bias_sigma)) if np.isfinite(bias_sigma).any() else 0
        worst_sigma = float(bias_sigma[worst]) if np.isfinite(bias_sigma[worst]) else 0.0
        limits.append(
            DetectionLimit(
                score.term.cause,
                score.place,
                size,
                parameter.unit,
                parameter.typical_size,
                CALIBRATION_PARAMETERS[worst],
                worst_sigma,
            )
        )
    limits.sort(key=lambda limit: -limit.parameter_bias_sigma)
    return tuple(limits), (
        *untestable,
        *_untestable_causes(space.terms.values(), projection, scores),
    )


def _untestable_causes(
    terms: Iterable[Term], projection: NuisanceProjector, scores: Sequence[CandidateScore]
) -> list[UntestableCause]:
    """Return the causes that this residual cannot test, with the reasons."""
    untestable: list[UntestableCause] = []
    scored = {(score.term.cause, score.place) for score in scores}
    separately_scored = {cause for cause, place in scored if place is not None}
    has_unit = any(state.has_angles for state in projection.states)
    for usual_term in terms:
        term = form_of(usual_term, projection)
        cause = term.cause
        if term.is_of_unit and not has_unit:
            continue
        if term.kind == "gauge":
            untestable.append(UntestableCause(cause, None, term.excitation))
        elif term.is_noise_process:
            untestable.append(UntestableCause(cause, None, _describe_random_walk(projection)))
        elif term.kind in ("effect", "known"):
            missing = why_not_testable(term, projection.states)
            if missing is not None:
                untestable.append(UntestableCause(cause, None, missing))
            elif cause in separately_scored:
                untestable += [
                    UntestableCause(cause, place, term.excitation)
                    for place in components_of(term)
                    if (cause, place) not in scored
                ]
    return untestable


def _absorbed_causes(terms: Iterable[Term], projection: NuisanceProjector) -> list[UntestableCause]:
    """Return the causes of which the fit absorbs the whole effect, with the motion that they need.

    For example, a rest does not distinguish a non-linear scale from the bias.
    """
    testable = {term.cause: term for term in select_testable(terms, projection)}
    scores = scan_catalogue(projection, testable.values(), 1)
    scored = {score.term.cause for score in scores}
    return [
        UntestableCause(cause, None, term.excitation)
        for cause, term in testable.items()
        if cause not in scored
    ]


def _describe_random_walk(projection: NuisanceProjector) -> str:
    """Describe the bias random walk of each axis, relative to that of a typical part."""
    levels = np.mean([segment.noise.levels for segment in projection.segments], axis=0)
    axis_levels = np.sqrt(levels[:, 2])
    typical = np.sqrt([nominal_levels(float(white))[2] for white in levels[:, 0]])
    ratio = format_list(axis_levels / typical, XYZ, "times that of a typical sensor")
    return (
        "the noise model and all uncertainties include the random walk: "
        f"{format_list(axis_levels / DEG, XYZ, 'deg/s after one second')}, {ratio}"
    )
