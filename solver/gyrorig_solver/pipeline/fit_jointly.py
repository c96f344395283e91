"""Boards that were on one pan-tilt unit at the same time, fitted together.

They share the unit's motion; boards on one CAN bus also share a time base (`joint_data`).

What to use when: `solve_jointly` where `can_solve_jointly` allows it; the estimator is
`estimate.multi_board_fit`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.gyro_fit import GyroFit
from gyrorig_solver.estimate.multi_board_fit import fit_boards_jointly
from gyrorig_solver.estimate.shared_parameters import is_unit_cause
from gyrorig_solver.model.recording_scope import term_label
from gyrorig_solver.pipeline.board_data import UNIT_TOPIC
from gyrorig_solver.pipeline.fit_board import missing_data
from gyrorig_solver.pipeline.joint_data import JointData
from gyrorig_solver.pipeline.prepare_board import PreparedBoard, prepare_board

# Joint fits need memory: 16 boards took 200 MB for recordings of 3.7 MB.
MAX_RECORDING_BYTES = 40_000_000


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """One board's result of a joint fit."""

    fit: GyroFit
    solution: ConvergedFit


def solve_jointly(
    joint_data: JointData,
    extend: Sequence[str] = (),
    named_terms: Mapping[str, Sequence[FittedTerm]] = MappingProxyType({}),
    solutions: Mapping[str, ConvergedFit] = MappingProxyType({}),
) -> dict[str, JointFit | GyrorigError]:
    """Calibrate boards that were on one unit at the same time; see `estimate.multi_board_fit`.

    Each board is fitted separately first. A board that cannot be fitted, or that does not agree
    with the others, keeps its separate result. A cause that belongs to the unit has one size.

    Args:
        joint_data: of the boards.
        extend: causes of the catalogue to fit to each board.
        named_terms: causes that a search named, by board; those with a prior from the other
            boards belong to the unit.
        solutions: separate fits with these causes that are known already, by board.

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
    joint = fit_boards_jointly(separate, _unit_cause_labels(separate.values()))
    for board, separate_solution in separate.items():
        solution = joint.solutions.get(board, separate_solution)
        extra = joint_data.clock_numbers(board)
        if solution is not separate_solution:
            extra["boards_together"] = float(len(joint.solutions))
        warnings: tuple[str, ...] = ()
        if board in joint.left_out:
            warnings = (f"solved without the other boards: {joint.left_out[board]}",)
        try:
            fit = prepared[board].summarize(solution, warnings, extra)
            fit = replace(fit, warnings=(*missing_data(joint_data.recordings), *fit.warnings))
            fits[board] = JointFit(fit, solution)
        except GyrorigError as fault:
            fits[board] = fault
    return fits


def _unit_cause_labels(separate: Iterable[ConvergedFit]) -> frozenset[str]:
    """Return the labels of causes of the unit: by their kind, or by the search in all boards."""
    return frozenset(
        term_label(cause.term)
        for solution in separate
        for cause in solution.fitted_terms
        if cause.other_boards_prior is not None or is_unit_cause(cause.term)
    )


def can_solve_jointly(recordings: Sequence[Recording], boards: Sequence[str]) -> bool:
    """Return whether boards can be fitted together: on one unit, and not too much data."""
    if len(boards) < 2 or not all(UNIT_TOPIC in recording.topics for recording in recordings):
        return False
    if not all(set(boards) <= set(recording.board_ids) for recording in recordings):
        return False
    return sum(recording.path.stat().st_size for recording in recordings) <= MAX_RECORDING_BYTES
