"""A kind of reference that gives the rate at each time, so that causes can be searched."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.discover import MotionFitSpace, criticise_fit, explain_fit
from gyrorig_solver.estimate import ConvergedFit, FittedTerm, GyroFit
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.board_results import BoardExplanation, CriticisedFit
from gyrorig_solver.pipeline.gain_fit import GainFit
from gyrorig_solver.pipeline.motion_explanation import explain_motion
from gyrorig_solver.pipeline.prepare_board import fit_base, prepare_board
from gyrorig_solver.pipeline.reference_kind import ReferenceKind
from gyrorig_solver.reference import ReferenceMotion
from gyrorig_solver.uncertainty import GainEstimate


@dataclass(frozen=True, slots=True, eq=False)
class MotionGainFit(GainFit):
    """The fit of one recording to its motion."""

    solution: ConvergedFit
    board: str

    @property
    def converged(self) -> bool:
        return self.solution.converged

    def estimate(self, name: str, with_causes: bool) -> GainEstimate:
        return GainEstimate.of(name, self.solution, with_causes)

    def searched(self) -> "MotionGainFit":
        return replace(self, solution=explain_fit(self.solution, self.board).solution_extended)


class MotionKind(ReferenceKind):
    """A reference whose motion is fitted by maximum likelihood, with causes."""

    can_be_searched = True

    @abstractmethod
    def read_motion(self, recording: Recording, samples: GyroSamples) -> ReferenceMotion | None:
        """Return the motion on the samples' time axis, None if the recording has none."""

    def fit(
        self, data: BoardData, extend: Sequence[str] = (), named_terms: Sequence[FittedTerm] = ()
    ) -> GyroFit:
        prepared = prepare_board(data, extend, named_terms)
        return prepared.summarize(prepared.solve())

    def fit_criticised(self, data: BoardData, requested: Sequence[str]) -> CriticisedFit:
        prepared = prepare_board(data, requested)
        solution = prepared.solve()
        criticism = criticise_fit(MotionFitSpace(solution))
        return CriticisedFit(prepared.summarize(solution), solution, criticism=criticism)

    def fit_explained(
        self, data: BoardData, requested: Sequence[str], explanation: BoardExplanation
    ) -> CriticisedFit:
        prepared = prepare_board(data, requested, explanation.findings.fitted_terms)
        search = explanation.fit_explanation
        solution = prepared.solve() if requested or search is None else search.solution_extended
        return CriticisedFit(prepared.summarize(solution), solution, explanation)

    def fit_gain(self, data: BoardData, index: int) -> GainFit | None:
        session = data.sessions[index]
        single = BoardData(data.board, session[:1], (data.samples[index],), (session,))
        if not self.is_given(single):
            return None
        return MotionGainFit(fit_base(single), data.board)

    def explain(self, data: BoardData, held_out: Recording | None) -> BoardExplanation:
        return explain_motion(data, explain_fit(fit_base(data), data.board), held_out)
