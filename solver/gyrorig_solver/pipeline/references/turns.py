"""Turns by known angles between rests: a rate table, the edge of a table, or turns by hand."""

from collections.abc import Sequence
from dataclasses import dataclass

from gyrorig_solver.estimate import FittedTerm, GyroFit, fit_turns
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.gain_fit import GainFit
from gyrorig_solver.pipeline.reference_kind import ReferenceKind, refuse_causes
from gyrorig_solver.uncertainty import GainEstimate


@dataclass(frozen=True, slots=True, eq=False)
class TurnGainFit(GainFit):
    """The fit of one recording with turns and rests; no search for causes exists for it."""

    fit: GyroFit
    converged = True

    def estimate(self, name: str, with_causes: bool) -> GainEstimate:
        estimate = GainEstimate.of_fit(name, self.fit)
        return estimate.widened_by_rate(self.fit.rate_range_rad_s) if with_causes else estimate


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

    def fit_gain(self, data: BoardData, index: int) -> GainFit | None:
        known_turns = data.known_turns[index]
        if not known_turns.turns or not known_turns.rests:
            return None
        return TurnGainFit(fit_turns([(data.unclipped_samples[index], known_turns)]))


KIND = TurnKind()
