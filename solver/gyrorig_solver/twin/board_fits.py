"""The fits of all boards of a rig, each with the causes that the search names.

They are those of `gyrorig solve`: boards on one unit in the same recordings are fitted together.

What to use when: `fit_boards` for recordings that are already read.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.pipeline import (
    AUTO,
    BoardData,
    CriticisedFit,
    fit_criticised,
    fit_together,
    load_board,
)


@dataclass(slots=True, eq=False)
class BoardFits:
    """The fit of each board, or the error that prevents it."""

    boards: dict[str, BoardData] = field(default_factory=dict)
    fits: dict[str, CriticisedFit] = field(default_factory=dict)
    errors: dict[str, GyrorigError] = field(default_factory=dict)


def fit_boards(recordings: Sequence[Recording], wanted: str | None = None) -> BoardFits:
    """Fit each board to all of its recordings.

    Args:
        recordings: of one rig.
        wanted: only this board.
    """
    by_board: dict[BoardId, list[Recording]] = {}
    for recording in recordings:
        for board in recording.board_ids:
            if wanted is None or board == wanted:
                by_board.setdefault(board, []).append(recording)
    groups: dict[tuple[str, ...], list[BoardId]] = {}
    for board, shared in by_board.items():
        groups.setdefault(tuple(r.sha256 for r in shared), []).append(board)
    result = BoardFits()
    for names in groups.values():
        shared = by_board[names[0]]
        together = fit_together(shared, names)
        for name in names:
            try:
                data = load_board(shared, name)
                fit = together.get(name) or fit_criticised(data, (AUTO,))
                if isinstance(fit, GyrorigError):
                    raise fit
                result.boards[str(name)], result.fits[str(name)] = data, fit
            except GyrorigError as fault:
                result.errors[str(name)] = fault
    return result
