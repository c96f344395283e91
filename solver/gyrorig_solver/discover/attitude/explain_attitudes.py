"""Explain the residual of a fit to reference attitudes by causes."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from gyrorig_solver.discover.attitude.attitude_space import (
    AttitudeFitSpace,
    AttitudeRecording,
    fit_attitude_space,
)
from gyrorig_solver.discover.candidate_fits import global_p_value
from gyrorig_solver.discover.cause_findings import CauseFindings, DependenceTest, HeldOutGain
from gyrorig_solver.discover.cause_search import SearchResult, search_causes
from gyrorig_solver.discover.checks.model_check import Check, JudgedModel, Verdict, judge_model
from gyrorig_solver.discover.fit_explanation import assemble_findings
from gyrorig_solver.discover.fitted_values import value_stds
from gyrorig_solver.discover.held_out_gain import compare_residuals, cross_validate_causes
from gyrorig_solver.estimate import GyroFit, free_term
from gyrorig_solver.model import value_names, why_not_testable

MAX_SEARCHES = 3  # after the first one


class NamelessCheck:
    """Reports an effect that is compared like a cause, but has no name, as unexplained."""

    removes_names = False

    def judge(self, model: JudgedModel[AttitudeFitSpace]) -> Verdict:
        """Return the tests of the nameless effects, and their sizes as remarks."""
        tests, remarks = [], []
        for k, ranked in model.fitted_causes:
            term, candidate = model.space.fitted_terms[k].term, ranked.candidate
            if model.is_named(k):
                continue
            tests.append(
                DependenceTest(
                    term.cause,
                    term.nameless_description,
                    ranked.statistic,
                    candidate.extension.free_indices.size,
                    global_p_value(candidate, ranked.effective_trials, model.tests),
                    log_evidence=candidate.log_evidence,
                )
            )
            remarks.append(_describe(model.space, k))
        return Verdict(rejecting_tests=tuple(tests), remarks=tuple(remarks))


ATTITUDE_CHECKS: tuple[Check[AttitudeFitSpace], ...] = (NamelessCheck(),)


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeExplanation:
    """Findings, and the fit with all causes."""

    findings: CauseFindings
    fit: GyroFit
    space: AttitudeFitSpace
    remarks: tuple[str, ...]


def explain_attitudes(
    recordings: Sequence[AttitudeRecording], held_out: AttitudeRecording | None = None
) -> AttitudeExplanation:
    """Find the causes of the residual that gain, bias and lag leave in the rates of one board.

    Args:
        recordings: recordings of one board; each has its own bias and lag.
        held_out: another recording, on which the named causes are tested.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    start_s = time.monotonic()
    model = _judged_search(fit_attitude_space(recordings, keep_sawtooth=True))
    if any(resolved.has_sawtooth for resolved in model.space.at.solved.resolved) and not any(
        fitted_term.term.template_search == "lag_series" for fitted_term in model.space.fitted_terms
    ):
        # The search did not find the saw-tooth, so the correction of the times is the better model.
        model = _judged_search(fit_attitude_space(recordings))
    findings = assemble_findings(model, start_s)
    if held_out is not None:
        gain = gain_on_other_recording(model.space, held_out)
        findings = replace(findings, other_recording_gain=gain)
    remarks = [
        *model.result.remarks,
        *(
            f"{cause.cause}: {cause.term.reference_alternative}"
            for cause in findings.causes
            if cause.term.reference_alternative
        ),
        *(remark for verdict in model.verdicts.values() for remark in verdict.remarks),
    ]
    return AttitudeExplanation(findings, model.space.summarize(), model.space, tuple(remarks))


def _judged_search(base: AttitudeFitSpace) -> JudgedModel[AttitudeFitSpace]:
    """Return the result of the search for causes from a base model, judged by the checks."""
    return judge_model(JudgedModel(base, search_attitudes(base)), ATTITUDE_CHECKS)


def search_attitudes(base: AttitudeFitSpace) -> SearchResult[AttitudeFitSpace]:
    """Search for causes, and repeat the search from a fit that contains the causes found.

    A large cause increases the residual, from which the noise is estimated. It also changes the
    gain, about which the model is linear. Both are right only after the fit contains the cause.
    """
    result = search_causes(base)
    for _ in range(MAX_SEARCHES):
        if not result.space.fitted_terms:
            break
        labels = result.space.labels
        result = search_causes(result.space.relinearised())
        if result.space.labels == labels:
            return result
    if result.space.fitted_terms:
        space = result.space.relinearised()
        return replace(result, space=space, projector=space.projector())
    return replace(result, space=base, projector=base.projector())


def extend_attitudes(
    space: AttitudeFitSpace, causes: Sequence[str]
) -> tuple[AttitudeFitSpace, tuple[str, ...]]:
    """Return the fit with requested causes, and a remark for each that it cannot contain."""
    added, remarks = list(space.fitted_terms), []
    states = space.base.states
    for cause in dict.fromkeys(causes):
        if cause in (fitted_term.term.cause for fitted_term in added):
            continue
        term = space.terms[cause]
        reasons = [why_not_testable(term, [state]) for state in states]
        if all(reason is not None for reason in reasons):
            remarks.append(f"the cause {cause} was not fitted: {reasons[0]}")
            continue
        added.append(free_term(term))
    if len(added) == len(space.fitted_terms):
        return space, tuple(remarks)
    return space.refit(added).relinearised(), tuple(remarks)


def gain_on_other_recording(
    space: AttitudeFitSpace, recording: AttitudeRecording
) -> HeldOutGain | None:
    """Return the gain of the named causes on another recording; None if no cause applies to it.

    Gain and causes are held. In both models, only bias and lag are fitted to the other recording.
    Causes of a single recording, such as a step or a slip, are left out.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    terms = [fitted_term.term for fitted_term in space.fitted_terms]
    left_out = [k for k, term in enumerate(terms) if term.scope == "recording"]
    named = [
        k for k, term in enumerate(terms) if k not in left_out and not term.nameless_description
    ]
    if not named:
        return None
    projector, other = space.projector(), fit_attitude_space([recording]).base
    residuals = []
    for dropped in ([*left_out, *named], left_out):
        gain = projector.gain + projector.best_step(dropped)[:9].reshape(3, 3)
        residuals.append(other.residual_of_model(gain, space.terms_without(*dropped)))
    how = f"the recording {recording.name}, in which only bias and time offset were fitted"
    if left_out:
        names = ", ".join(terms[k].cause for k in left_out)
        how += f"; without the causes that only the other recording has: {names}"
    return compare_residuals(other, how, *residuals)


def _describe(space: AttitudeFitSpace, k: int) -> str:
    extension, stds = space.fitted_terms[k], value_stds(space, k)
    names, unit = value_names(extension.term), extension.term.parameters[0].unit
    values_text = ", ".join(
        f"{names[j]} {extension.values[j]:.3g} ± {stds[j]:.2g}" for j in extension.free_indices
    )
    gains, gain_text = cross_validate_causes(space.projector(), [k]), ""
    if gains is not None:
        nats = gains.combined.log_likelihood
        gain_text = f"; {nats.value:.1f} nats ({nats.low:.1f} to {nats.high:.1f}) on data left out"
    description = extension.term.describe(extension.values)
    return f"without a name: {description} ({values_text} {unit}{gain_text})"
