"""A board's fit with its criticism: every solve tests the residual of the fit.

With `auto`, the causes that a search names are part of the model. With a list of causes, or without
any, the model is as requested, and significance tests show which effects remain in the residual.

What to use when: `fit_criticised` for one board; `fit_together` first, if boards were on one unit
at the same time. They share the unit's motion; boards on one CAN bus also share a time base
(`joint_data`). `solve_jointly` fits them if `can_solve_jointly` allows it; the estimator is
`estimate.multi_board_fit`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.discover import MotionFitSpace, criticise_fit
from gyrorig_solver.estimate import (
    MIN_HOMOGENEITY_P,
    ConvergedFit,
    FittedTerm,
    GyroFit,
    fit_boards_jointly,
    homogeneity_p_values,
    is_unit_cause,
)
from gyrorig_solver.model import term_label
from gyrorig_solver.pipeline.board_data import UNIT_TOPIC, BoardData
from gyrorig_solver.pipeline.board_results import BoardExplanation, CriticisedFit
from gyrorig_solver.pipeline.explain_board import explain_data, explain_unit_boards
from gyrorig_solver.pipeline.joint_data import JointData, load_jointly
from gyrorig_solver.pipeline.prepare_board import PreparedBoard, prepare_board
from gyrorig_solver.pipeline.recording_agreement import require_agreement

# Joint fits need memory: 16 boards took 200 MB for recordings of 3.7 MB.
MAX_RECORDING_BYTES = 40_000_000
AUTO = "auto"
MIN_STATED_P = 1e-99


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """One board's result of a joint fit."""

    fit: GyroFit
    solution: ConvergedFit
    disputed: tuple[str, ...] = ()  # causes of the unit about which the boards disagree


def solve_jointly(
    joint_data: JointData,
    extend: Sequence[str] = (),
    named_terms: Mapping[str, Sequence[FittedTerm]] = MappingProxyType({}),
    solutions: Mapping[str, ConvergedFit] = MappingProxyType({}),
) -> dict[str, JointFit | GyrorigError]:
    """Calibrate boards that were on one unit at the same time; see `estimate.multi_board_fit`.

    Each board is fitted separately first. A board that cannot be fitted, or that does not agree
    with the others, keeps its separate result. A cause that belongs to the unit has one size,
    unless the boards disagree about it.

    Args:
        joint_data: of the boards.
        extend: causes of the catalogue to fit to each board.
        named_terms: causes that a search named, by board; those with a prior from the other
            boards belong to the unit.
        solutions: separate fits with these causes that exist already, by board.

    Returns:
        Each board's fit, or the error that prevents it.
    """
    prepared: dict[str, PreparedBoard] = {}
    separate: dict[str, ConvergedFit] = {}
    fits: dict[str, JointFit | GyrorigError] = dict(joint_data.errors)
    for board, data in joint_data.boards.items():
        try:
            prepared[board] = prepare_board(data, extend, named_terms.get(board, ()))
            separate[board] = solutions.get(board) or prepared[board].solve()
        except GyrorigError as fault:
            fits[board] = fault
    labels = _unit_cause_labels(separate.values())
    p_values = homogeneity_p_values(separate.values(), labels)
    differing = {label: p for label, p in p_values.items() if p < MIN_HOMOGENEITY_P}
    joint = fit_boards_jointly(separate, labels - differing.keys())
    for board, separate_solution in separate.items():
        solution = joint.solutions.get(board, separate_solution)
        sharing = joint_data.shared_clock(board)
        if solution is not separate_solution:
            sharing = replace(sharing, fitted_together=len(joint.solutions))
        warnings: tuple[str, ...] = ()
        if board in joint.left_out:
            warnings = (f"this board was solved without the other boards: {joint.left_out[board]}",)
        fitted_labels = {term_label(cause.term) for cause in separate_solution.fitted_terms}
        disputed = tuple(label for label in differing if label in fitted_labels)
        warnings += tuple(
            f"the boards disagree about the size of {label} (p = "
            f"{max(differing[label], MIN_STATED_P):.0e}), so it is a cause of each board's mount "
            "and not of the unit, and the value here is of this board alone; check the screws "
            "between the boards and the unit"
            for label in disputed
        )
        try:
            fit = prepared[board].summarize(solution, warnings, sharing)
            missing = joint_data.boards[board].missing
            fit = replace(fit, warnings=(*missing, *fit.warnings))
            fits[board] = JointFit(fit, solution, disputed)
        except GyrorigError as fault:
            fits[board] = fault
    return fits


def _unit_cause_labels(separate: Iterable[ConvergedFit]) -> frozenset[str]:
    """Return the labels of the unit's causes: by their kind, or by a search in all boards."""
    return frozenset(
        term_label(cause.term)
        for solution in separate
        for cause in solution.fitted_terms
        if cause.other_boards_prior is not None or is_unit_cause(cause.term)
    )


def can_solve_jointly(recordings: Sequence[Recording], boards: Sequence[str]) -> bool:
    """Return whether boards can be fitted together: on one unit, and without too much data."""
    if len(boards) < 2 or not all(UNIT_TOPIC in recording.topics for recording in recordings):
        return False
    if not all(set(boards) <= set(recording.board_ids) for recording in recordings):
        return False
    return sum(recording.path.stat().st_size for recording in recordings) <= MAX_RECORDING_BYTES


def fit_criticised(data: BoardData, extend: Sequence[str]) -> CriticisedFit:
    """Fit one board and criticise the fit.

    Raises:
        InputError: a recording has no reference.
        UsageError: the recordings cannot be solved together, or a cause is unknown.
    """
    data = require_agreement(data)
    requested = tuple(cause for cause in extend if cause != AUTO)
    if AUTO in extend and data.kind.can_be_searched:
        criticised = data.kind.fit_explained(data, requested, explain_data(data))
    else:
        criticised = data.kind.fit_criticised(data, requested)
    warnings = (*data.missing, *criticised.fit.warnings)
    return replace(criticised, fit=replace(criticised.fit, warnings=warnings))


def fit_together(
    recordings: Sequence[Recording],
    boards: Sequence[BoardId],
    method: str = "likelihood",
    extend: Sequence[str] = (AUTO,),
    allow_contradiction: bool = False,
) -> dict[str, CriticisedFit | GyrorigError]:
    """Fit boards that were on one unit at the same time; return each board's fit or its error.

    The result is empty if boards have to be solved separately: with another reference, with the
    paper's method, or with more data than a joint fit can process. With `auto`, the search for
    causes uses all boards together.
    """
    if method != "likelihood" or not can_solve_jointly(recordings, boards):
        return {}
    requested = tuple(cause for cause in extend if cause != AUTO)
    joint_data = load_jointly(recordings, boards, allow_contradiction)
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
            continue
        explanation = explained.get(name)
        criticism = None if explanation else criticise_fit(MotionFitSpace(joint_fit.solution))
        criticised[name] = CriticisedFit(
            joint_fit.fit,
            joint_fit.solution,
            explanation,
            criticism,
            disputed_causes=joint_fit.disputed,
        )
    return criticised


def _extended_solutions(explained: Mapping[str, BoardExplanation]) -> dict[str, ConvergedFit]:
    """Return each board's fit with its named causes."""
    return {
        board: outcome.fit_explanation.solution_extended
        for board, outcome in explained.items()
        if outcome.fit_explanation is not None
    }
