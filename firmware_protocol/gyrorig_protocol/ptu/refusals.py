"""Why a unit refused a command: its error texts, sorted by what to do.

The texts differ between firmware versions; the table has a pattern for each that was
seen on real units or in the command reference manual v3.00D. An unknown text is
`UNKNOWN`, never a failure to read.
"""

import re
from dataclasses import dataclass
from enum import Enum


class RefusalKind(Enum):
    """What was wrong; the value says what to do."""

    POSITION = "stay inside the limits found by the last reset"
    SPEED = "stay inside the unit's speed bounds"
    ACCELERATION = "choose an acceleration that the unit can do"
    ILLEGAL_COMMAND = "this controller does not know the command: check the dialect"
    ILLEGAL_VALUE = "choose a value that the command takes: see the unit's manual"
    UNKNOWN = "see the unit's manual"


@dataclass(frozen=True, slots=True)
class Refusal:
    """A `!` reply. `bound` is the figure that its text names, in steps or steps/s."""

    kind: RefusalKind
    bound: int | None
    text: str


_KINDS: tuple[tuple[re.Pattern[str], RefusalKind], ...] = (
    (
        re.compile(r"illegal\s+(command|delimiter)|unknown command", re.I),
        RefusalKind.ILLEGAL_COMMAND,
    ),
    (re.compile(r"acceleration", re.I), RefusalKind.ACCELERATION),
    (re.compile(r"\bspeed\b", re.I), RefusalKind.SPEED),
    (re.compile(r"\b(position|limit)\b", re.I), RefusalKind.POSITION),
    (re.compile(r"\b(value|argument|illegal|range)\b", re.I), RefusalKind.ILLEGAL_VALUE),
)
_BOUND = re.compile(r"(?:^|(?<=\s))[-+]?\d{1,10}(?=\s|$)")


def classify_refusal(text: str) -> Refusal:
    """Return the kind of an error reply from its text, which may be anything."""
    kind = next((kind for pattern, kind in _KINDS if pattern.search(text)), RefusalKind.UNKNOWN)
    numbers = _BOUND.findall(text)
    return Refusal(kind, int(numbers[0]) if len(numbers) == 1 else None, text)
