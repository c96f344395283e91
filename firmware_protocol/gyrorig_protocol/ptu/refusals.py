"""Error replies of a pan-tilt unit, classified by remedy.

The texts differ between firmware versions. The table has a pattern for each text that was seen on
real units or is in the command reference manual v3.00D. An unknown text has the kind `UNKNOWN`; it
is never a fault of reading.
"""

import re
from dataclasses import dataclass
from enum import Enum


class RefusalKind(Enum):
    """The kind of an error reply; the value is the remedy."""

    POSITION = "choose a position inside the limits that the unit found at its last reset"
    SPEED = "choose a speed inside the limits of the unit"
    ACCELERATION = "choose an acceleration inside the limits of the unit"
    ILLEGAL_COMMAND = (
        "check the dialect in the rig file, because the controller of the unit does not know "
        "the command"
    )
    ILLEGAL_VALUE = "see the unit's manual for the values that the command accepts"
    UNKNOWN = "see the unit's manual for the meaning of the error"


@dataclass(frozen=True, slots=True)
class Refusal:
    """An error reply (`!`). `bound` is the number in its text, in steps or steps/s."""

    kind: RefusalKind
    bound: int | None
    text: str


_KIND_PATTERNS: tuple[tuple[re.Pattern[str], RefusalKind], ...] = (
    (
        re.compile(r"illegal\s+(command|delimiter)|unknown command", re.I),
        RefusalKind.ILLEGAL_COMMAND,
    ),
    (re.compile(r"acceleration", re.I), RefusalKind.ACCELERATION),
    (re.compile(r"\bspeed\b", re.I), RefusalKind.SPEED),
    (re.compile(r"\b(position|limit)\b", re.I), RefusalKind.POSITION),
    (re.compile(r"\b(value|argument|illegal|range)\b", re.I), RefusalKind.ILLEGAL_VALUE),
)
_BOUND_PATTERN = re.compile(r"(?:^|(?<=\s))[-+]?\d{1,10}(?=\s|$)")


def classify_refusal(text: str) -> Refusal:
    """Classify an error reply by its text, which can be any text."""
    kind = next(
        (kind for pattern, kind in _KIND_PATTERNS if pattern.search(text)), RefusalKind.UNKNOWN
    )
    numbers = _BOUND_PATTERN.findall(text)
    return Refusal(kind, int(numbers[0]) if len(numbers) == 1 else None, text)
