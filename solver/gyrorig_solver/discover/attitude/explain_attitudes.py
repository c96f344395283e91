"""Explain the residual of a fit to reference attitudes by causes.

What to use when: `explain_attitudes` from recordings.
"""

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
from gyrorig_solver.discover.cause_search import search_causes
from gyrorig_solver.discover.checks.model_check import Check, JudgedModel, Verdict, judge_model
from gyrorig_solver.discover.fit_explanation import assemble_findings
from gyrorig_solver.discover.fitted_values import value_stds
from gyrorig_solver.discover.held_out_gain import compare_residuals, cross_validate_causes
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.model import value_names


class NamelessCheck:
    """States an effect that is compared like a cause, and has no name, as unexplained."""

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
    """Findings, the fit of the base model, and the fit with all causes for figures."""

    findings: CauseFindings
    fit: GyroFit
    space: AttitudeFitSpace
    remarks: tuple[str, ...]


def explain_attitudes(
    recordings: Sequence[AttitudeRecording], held_out: AttitudeRecording | None = None
) -> AttitudeExplanation:
    """Find what gain, bias and lag leave of one board's rates, compared with attitudes.

    Args:
        recordings: of one board; bias and lag are free in each of them.
        held_out: another recording, on which the named causes are tested.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    start_s = time.monotonic()
    base = fit_attitude_space(recordings)
    model = judge_model(JudgedModel(base, search_causes(base)), ATTITUDE_CHECKS)
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
    return AttitudeExplanation(findings, base.fit, model.space, tuple(remarks))


def gain_on_other_recording(
    space: AttitudeFitSpace, recording: AttitudeRecording
) -> HeldOutGain | None:
    """Return the gain of the named causes on another recording; gain and causes are held.

    Only bias and lag are the other recording's own, in both models. What is a recording's
    own (a step, a slip) is left out there. None where nothing is left.

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
        remaining = [term for k, term in enumerate(space.fitted_terms) if k not in dropped]
        residuals.append(other.residual_of_model(gain, remaining))
    how = f"the recording {recording.name}, in which only bias and time offset were fitted"
    if left_out:
        names = ", ".join(terms[k].cause for k in left_out)
        how += f"; without the causes that only the other recording has: {names}"
    return compare_residuals(other, how, *residuals)


def _describe(space: AttitudeFitSpace, k: int) -> str:
    extension, stds = space.fitted_terms[k], value_stds(space, k)
    names, unit = value_names(extension.term), extension.term.parameters[0].unit
    values_text = ", ".join(
        f"{names[j]} {extension.values[j]:.3g} +- {stds[j]:.2g}" for j in extension.free_indices
    )
    gains, gain_text = cross_validate_causes(space.projector(), [k]), ""
    if gains is not None:
        nats = gains.combined.log_likelihood
        gain_text = f"; {nats.value:.1f} nats ({nats.low:.1f} to {nats.high:.1f}) on data left out"
    description = extension.term.describe(extension.values)
    return f"without a name: {description} ({values_text} {unit}{gain_text})"
