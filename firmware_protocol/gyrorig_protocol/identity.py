"""Names that become paths and topics, checked once at the edge."""

import re

from gyrorig_protocol.errors import InputError

_BOARD_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,31}")


class BoardId(str):
    """A board's name: letters, digits and dashes, at most 32, not beginning with a dash.

    The only way to make a path or a topic out of what a board, a file or a person
    says is through this type.

    Raises:
        InputError: the text is not such a name.
    """

    __slots__ = ()

    def __new__(cls, text: str) -> "BoardId":
        """Check `text` and return it as a board's name."""
        if not _BOARD_ID.fullmatch(text):
            raise InputError(
                f"{text[:40]!r} is no board name",
                "use letters, digits and dashes, at most 32 of them",
            )
        return super().__new__(cls, text)
