"""Explain the residual of a fit to reference attitudes by causes.

The catalogue's causes of the sensor, the clock and the mount are looked for as on a unit: a
pass over all, the leading ones and their siblings fitted exactly, the one of most evidence
kept, until nothing is significant. Two rules more, since here the reference is the noisy side
and nobody knows its noise: scores are judged by how much they vary from one stretch of time to
the next, and a cause whose gain on windows left out is not above zero is not named.

What to use when: `explain_attitudes` from recordings.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover.attitude.attitude_search import (
    RankedAttitudeCause,
    candidate_p_value,
    search_attitude_causes,
)
from gyrorig_solver.discover.attitude.attitude_terms import (
    select_attitude_terms,
)
from gyrorig_solver.discover.attitude.covariate_tests import (
    attitude_dependence_tests,
    covariate_tests,
)
from gyrorig_solver.discover.attitude.window_gains import (
    WINDOW_S,
    cross_validate_space,
    gain_between,
    is_named_cause,
)
from gyrorig_solver.discover.calibration_changes import CalibrationValues, last_recording_part
from gyrorig_solver.discover.cause_findings import (
    CauseFindings,
    DependenceTest,
    FittedValue,
    HeldOutGain,
    NamedCause,
    UnexplainedResidual,
    UntestableCause,
    Verdict,
)
from gyrorig_solver.discover.cause_search import CREDIBLE_SET_LEVEL, FALSE_ALARM_RATE, count_tests
from gyrorig_solver.discover.detection_limits import find_detection_limits
from gyrorig_solver.discover.rival_causes import describe_rivals
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.estimate.attitude.attitude_fit import (
    AttitudeFit,
    solve_attitude,
    summarize_attitude_fit,
)
from gyrorig_solver.estimate.attitude.attitude_projector import (
    AccelerometerReadings,
    AttitudeProjector,
)
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.gyro_fit import GyroFit
from gyrorig_solver.model.gain_matrix import factor_jacobian, factorise
from gyrorig_solver.model.recording_context import RecordingContext
from gyrorig_solver.model.recording_scope import term_label
from gyrorig_solver.model.term import (
    Term,
    components_of,
    value_indices,
    value_names,
    value_parameters,
)
from gyrorig_solver.reference.attitude_reference import AttitudeReference

DESCRIPTIONS = {"moving_bias": "on whether the board moves (the bias changes)"}
ACTING_SIGMA = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeExplanation:
    """Findings, the fit, and the projector of the last fit for figures."""

    findings: CauseFindings
    fit: GyroFit
    space: AttitudeProjector
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeRecording:
    """One recording's samples with its reference attitudes."""

    name: str
    samples: GyroSamples
    reference: AttitudeReference
    context: RecordingContext


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
    space, base_fit = fit_base_space(recordings)
    fit = summarize_attitude_fit(
        base_fit, [(recording.samples, recording.reference) for recording in recordings]
    )
    terms, untestable = select_attitude_terms(space)
    tests = count_tests(terms)
    base_tests = attitude_dependence_tests(space)
    ranked_causes = search_attitude_causes(space, terms, tests)
    final_space = space.with_terms([ranked.candidate.extension for ranked in ranked_causes])
    unexplained = _unexplained_residual(
        ranked_causes, attitude_dependence_tests(final_space), tests
    )
    gain, gain_by_cause = cross_validate_space(final_space)
    calibration = _calibration_values(base_fit, fit)
    causes = [
        _named_cause(
            final_space, k, ranked, calibration, tests, gain_by_cause[k] if gain_by_cause else None
        )
        for k, ranked in enumerate(ranked_causes)
        if is_named_cause(final_space.fitted_terms[k])
    ]
    causes.sort(key=lambda cause: (-cause.parameter_bias_sigma, cause.p_value))
    fitted_labels = {term_label(fitted_term.term) for fitted_term in final_space.fitted_terms}
    remaining_scores = scan_catalogue(
        final_space, [term for term in terms if term_label(term) not in fitted_labels], tests
    )
    detection_limits, undetectable = find_detection_limits(
        final_space, remaining_scores, calibration, space.recording_count
    )
    verdict: Verdict = "explained" if causes else "adequate"
    findings = CauseFindings(
        verdict="unexplained" if unexplained is not None else verdict,
        causes=tuple(causes),
        unexplained=unexplained,
        dependence_tests=tuple(base_tests),
        detection_limits=detection_limits,
        untestable=(
            *(entry for entry in undetectable if entry.cause not in dict(untestable)),
            *(UntestableCause(cause, None, why) for cause, why in untestable),
        ),
        base_terms=fit.terms,
        base_reduced_chi2=fit.reduced_chi2,
        base_whiteness_p=base_tests[0].p_value,
        extended_reduced_chi2=fit.reduced_chi2,
        gain=gain,
        changes=calibration.changes_from(
            calibration.values - _calibration_shift(final_space, space, calibration)
        ),
        duration_s=time.monotonic() - start_s,
        other_recording_gain=None
        if held_out is None
        else gain_on_other_recording(final_space, held_out),
    )
    alternatives = {
        ranked.candidate.extension.term.cause: ranked.candidate.extension.term.reference_alternative
        for ranked in ranked_causes
    }
    remarks = [
        f"{cause.cause}: {alternatives[cause.cause]}"
        for cause in causes
        if alternatives[cause.cause]
    ]
    remarks += [
        _describe_unnamed(ranked, gain_by_cause[k] if gain_by_cause else None)
        for k, ranked in enumerate(ranked_causes)
        if not is_named_cause(ranked.candidate.extension)
    ]
    return AttitudeExplanation(findings, fit, final_space, tuple(remarks))


def fit_base_space(
    recordings: Sequence[AttitudeRecording],
) -> tuple[AttitudeProjector, AttitudeFit]:
    """Fit the base model; return the projector beside it, its scores scaled to their scatter.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    base_fit = solve_attitude(
        [(recording.samples, recording.reference) for recording in recordings]
    )
    forces_read: list[tuple[FloatArray, FloatArray] | None] = []
    for recording in recordings:
        force = recording.samples.accel_m_s2
        forces_read.append(None if force is None else (recording.samples.time_s, force))
    space = AttitudeProjector.at_attitude_fit(
        base_fit,
        [recording.context for recording in recordings],
        AccelerometerReadings(tuple(forces_read)),
    )
    tests = covariate_tests(space.states)
    return space.widen(np.sqrt(space.score_inflation([test.signal for test in tests]))), base_fit


def gain_on_other_recording(
    space: AttitudeProjector, recording: AttitudeRecording
) -> HeldOutGain | None:
    """Return the gain of the named causes on another recording; gain and causes are held.

    Only bias and lag are the other recording's own, in both models. What is a recording's
    own (a step, a slip) is left out there. None where nothing is left.

    Raises:
        InputError: gyro and reference hardly overlap.
    """
    numbered = list(enumerate(space.fitted_terms))
    recording_terms = [k for k, extension in numbered if extension.term.scope == "recording"]
    named_terms = [
        k for k, extension in numbered if k not in recording_terms and is_named_cause(extension)
    ]
    if not named_terms:
        return None
    other_space, _ = fit_base_space([recording])
    residuals = []
    for dropped in ([*recording_terms, *named_terms], recording_terms):
        gain = space.gain + space.best_step(dropped)[:9].reshape(3, 3)
        residuals.append(
            other_space.residual_of_model(
                gain, [extension for k, extension in numbered if k not in dropped]
            )
        )
    windows = other_space.window_numbers(WINDOW_S)
    names = ", ".join(space.fitted_terms[k].term.cause for k in recording_terms)
    description = f"the recording {recording.name}, in which only bias and time offset were fitted"
    if names:
        description += f"; left out, because they are in the other recording only: {names}"
    return gain_between(other_space, windows, description, *residuals)


def _unexplained_residual(
    ranked_causes: Sequence[RankedAttitudeCause], remaining: Sequence[DependenceTest], tests: int
) -> UnexplainedResidual | None:
    unnamed = [
        DependenceTest(
            ranked.candidate.extension.term.cause,
            DESCRIPTIONS[ranked.candidate.extension.term.cause],
            2.0 * ranked.candidate.delta_log_likelihood,
            ranked.candidate.extension.free_indices.size,
            candidate_p_value(ranked.candidate, ranked.effective_trials, tests),
        )
        for ranked in ranked_causes
        if not is_named_cause(ranked.candidate.extension)
    ]
    dependences = (*unnamed, *(test for test in remaining if test.p_value < FALSE_ALARM_RATE))
    if not dependences:
        return None
    named_statistic = sum(
        2.0 * max(ranked.candidate.delta_log_likelihood, 0.0)
        for ranked in ranked_causes
        if is_named_cause(ranked.candidate.extension)
    )
    largest_excess = max(test.statistic - test.degrees_of_freedom for test in dependences)
    return UnexplainedResidual(
        dependences[0],
        dependences[1:],
        named_statistic / (named_statistic + largest_excess) if named_statistic > 0.0 else 0.0,
    )


def _describe_unnamed(ranked: RankedAttitudeCause, gain: HeldOutGain | None) -> str:
    """Describe a significant effect that has no cause."""
    extension = ranked.candidate.extension
    names = value_names(extension.term)
    values_text = ", ".join(
        f"{names[k]} {extension.values[k]:.3g} +- {std:.2g}"
        for k, std in zip(extension.free_indices, ranked.candidate.std, strict=True)
    )
    gain_text = ""
    if gain is not None:
        nats = gain.log_likelihood
        gain_text = f"; {nats.value:.1f} nats ({nats.low:.1f} to {nats.high:.1f}) on data left out"
    unit = extension.term.parameters[0].unit
    description = extension.term.describe(extension.values)
    return f"without a name: {description} ({values_text} {unit}{gain_text})"


def _calibration_values(base_fit: AttitudeFit, fit: GyroFit) -> CalibrationValues:
    """Return the calibration parameters of a fit."""
    factors = factorise(base_fit.solver.gain)
    jacobian = np.eye(13)
    jacobian[:9, :9] = factor_jacobian(factors)
    values = np.concatenate([factors.as_vector(), base_fit.solver.estimate[9:]])
    names = [f"{g}.{p}" for g, ps in _PARAMETER_GROUPS for p in ps] + ["time_offset"]
    std = np.array([fit.std.get(name, np.nan) for name in names])
    return CalibrationValues(values, std, jacobian)


_PARAMETER_GROUPS = (
    ("scale", "xyz"),
    ("nonorthogonality", ("xy", "zx", "zy")),
    ("misalignment", "xyz"),
    ("bias", "xyz"),
)


def _calibration_shift(
    final: AttitudeProjector, base: AttitudeProjector, calibration: CalibrationValues
) -> FloatArray:
    """Return the shift of the calibration by the named causes, (13,)."""
    if not final.fitted_terms:
        return np.zeros(13)
    step = final.best_step()[: base.board_parameters] - base.best_step()
    return calibration.propagate(last_recording_part(step, base.recording_count))


def _named_cause(
    space: AttitudeProjector,
    k: int,
    ranked: RankedAttitudeCause,
    calibration: CalibrationValues,
    tests: int,
    gain: HeldOutGain | None,
) -> NamedCause:
    candidate, extension = ranked.candidate, space.fitted_terms[k]
    term = extension.term
    std = np.full(extension.values.size, np.inf)
    std[extension.free_indices] = candidate.std
    values = tuple(
        FittedValue(name, float(value), float(value_std), parameter.unit, parameter.typical_size)
        for name, value, value_std, parameter in zip(
            value_names(term), extension.values, std, value_parameters(term), strict=True
        )
    )
    names, total = [], ranked.posterior
    for rival, share in ranked.rivals:
        if total >= CREDIBLE_SET_LEVEL:
            break
        names.append(rival.extension.term.cause)
        total += share
    left_out = last_recording_part(candidate.absorbed, space.recording_count)
    return NamedCause(
        term=term,
        where=_acting_parts(term, extension, std),
        extension=extension,
        values=values,
        statistic=2.0 * max(candidate.delta_log_likelihood, 0.0),
        degrees_of_freedom=sum(
            j in value_indices(term, role="size") for j in extension.free_indices
        ),
        p_value=candidate_p_value(candidate, ranked.effective_trials, tests),
        posterior=ranked.posterior,
        one_of=tuple(names),
        rivals=describe_rivals(candidate, ranked.rivals),
        changes=calibration.changes_from(calibration.values + calibration.propagate(left_out)),
        gain=gain,
    )


def _acting_parts(term: Term, extension: FittedTerm, std: FloatArray) -> tuple[str, ...]:
    strength = {
        place: max(
            abs(float(extension.values[j])) / std[j] for j in value_indices(term, place, "size")
        )
        for place in components_of(term)
    }
    acting = tuple(place for place, sigma in strength.items() if sigma > ACTING_SIGMA)
    return acting or tuple(sorted(strength, key=lambda part: -strength[part])[:1])
