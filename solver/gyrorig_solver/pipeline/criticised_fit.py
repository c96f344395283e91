"""A board's fit with its criticism: every solve asks what the fit leaves.

With `auto` the causes that a search names are part of the model. With a list of causes, or none,
the model is as requested, and significance tests say what it leaves.

What to use when: `fit_criticised` for one board; `fit_together` first where boards were on one
unit at the same time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.discover.fit_criticism import FitCriticism, criticise_fit, criticise_residual
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.gyro_fit import GyroFit
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.explain_board import (
    BoardExplanation,
    explain_data,
    explain_unit_boards,
)
from gyrorig_solver.pipeline.fit_board import fit_board, missing_data
from gyrorig_solver.pipeline.fit_jointly import can_solve_jointly, solve_jointly
from gyrorig_solver.pipeline.joint_data import load_jointly
from gyrorig_solver.pipeline.prepare_board import prepare_board

AUTO = "auto"


@dataclass(frozen=True, slots=True, eq=False)
class CriticisedFit:
    """One board's fit with the result of its search, or with that of significance tests."""

    fit: GyroFit
    solution: ConvergedFit | None  # None where the reference gives no rate at each moment
    explanation: BoardExplanation | None = None  # where causes were searched for
    criticism: FitCriticism | None = None  # where the model was requested


def fit_criticised(data: BoardData, extend: Sequence[str]) -> CriticisedFit:
    """Fit one board and criticise the fit.

    Args:
        data: the board's recordings.
        extend: causes of the catalogue to fit, `auto` for those that a search names.

    Raises:
        InputError: a recording has no reference.
        UsageError: the recordings cannot be solved together, or a cause is unknown.
    """
    requested = tuple(cause for cause in extend if cause != AUTO)
    if AUTO in extend and data.can_be_searched:
        return _fit_explained(data, requested, explain_data(data))
    if not (data.has_unit or data.rests_throughout):
        fit = fit_board(data, requested)
        return CriticisedFit(fit, None, criticism=criticise_residual(fit))
    prepared = prepare_board(data, requested)
    solution = prepared.solve()
    fit = _with_missing_data(data, prepared.summarize(solution))
    return CriticisedFit(fit, solution, criticism=criticise_fit(solution))


def _fit_explained(
    data: BoardData, requested: Sequence[str], explanation: BoardExplanation
) -> CriticisedFit:
    """Return the fit with the named causes, and with requested ones."""
    if explanation.fit_explanation is None:
        fit = explanation.fit if explanation.fit and not requested else fit_board(data, requested)
        return CriticisedFit(fit, None, explanation)
    solution = explanation.fit_explanation.solution_extended
    prepared = prepare_board(data, requested, explanation.findings.fitted_terms)
    if requested:
        solution = prepared.solve()
    fit = _with_missing_data(data, prepared.summarize(solution))
    return CriticisedFit(fit, solution, explanation)


def _with_missing_data(data: BoardData, fit: GyroFit) -> GyroFit:
    return replace(fit, warnings=(*missing_data(data.recordings), *fit.warnings))


def fit_together(
    recordings: Sequence[Recording],
    boards: Sequence[BoardId],
    method: str = "likelihood",
    extend: Sequence[str] = (AUTO,),
) -> dict[str, CriticisedFit | GyrorigError]:
    """Fit boards that were on one unit at the same time; return each board's fit or its error.

    The result is empty where boards have to be solved one by one: another reference, the paper's
    method, or more data than a joint fit takes. With `auto`, causes are searched in all boards
    together.
    """
    if method != "likelihood" or not can_solve_jointly(recordings, boards):
        return {}
    requested = tuple(cause for cause in extend if cause != AUTO)
    joint_data = load_jointly(recordings, boards)
    explained: dict[str, BoardExplanation] = {}
    criticised: dict[str, CriticisedFit | GyrorigError] = {}
    if AUTO in extend:
        for board, outcome in explain_unit_boards(joint_data).items():
            if isinstance(outcome, GyrorigError):
                criticised[str(board)] = outcome
            else:
                explained[str(board)] = outcome
    usable = joint_data.without(criticised)
    named_terms = {board: outcome.findings.fitted_terms for board, outcome in explained.items()}
    solutions = {} if requested else _extended_solutions(explained)
    for name, joint_fit in solve_jointly(usable, requested, named_terms, solutions).items():
        if isinstance(joint_fit, GyrorigError):
            criticised[name] = joint_fit
        elif name in explained:
            criticised[name] = CriticisedFit(joint_fit.fit, joint_fit.solution, explained[name])
        else:
            criticism = criticise_fit(joint_fit.solution)
            criticised[name] = CriticisedFit(joint_fit.fit, joint_fit.solution, criticism=criticism)
    return criticised


def _extended_solutions(explained: Mapping[str, BoardExplanation]) -> dict[str, ConvergedFit]:
    """Return each board's fit with its named causes."""
    return {
        board: outcome.fit_explanation.solution_extended
        for board, outcome in explained.items()
        if outcome.fit_explanation is not None
    }
