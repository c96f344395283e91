"""Checks of a board's entry in a rig file against the protocol that it speaks."""

from typing import TYPE_CHECKING

from gyrorig_protocol.board_protocols import BoardProtocol, find_protocol
from gyrorig_protocol.errors import UsageError

if TYPE_CHECKING:
    from gyrorig_daemon.config.rig_document import BoardPort

PROTOCOL_KEYS = ("columns", "signals", "options")


def validate_protocol(board: "BoardPort", name: str) -> BoardProtocol:
    """Return the protocol of a board after a check of its keys; `name`: of the rig file.

    Raises:
        UsageError: the protocol is not known, or a key is missing, not used or wrong.
    """
    owner = f"{name}: board {board.id}"
    protocol = find_protocol(board.format, bool(board.bus), owner)
    for key in PROTOCOL_KEYS:
        is_used = key in protocol.required_keys or key in protocol.optional_keys
        if getattr(board, key) and not is_used:
            raise UsageError(
                f"{owner} has the key `{key}`, which `format: {board.format}` does not use",
                f"set the `format` that the key `{key}` belongs to, or remove the key",
            )
    for key, remedy in protocol.required_keys.items():
        if not getattr(board, key):
            raise UsageError(
                f"{owner} has `format: {board.format}`, but not the key `{key}`", remedy
            )
    try:
        protocol.check_settings(board, name)
    except UsageError as error:
        if error.problem.startswith(name):
            raise
        raise UsageError(f"{name}: {error.problem}", error.remedy) from error
    return protocol
