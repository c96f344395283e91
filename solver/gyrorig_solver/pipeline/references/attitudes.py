"""Reference attitudes: motion capture, a robot arm, the pose of a vehicle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.messages import REFERENCE_ATTITUDE_TOPIC
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_solver.calibration.unexplained_effect import widen_by_unexplained
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover import AttitudeFitSpace, criticise_fit
from gyrorig_solver.discover.attitude.attitude_space import (
    AttitudeRecording,
    fit_attitude_space,
)
from gyrorig_solver.discover.attitude.explain_attitudes import (
    explain_attitudes,
    extend_attitudes,
)
from gyrorig_solver.estimate import FittedTerm, GyroFit
from gyrorig_solver.findings import unexplained_bias_sigma
from gyrorig_solver.model import find_term
from gyrorig_solver.pipeline.board_data import BoardData, load_board
from gyrorig_solver.pipeline.board_results import (
    NO_CAUSE_REMARK,
    BoardExplanation,
    CriticisedFit,
    check_fitted_gain,
    check_raw_streams,
)
from gyrorig_solver.pipeline.gain_fit import GainFit
from gyrorig_solver.pipeline.recording_contexts import read_contexts
from gyrorig_solver.pipeline.reference_kind import ReferenceKind
from gyrorig_solver.pipeline.term_selection import check_fittable
from gyrorig_solver.reference import AttitudeReference, read_attitude
from gyrorig_solver.report.report_series import series_of_attitudes
from gyrorig_solver.uncertainty import GainEstimate, assess_space


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeGainFit(GainFit):
    """The fit of one recording to its reference attitudes."""

    recording: AttitudeRecording
    space: AttitudeFitSpace
    fit: GyroFit
    bias_sigma: float = 0.0  # by an effect that the search found and could not name

    @property
    def converged(self) -> bool:
        return self.space.at.solved.solver.converged

    def estimate(self, name: str, with_causes: bool) -> GainEstimate:
        temperature = self.recording.context.temperature
        return GainEstimate.of_fit(
            name,
            self.fit,
            widen_by_unexplained(assess_space(self.space), self.fit, self.bias_sigma)
            if with_causes
            else None,
            float("nan") if temperature is None else temperature.mean_degc,
        )

    def searched(self) -> "AttitudeGainFit":
        explanation = explain_attitudes([self.recording])
        unexplained = explanation.findings.unexplained
        return AttitudeGainFit(
            self.recording,
            explanation.space,
            explanation.fit,
            0.0 if unexplained is None else unexplained_bias_sigma(unexplained),
        )


class AttitudeKind(ReferenceKind):
    """Attitudes on a separate topic; recordings without them are left out."""

    title = "reference attitudes"
    preference = 20
    can_be_searched = True

    def is_given(self, data: BoardData) -> bool:
        """Return whether a recording has attitudes."""
        return any(has_attitudes(recording) for recording in data.recordings)

    def fit(
        self, data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
    ) -> GyroFit:
        del named_terms  # `fit_explained` has the fit with them
        check_fittable(extend)
        space, remarks = _extended_space(data, extend)
        return space.summarize((*_left_out_remarks(data), *remarks))

    def fit_criticised(self, data: BoardData, requested: Sequence[str]) -> CriticisedFit:
        check_fittable(requested)
        space, remarks = _extended_space(data, requested)
        return CriticisedFit(
            space.summarize((*_left_out_remarks(data), *remarks)),
            None,
            criticism=criticise_fit(space),
            attitude_space=space,
        )

    def fit_explained(
        self, data: BoardData, requested: Sequence[str], explanation: BoardExplanation
    ) -> CriticisedFit:
        space = explanation.attitude_space
        if space is None:
            return super().fit_explained(data, requested, explanation)
        check_fittable(requested)
        extended, remarks = extend_attitudes(space, requested)
        return CriticisedFit(
            extended.summarize((*_left_out_remarks(data), *remarks)),
            None,
            explanation,
            attitude_space=extended,
        )

    def fit_gain(self, data: BoardData, index: int) -> GainFit | None:
        recordings, samples = data.recordings[index : index + 1], data.samples[index : index + 1]
        attitudes = load_attitude_recordings(BoardData(data.board, recordings, samples))
        if not attitudes:
            return None
        space = fit_attitude_space(attitudes)
        return AttitudeGainFit(attitudes[0], space, space.fit)

    def explain(self, data: BoardData, held_out: Recording | None) -> BoardExplanation:
        usable = tuple(r for r in data.recordings if has_attitudes(r))
        held = [] if held_out is None else _load_held_out(held_out, data.board)
        explanation = explain_attitudes(load_attitude_recordings(data), *held)
        fit, remarks = explanation.fit, list(explanation.remarks)
        if held_out is not None and explanation.findings.other_recording_gain is None:
            remarks.append(NO_CAUSE_REMARK.format(held_out.path.name))
        return BoardExplanation(
            board=BoardId(data.board),
            recordings=usable,
            findings=explanation.findings,
            raw_checks=(*check_raw_streams(data), check_fitted_gain(data, fit.gain)),
            report_series=series_of_attitudes(explanation),
            remarks=(
                *_left_out_remarks(data),
                *fit.warnings,
                *fit.refused_reasons,
                *fit.limited_reasons,
                *remarks,
            ),
            fit_explanation=None,
            fit=fit,
            attitude_space=explanation.space,
        )


KIND = AttitudeKind()


def _extended_space(
    data: BoardData, requested: Sequence[str]
) -> tuple[AttitudeFitSpace, tuple[str, ...]]:
    """Return the fit of a board with requested causes, and the remarks about them."""
    fits_sawtooth = any(find_term(cause).template_search == "lag_series" for cause in requested)
    base = fit_attitude_space(load_attitude_recordings(data), keep_sawtooth=fits_sawtooth)
    return extend_attitudes(base, requested)


def _left_out_remarks(data: BoardData) -> tuple[str, ...]:
    """Return a remark for each recording that the fit does not use."""
    return tuple(
        f"the recording {name} was left out, because it has no reference attitudes"
        for name, recording in zip(data.names, data.recordings, strict=True)
        if not has_attitudes(recording)
    )


def has_attitudes(recording: Recording) -> bool:
    """Return whether a recording has reference attitudes."""
    return REFERENCE_ATTITUDE_TOPIC in recording.topics


def attitude_reference(recording: Recording, samples: GyroSamples) -> AttitudeReference:
    """Return a recording's attitudes on its samples' time axis.

    Raises:
        InputError: no attitude is usable.
    """
    raw = recording.reference_attitude()
    time_s = np.asarray((times_ns(raw["host_time"]) - samples.origin_ns) * 1e-9, np.float64)
    about = recording.metadata.get("gyrorig.reference", {})
    return read_attitude(
        time_s,
        raw["orientation"],
        raw["standard_deviation"],
        about.get("stamp", ""),
        positive_number(about, "rate_hz"),
    )


def load_attitude_recordings(data: BoardData) -> list[AttitudeRecording]:
    """Return a board's recordings that have reference attitudes, ready to be explained.

    Raises:
        InputError: no attitude of a recording is usable, or an axis of the gyro did not measure.
    """
    loaded = [
        (recording, samples, None)
        for recording, samples in zip(data.recordings, data.unclipped_samples, strict=True)
        if has_attitudes(recording)
    ]
    return [
        AttitudeRecording(
            context.recording_name, samples, attitude_reference(recording, samples), context
        )
        for (recording, samples, _), context in zip(loaded, read_contexts(loaded), strict=True)
    ]


def _load_held_out(recording: Recording, board: str) -> list[AttitudeRecording]:
    if not has_attitudes(recording):
        raise UsageError(
            f"the recording {recording.path.name} has no reference attitudes, so the causes that "
            "were found with attitudes cannot be tested on it",
            "give a recording with reference attitudes as --held-out",
        )
    return load_attitude_recordings(load_board([recording], board))
