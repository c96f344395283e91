"""What was named beside what an emulated rig hid, in words.

The truth may have been sealed: its SHA-256 was told before the recording began, and is
computed again here. Nothing of the truth reaches the search, which has ended before this.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gyrorig_protocol.errors import InputError
from gyrorig_solver.findings.document import Cause, FindingsDocument
from gyrorig_solver.findings.wording import amount, place

# right: named. among: in the set that was stated. unseen: rightly said to be too small, or not
# to be seen here at all. missed: it should have shown. wrong: named, and not hidden.
Score = Literal["right", "among", "unseen", "missed", "wrong"]


@dataclass(frozen=True, slots=True)
class Scored:
    """One cause, hidden or named."""

    cause: str
    score: Score
    words: str


def open_seal(truth: Mapping[str, Any], told: str | None) -> None:
    """Check that a truth is the one whose seal was told.

    Args:
        truth: the emulator's document.
        told: SHA-256 told at the start, None where nothing was sealed.

    Raises:
        InputError: it is another one.
    """
    if told is None:
        return
    text = json.dumps(truth.get("hidden"), sort_keys=True, separators=(",", ":"))
    if hashlib.sha256(text.encode()).hexdigest() != told:
        raise InputError(
            "the truth is not the one that was sealed: it was changed since, or is another's",
            "give the file that --truth wrote with this recording",
        )


def score(document: FindingsDocument, truth: Mapping[str, Any]) -> list[Scored]:
    """Return each hidden cause and each wrongly named one, with what became of it.

    Raises:
        InputError: the truth cannot be read.
    """
    board = document.board.id
    try:
        hidden = [
            one
            for one in truth.get("hidden", {}).get("causes", [])
            if one["board"] in (None, board)
        ]
        return [*(_of(one, document) for one in hidden), *_wrong(document, hidden)]
    except (KeyError, TypeError, AttributeError, ValueError) as fault:
        raise InputError(
            "the truth cannot be read: it is not that of this recording",
            "give the file that --truth wrote with it",
        ) from fault


def words(document: FindingsDocument, scored: list[Scored]) -> str:
    """Return the scores of one board as lines for a terminal."""
    if not scored:
        nothing = "nothing was hidden, and nothing was named"
        return f"   {document.board.id}: {nothing}"
    return "\n".join(f"   {document.board.id}: {one.words}" for one in scored)


def _of(hidden: Mapping[str, Any], document: FindingsDocument) -> Scored:
    cause, size = str(hidden["cause"]), hidden["size"]
    value, unit = float(size["value"]), str(size["unit"])
    was = f"{cause}{place(str(hidden['where']))}, size {amount(abs(value), unit)}, was hidden"
    for one in document.causes:
        if one.cause == cause and not one.one_of:
            return Scored(cause, "right", f"{was} and named: right{_beside(one, unit)}")
        if cause in (one.cause, *one.one_of):
            names = " or ".join((one.cause, *one.one_of))
            return Scored(cause, "among", f"{was}; named as one of: {names}")
    for limit in document.minimal_detectable:
        if limit.cause == cause and limit.unit == unit and abs(value) < (limit.size or 0.0):
            shows = amount(limit.size, unit)
            return Scored(cause, "unseen", f"{was}; not named, it shows from {shows} on: right")
    for reason in document.not_testable:
        if reason.cause == cause:
            return Scored(cause, "unseen", f"{was}; said not to be visible here: right")
    return Scored(cause, "missed", f"{was} and not named: missed")


def _beside(found: Cause, unit: str) -> str:
    """Return the size that was found, where it is of the unit of the true one."""
    sizes = [abs(s.value) for s in found.parameters.values() if s.unit == unit and s.value]
    return f", found {amount(max(sizes), unit)}" if sizes else ""


def _wrong(document: FindingsDocument, hidden: list[Mapping[str, Any]]) -> Iterator[Scored]:
    true = {str(one["cause"]) for one in hidden}
    for one in document.causes:
        if not true & {one.cause, *one.one_of}:
            names = " or ".join((one.cause, *one.one_of))
            yield Scored(one.cause, "wrong", f"{names} was named and not hidden: wrong")
