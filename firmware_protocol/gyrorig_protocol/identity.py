"""Board names, checked once on input, because they become paths and topics."""

import re

from gyrorig_protocol.errors import InputError

_BOARD_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]{0,31}")


class BoardId(str):
    """A board's name: letters, digits and dashes, at most 32, not beginning with a dash.

    Text from a board, a file or a person becomes part of a path or a topic only through this type.

    Raises:
        InputError: the text is not such a name.
    """

    __slots__ = ()

    def __new__(cls, text: str) -> "BoardId":
        """Check `text`."""
        if not _BOARD_ID.fullmatch(text):
            raise InputError(
                f"{text[:40]!r} is not a valid board name",
                "choose a name of at most 32 letters, digits and dashes that begins with a "
                "letter or a digit",
            )
        return super().__new__(cls, text)
