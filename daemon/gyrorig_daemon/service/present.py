"""Which boards of a rig are there and have said who they are."""

from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.rig import Rig


def present_boards(rig: Rig) -> list[BoardLink]:
    """Return the boards that a session can begin with."""
    return [board for board in rig.boards if board.known]


def missing_boards(rig: Rig) -> list[str]:
    """Return the names of the boards that are not there, or have not said who they are."""
    return [str(board.board_id) for board in rig.boards if not board.known]
