"""Minimum detectable size of every cause not found, and the causes that are not testable."""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.discover.calibration_changes import (
    CALIBRATION_PARAMETERS,
    CalibrationValues,
    last_recording_part,
)
from gyrorig_solver.discover.cause_findings import DetectionLimit, UntestableCause
from gyrorig_solver.discover.checks.jitter_cause import describe_random_walk
from gyrorig_solver.discover.score_tests import CandidateScore
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.recording_scope import recording_index_of
from gyrorig_solver.model.term import components_of, value_indices, value_parameters


def find_detection_limits(
    projection: NuisanceProjector,
    scores: Sequence[CandidateScore],
    calibration: CalibrationValues,
    recording_count: int,
) -> tuple[tuple[DetectionLimit, ...], tuple[UntestableCause, ...]]:
    """Return the minimum detectable size of each cause, and the causes that are not testable.

    Args:
        projection: the nuisance projector at the last fit.
        scores: the scores of all candidates at that fit.
        calibration: the calibration of that fit.
        recording_count: how many there are.
    """
    limits: list[DetectionLimit] = []
    untestable: list[UntestableCause] = []
    # The calibration is the last recording's: what is another's cannot harm it.
    scores = [
        score for score in scores if recording_index_of(score.term) in (None, recording_count - 1)
    ]
    separate_causes = {score.term.cause for score in scores if score.place is not None}
    for score in scores:
        if score.place is None and score.term.cause in separate_causes:
            continue  # reported location by location
        parameter = value_parameters(score.term)[value_indices(score.term, score.place, "size")[0]]
        detectable = score.detectable_size
        size = detectable.detectable * parameter.typical_size
        if not np.isfinite(size) or size > max(abs(parameter.lower), abs(parameter.upper)):
            untestable.append(UntestableCause(score.term.cause, score.place, score.term.excitation))
            continue
        bias_sigma = (
            np.abs(
                calibration.propagate(
                    last_recording_part(detectable.parameter_shift, recording_count)
                )
            )
            / calibration.std
        )
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
    return tuple(limits), (*untestable, *_untestable_causes(projection, scores))


def _untestable_causes(
    projection: NuisanceProjector, scores: Sequence[CandidateScore]
) -> list[UntestableCause]:
    """Return the causes that these residuals cannot test, with the reasons."""
    untestable: list[UntestableCause] = []
    scene = projection.states[0]
    scored = {(score.term.cause, score.place) for score in scores}
    for cause, term in catalogue().items():
        if term.kind == "gauge":
            untestable.append(UntestableCause(cause, None, term.excitation))
        elif term.is_noise_process:
            untestable.append(UntestableCause(cause, None, describe_random_walk(projection)))
        elif term.kind in ("effect", "known"):
            missing = term.reason_not_testable(scene)
            if missing is not None:
                untestable.append(UntestableCause(cause, None, missing))
            elif any(c == cause for c, _ in scored):
                candidate_places = [
                    p for p in components_of(term) if p in ("pan", "tilt", "x", "y", "z")
                ]
                untestable += [
                    UntestableCause(cause, place, term.excitation)
                    for place in candidate_places
                    if len(candidate_places) > 1
                    and (cause, place) not in scored
                    and any(p is not None for c, p in scored if c == cause)
                ]
    return untestable
