"""The motion of a pan-tilt unit, from its commands and its position replies."""

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import UNIT_REMEDIES, ObservabilityReport
from gyrorig_solver.estimate.predicted_observability import predict_observability
from gyrorig_solver.pipeline.board_data import BoardData, has_unit
from gyrorig_solver.pipeline.motion_kind import MotionKind
from gyrorig_solver.reference import ReferenceMotion, read_pan_tilt_reference


class PanTiltKind(MotionKind):
    """A unit in at least one of the recordings; the board rests in the others."""

    title = "a pan-tilt unit"
    preference = 10
    is_suggested = False
    remedies = UNIT_REMEDIES

    def is_given(self, data: BoardData) -> bool:
        """Return whether a recording has a unit."""
        return has_unit(data.recordings)

    def read_motion(self, recording: Recording, samples: GyroSamples) -> ReferenceMotion | None:
        """Return the motion of the unit, None without one."""
        if not has_unit([recording]):
            return None
        return read_pan_tilt_reference(recording, samples.origin_ns)

    def determine_observability(self, data: BoardData) -> ObservabilityReport:
        """Predict what a fit can determine, without the fit."""
        _, samples, motion = data.sessions[0]
        return predict_observability(samples, motion, self.remedies)


KIND = PanTiltKind()
