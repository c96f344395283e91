"""Scores of the causes that a search named, compared with those that an emulator injected.

The SHA-256 of the truth can be published before the recording; it is checked here. The search
has ended before the truth is read.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gyrorig_protocol.errors import InputError
from gyrorig_solver.findings import CauseEntry, FindingsDocument, amount_text, place_text

# right: named. among: in a set of named alternatives. unseen: reported as too small or not
# testable. missed: it should have been named. wrong: named, but not injected.
InjectionScore = Literal["right", "among", "unseen", "missed", "wrong"]


@dataclass(frozen=True, slots=True)
class ScoredCause:
    """The score of one cause, injected or named."""

    cause: str
    score: InjectionScore
    text: str


def verify_commitment(truth: Mapping[str, Any], commitment: str | None) -> None:
    """Check a truth document against the hash that was published before the recording.

    Raises:
        InputError: the hash differs.
    """
    if commitment is None:
        return
    text = json.dumps(truth.get("hidden"), sort_keys=True, separators=(",", ":"))
    if hashlib.sha256(text.encode()).hexdigest() != commitment:
        raise InputError(
            "the SHA-256 of the hidden causes in the truth file differs from the one that the "
            "daemon printed, so the file was changed or belongs to another recording",
            "give the truth file that `gyrorigd record --truth` wrote for this recording",
        )


def score_causes(document: FindingsDocument, truth: Mapping[str, Any]) -> list[ScoredCause]:
    """Return the score of each injected cause and of each cause named wrongly.

    Raises:
        InputError: the truth cannot be read.
    """
    board = document.board.id
    try:
        injected = [
            cause
            for cause in truth.get("hidden", {}).get("causes", [])
            if cause["board"] in (None, board)
        ]
        return [
            *(_score_injected(cause, document) for cause in injected),
            *_false_positives(document, injected),
        ]
    except (KeyError, TypeError, AttributeError, ValueError) as fault:
        raise InputError(
            "the truth file is not valid, or belongs to another recording",
            "give the truth file that `gyrorigd record --truth` wrote for this recording",
        ) from fault


def score_text(document: FindingsDocument, scored: list[ScoredCause]) -> str:
    """Return the scores of one board as lines for a terminal."""
    if not scored:
        return f"   {document.board.id}: right: the rig had no cause, and the answer names none"
    return "\n".join(f"   {document.board.id}: {scored_cause.text}" for scored_cause in scored)


def _score_injected(injected: Mapping[str, Any], document: FindingsDocument) -> ScoredCause:
    cause, size = str(injected["cause"]), injected["size"]
    value, unit = float(size["value"]), str(size["unit"])
    where = place_text(str(injected["where"]))
    injected_text = f"the rig had {cause}{where}, size {amount_text(cause, abs(value), unit)}"
    for finding in document.causes:
        if finding.cause == cause and not finding.one_of:
            return ScoredCause(
                cause,
                "right",
                f"right: {injected_text}, and the answer names it"
                f"{_estimated_size_text(finding, unit)}",
            )
        if cause in (finding.cause, *finding.one_of):
            names = " or ".join((finding.cause, *finding.one_of))
            return ScoredCause(
                cause, "among", f"in part: {injected_text}, and the answer names one of {names}"
            )
    for limit in document.minimal_detectable:
        if limit.cause == cause and limit.unit == unit and abs(value) < (limit.size or 0.0):
            shows = amount_text(cause, limit.size, unit)
            return ScoredCause(
                cause,
                "unseen",
                f"right: {injected_text}. The answer does not name it, because it is below the "
                f"detectable size {shows}",
            )
    for reason in document.not_testable:
        if reason.cause == cause:
            return ScoredCause(
                cause,
                "unseen",
                f"right: {injected_text}, and the answer states that this recording cannot show it",
            )
    return ScoredCause(cause, "missed", f"missed: {injected_text}, and the answer does not name it")


def _estimated_size_text(finding: CauseEntry, unit: str) -> str:
    """Return the estimated size, if it has the unit of the true size."""
    sizes = [
        abs(size.value) for size in finding.parameters.values() if size.unit == unit and size.value
    ]
    return (
        f", with an estimated size of {amount_text(finding.cause, max(sizes), unit)}"
        if sizes
        else ""
    )


def _false_positives(
    document: FindingsDocument, injected: list[Mapping[str, Any]]
) -> Iterator[ScoredCause]:
    injected_ids = {str(entry["cause"]) for entry in injected}
    for entry in document.causes:
        if not injected_ids & {entry.cause, *entry.one_of}:
            names = " or ".join((entry.cause, *entry.one_of))
            yield ScoredCause(
                entry.cause, "wrong", f"wrong: the answer names {names}, which the rig did not have"
            )
