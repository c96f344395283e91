"""Explanation of one recording as one line of JSON, written before any answer is opened.

What to use when: `explain_recording` for the shipped solver or a replacement of its search;
`make_line` for the stored line.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tests.support.board_fits import explain_recordings

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.data.stream.stream_checks import check_stream
from gyrorig_solver.discover import (
    CALIBRATION_PARAMETERS,
    CauseFindings,
    FitExplanation,
    NamedCause,
)
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.estimate import GAIN_PARAMETERS, SESSION_PARAMETERS, ConvergedFit
from gyrorig_solver.findings import (
    CauseEntry,
    FindingsDocument,
    build_findings_document,
    findings_summary,
)
from gyrorig_solver.findings.findings_builder import FindingsOrigin, RawChecks
from gyrorig_solver.findings.findings_document import BoardEntry, InputEntry
from gyrorig_solver.model import value_indices, value_names
from gyrorig_solver.uncertainty import assess_uncertainty

Explainer = Callable[[Sequence[Recording], str], FitExplanation]
CREATED = "2000-01-01T00:00:00Z"  # a fixed time, so that documents can be compared
DIGITS = 7
BIAS_CAUSES = ("bias_ramp", "bias_step", "thermal_bias", "warm_up")


@dataclass(frozen=True, slots=True, eq=False)
class StatedExplanation:
    """Explanation of one recording, with its fits."""

    recording: Recording
    explanation: FitExplanation
    document: FindingsDocument


def explain_recording(path: Path, explain: Explainer = explain_recordings) -> StatedExplanation:
    """Explain the first board of a recording as `gyrorig explain` does, without pictures."""
    recording = read_recording(path)
    board = recording.board_ids[0]
    raw = [RawChecks(recording.path.name, check_stream(load_samples(recording, board)))]
    explanation = explain([recording], board)
    metadata = recording.metadata.get(f"gyrorig.board.{board}", {})
    profile = find_profile(metadata.get("sensor", ""))
    tolerance = None if profile is None else profile.scale_tolerance
    gain = check_gain(np.asarray(explanation.solution_extended.gain), tolerance)
    raw.append(RawChecks(recording.path.name, gain))
    origin = FindingsOrigin(
        BoardEntry(board, metadata.get("sensor", "")),
        [InputEntry(recording.path.name, recording.sha256)],
        CREATED,
        "",
    )
    return StatedExplanation(
        recording, explanation, build_findings_document(explanation.findings, raw, origin)
    )


def make_line(seed: int, variant: str, stated: StatedExplanation) -> dict[str, Any]:
    """Return the stored line: names, sizes, rest, calibration, limits; plain JSON."""
    findings = stated.explanation.findings
    rest = findings.unexplained
    named = {cause.cause for cause in findings.causes}
    return {
        "seed": seed,
        "variant": variant,
        "verdict": stated.document.verdict,
        "causes": [_describe_cause(cause) for cause in findings.causes],
        "raw": [
            _describe_raw(cause) for cause in stated.document.causes if cause.cause not in named
        ],
        "unexplained": [s.covariate for s in (rest.leading, *rest.others)] if rest else [],
        "signatures": [s.covariate for s in findings.dependence_tests[:3]],
        "nats": _round(findings.gain.log_likelihood.value) if findings.gain else None,
        "calibration": _list_calibration(stated.explanation),
        "total_std": _list_total_std(stated.explanation.solution_extended),
        "absent": [
            [
                detection_limit.cause,
                detection_limit.where,
                _round(detection_limit.size),
                detection_limit.biased_parameter,
                _round(detection_limit.parameter_bias_sigma),
            ]
            for detection_limit in findings.detection_limits
        ],
        "not_testable": sorted({entry.cause for entry in stated.document.not_testable}),
        "harm_printed": _is_harm_printed(findings, stated.document),
        "seconds": round(findings.duration_s, 2),
    }


def _describe_cause(cause: NamedCause) -> dict[str, Any]:
    return {
        "set": list(cause.candidates),
        "where": list(cause.where),
        "values": {v.name: [_round(v.value), _round(v.std)] for v in cause.values},
        "free": int(cause.extension.free_indices.size),
        "sizes": [value_names(cause.term)[k] for k in value_indices(cause.term, role="size")],
        "statistic": _round(cause.statistic),
        "posterior": _round(cause.posterior),
        "rivals": {rival.cause: _round(rival.posterior) for rival in cause.rivals},
        "harm_sigma": _round(cause.parameter_bias_sigma),
        "sigma": {c.parameter: _round(c.sigma) for c in cause.changes[:3]},
    }


def _describe_raw(entry: CauseEntry) -> dict[str, Any]:
    return {"set": [entry.cause, *entry.one_of], "where": entry.where}


def _list_calibration(explanation: FitExplanation) -> dict[str, list[float | None]]:
    """Return value and uncertainty of each parameter with the named causes, and its base value.

    The true bias is the mean over the recording. With a named cause that changes the bias, the
    calibration has the bias at which that cause is zero, so the mean of the cause is added.
    """
    after, before = (
        CalibrationValues.of(explanation.solution_extended),
        CalibrationValues.of(explanation.solution_base),
    )
    value, std = after.values.copy(), after.std.copy()
    shift, variance = _compute_mean_bias_change(explanation.solution_extended)
    at = [k for k, name in enumerate(CALIBRATION_PARAMETERS) if name.startswith("bias.")]
    value[at] += shift
    std[at] = np.where(np.isfinite(std[at]), np.sqrt(variance), np.nan)
    return {
        name: [_round(float(value[k])), _round(float(std[k])), _round(float(before.values[k]))]
        for k, name in enumerate(CALIBRATION_PARAMETERS)
    }


def _list_total_std(solution: ConvergedFit) -> dict[str, float | None]:
    """Return the total standard uncertainty of each parameter, as `gyrorig solve` states it."""
    noise_std, budget_std = CalibrationValues.of(solution).std, assess_uncertainty(solution).std
    total = np.hypot(noise_std, budget_std)
    return {
        name: _round(float(std)) for name, std in zip(CALIBRATION_PARAMETERS, total, strict=True)
    }


def _compute_mean_bias_change(solution: ConvergedFit) -> tuple[FloatArray, FloatArray]:
    """Return the mean bias change of the named causes, (3,), and the variance of the sum."""
    covariance = solution.observability.covariance
    indices = np.arange(GAIN_PARAMETERS, GAIN_PARAMETERS + 3)
    moving = [
        fitted_term
        for fitted_term in solution.fitted_terms
        if fitted_term.term.cause in BIAS_CAUSES
    ]
    if not moving:
        return np.zeros(3), np.diag(covariance)[indices]
    shift, block_count = np.zeros(3), 0
    directions = np.zeros((3, covariance.shape[0]))
    for _, _, model, _, scene in solution.sessions[-1].iter_derivatives(solution.gain):
        block_count += int(model.used.sum())
        at = GAIN_PARAMETERS + SESSION_PARAMETERS
        for fitted_term in solution.fitted_terms:
            if fitted_term.term.cause in BIAS_CAUSES:
                shift += fitted_term.term.effect(scene, fitted_term.values)[model.used].sum(axis=0)
                columns = fitted_term.term.jacobian(scene, fitted_term.values)[
                    fitted_term.free_indices
                ]
                directions[:, at : at + fitted_term.free_indices.size] += (
                    columns[:, model.used].sum(axis=1).T
                )
            at += fitted_term.free_indices.size
    directions /= block_count
    directions[:, indices] += np.eye(3)
    return shift / block_count, np.einsum("ij,jk,ik->i", directions, covariance, directions)


def _is_harm_printed(findings: CauseFindings, document: FindingsDocument) -> bool:
    """Return whether the largest undetected bias is in the document and in the summary."""
    if not findings.detection_limits:
        return True
    worst = max(findings.detection_limits, key=lambda limit: limit.parameter_bias_sigma)
    is_printed = any(
        limit.cause == worst.cause
        and limit.where == worst.where
        and limit.by_sigma is not None
        and math.isclose(limit.by_sigma, worst.parameter_bias_sigma, rel_tol=1e-6)
        for limit in document.minimal_detectable
    )
    return is_printed and f"not detectable here   {worst.cause}" in findings_summary(document)


def _round(value: float) -> float | None:
    """Return a number rounded for the comparison, None if it is not finite."""
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
