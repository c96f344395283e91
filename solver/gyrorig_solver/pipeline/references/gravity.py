"""Gravity between rests of a board with an accelerometer, turned by hand."""

from collections.abc import Sequence

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.estimate import FittedTerm, GyroFit, fit_gravity
from gyrorig_solver.model import STANDARD_GRAVITY_M_S2
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.reference_kind import ReferenceKind, refuse_causes


class GravityKind(ReferenceKind):
    """The accelerometer of the board, in one recording."""

    title = "the board's accelerometer"
    preference = 50

    def is_given(self, data: BoardData) -> bool:
        """Return whether a recording has accelerations."""
        return any(samples.accel_m_s2 is not None for samples in data.samples)

    def fit(
        self, data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
    ) -> GyroFit:
        del named_terms
        refuse_causes(extend)
        if len(data.recordings) > 1:
            raise UsageError(
                f"the {len(data.recordings)} recordings cannot be solved together, because gravity "
                "between rests is their only reference, and a fit to gravity takes one "
                "recording",
                "run `gyrorig solve` once for each recording",
            )
        (recording,), (samples,) = data.recordings, data.unclipped_samples
        (known_turns,) = data.known_turns
        site = recording.metadata.get("gyrorig.site", {})
        gravity = positive_number(site, "gravity_m_s2") or STANDARD_GRAVITY_M_S2
        return fit_gravity(samples, gravity, known_turns.rests[0] if known_turns.rests else None)


KIND = GravityKind()
