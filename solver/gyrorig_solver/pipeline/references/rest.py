"""Rest throughout, which determines bias and noise only."""

from collections.abc import Sequence
from dataclasses import replace

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import REST_REMEDIES, FittedTerm, GyroFit
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.board_results import BoardExplanation, CriticisedFit
from gyrorig_solver.pipeline.motion_kind import MotionKind
from gyrorig_solver.pipeline.rest_check import check_rests
from gyrorig_solver.pipeline.rest_temperature import (
    RestTemperature,
    measure_rests,
    with_bias_change,
    with_unfitted_temperature,
)
from gyrorig_solver.reference import ReferenceMotion, RestReference, mostly_at_rest, read_turns

NOT_TESTED_REMARK = (
    "the causes were not tested on {}, because the bias follows the temperature, and its curve is "
    "of the other recordings"
)


class RestKind(MotionKind):
    """Phases at rest over nine tenths of each recording."""

    title = "phases at rest"
    preference = 40
    remedies = REST_REMEDIES

    def is_given(self, data: BoardData) -> bool:
        """Return whether the board was at rest in all of its recordings."""
        pairs = zip(data.recordings, data.samples, strict=True)
        return all(self.read_motion(*pair) is not None for pair in pairs)

    def read_motion(self, recording: Recording, samples: GyroSamples) -> ReferenceMotion | None:
        """Return the rests, None if they are a smaller part of the recording."""
        rests = read_turns(recording.events(), samples.origin_ns).rests
        if not mostly_at_rest(rests, float(samples.time_s[-1] - samples.time_s[0])):
            return None
        check_rests(recording, samples, rests)
        return RestReference(rests)

    def fit_gain(self, data: BoardData, index: int) -> None:
        """Return None, because rest shows no gain."""

    def fit(
        self, data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
    ) -> GyroFit:
        """Fit the bias; its uncertainty includes its change. See `ReferenceKind.fit`."""
        return with_bias_change(
            super().fit(data, extend, named_terms), measure_rests(data.sessions)
        )

    def fit_criticised(self, data: BoardData, requested: Sequence[str]) -> CriticisedFit:
        """Fit a constant bias, and test it; see `ReferenceKind.fit_criticised`."""
        criticised = super().fit_criticised(data, requested)
        if requested:
            return criticised
        fit = with_bias_change(criticised.fit, measure_rests(data.sessions))
        return replace(criticised, fit=with_unfitted_temperature(fit, RestTemperature.find(data)))

    def fit_explained(
        self, data: BoardData, requested: Sequence[str], explanation: BoardExplanation
    ) -> CriticisedFit:
        """Fit the bias with its curve and the named causes; see `ReferenceKind.fit_explained`."""
        curve = explanation.temperature
        if curve is None:
            criticised = super().fit_explained(data, requested, explanation)
            if criticised.fit.causes:
                return criticised
            fit = with_bias_change(criticised.fit, measure_rests(data.sessions))
            return replace(criticised, fit=fit)
        criticised = super().fit_explained(curve.removed_from(data), requested, explanation)
        return replace(criticised, fit=curve.completed(criticised.fit))

    def explain(self, data: BoardData, held_out: Recording | None) -> BoardExplanation:
        """Search for the causes of the residual; see `ReferenceKind.explain`."""
        curve = RestTemperature.find(data)
        if curve is None:
            explanation = super().explain(data, held_out)
            warnings = self.fit(data).warnings
        else:
            explanation = curve.explained(super().explain(curve.removed_from(data), None))
            warnings = () if held_out is None else (NOT_TESTED_REMARK.format(held_out.path.name),)
        return replace(explanation, remarks=(*explanation.remarks, *data.missing, *warnings))


KIND = RestKind()
