"""Turns by known angles between rests: a rate table, the edge of a table, or turns by hand."""

from collections.abc import Sequence

from gyrorig_solver.estimate import FittedTerm, GyroFit, fit_turns
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.reference_kind import ReferenceKind, refuse_causes


class TurnKind(ReferenceKind):
    """Phases with the axis and the angle of a turn, and rests in the same or other recordings."""

    title = "known turns"
    preference = 30

    def is_given(self, data: BoardData) -> bool:
        """Return whether a recording has a turn."""
        return any(known_turns.turns for known_turns in data.known_turns)

    def fit(
        self, data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
    ) -> GyroFit:
        del named_terms
        refuse_causes(extend)
        return fit_turns(list(zip(data.unclipped_samples, data.known_turns, strict=True)))


KIND = TurnKind()
