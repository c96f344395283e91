"""Reading a recording within limits, and which boards of recordings a command works on."""

from collections.abc import Sequence
from pathlib import Path

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.suggestions import list_closest
from gyrorig_solver.storage import limit_input, size_of_inputs


def select_boards(recording: Recording, wanted: str | None) -> tuple[BoardId, ...]:
    """Return the boards to work on.

    Raises:
        InputError: the wanted board, or any board at all, is not in the recording.
    """
    available = recording.board_ids
    if not available:
        raise InputError(
            f"the recording {recording.path.name} contains no samples of a board",
            "connect a board, check with `gyrorigd doctor` that it answers, and record again",
        )
    if wanted is None:
        return available
    if wanted not in available:
        raise InputError(
            f"the recording {recording.path.name} does not contain board {wanted!r:.50}",
            f"choose one of its boards with --board: {list_closest(wanted, available)}",
        )
    return (BoardId(wanted),)


def recordings_by_board(
    recordings: Sequence[Recording], wanted: str | None
) -> dict[BoardId, list[Recording]]:
    """Return each wanted board with its recordings."""
    by_board: dict[BoardId, list[Recording]] = {}
    for recording in recordings:
        for board in recording.board_ids:
            if wanted is None or board == wanted:
                by_board.setdefault(board, []).append(recording)
    return by_board


def read_within_limits(path: Path) -> Recording:
    """Return a recording, read with the memory and the time that its size permits.

    Raises:
        InputError: it cannot be read, or needs more.
    """
    with limit_input(path.name, size_of_inputs([path])):
        return read_recording(path)
