"""Rest throughout, which determines bias and noise only."""

from dataclasses import replace

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import REST_REMEDIES
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.board_results import BoardExplanation
from gyrorig_solver.pipeline.motion_kind import MotionKind
from gyrorig_solver.pipeline.rest_check import check_rests
from gyrorig_solver.reference import ReferenceMotion, RestReference, mostly_at_rest, read_turns


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

    def explain(self, data: BoardData, held_out: Recording | None) -> BoardExplanation:
        """Search for the causes of the residual; see `ReferenceKind.explain`."""
        explanation = super().explain(data, held_out)
        warnings = self.fit(data).warnings
        return replace(explanation, remarks=(*explanation.remarks, *data.missing, *warnings))


KIND = RestKind()
