"""Names of boards, from the names that a source gives its sensors.

What to use when: `board_name` for a topic, a folder or another text; `unique_names` if two boards
of one source can get the same name; `check_unique` before the boards are written.
"""

import re
from collections import Counter
from collections.abc import Sequence

from gyrorig_protocol.errors import UsageError

MAX_NAME_CHARS = 32  # of a `BoardId`


def board_name(text: str, default: str) -> str:
    """Return a text as the name of a board, or `default` if it has no letter and no digit."""
    name = re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-")
    return name[:MAX_NAME_CHARS].strip("-") or default


def unique_names(names: Sequence[str]) -> list[str]:
    """Return the names, with the suffix -2, -3 and so on where one occurs again.

    Args:
        names: valid names of boards; a suffix replaces the end of a name that is too long.
    """
    unique: list[str] = []
    for name in names:
        candidate, number = name, 1
        while candidate in unique or (number > 1 and candidate in names):
            number += 1
            suffix = f"-{number}"
            candidate = name[: MAX_NAME_CHARS - len(suffix)].rstrip("-") + suffix
        unique.append(candidate)
    return unique


def check_unique(names: Sequence[str], source: str) -> None:
    """Check that each board of a source has another name.

    Args:
        names: of the boards.
        source: what was read, for the error.

    Raises:
        UsageError: two boards have one name.
    """
    for name, count in Counter(names).items():
        if count > 1:
            raise UsageError(
                f"the data {source} contain {count} boards with the name {name}, but in one "
                "recording each board needs another name",
                "remove --board if it is given, or import each board alone",
            )
