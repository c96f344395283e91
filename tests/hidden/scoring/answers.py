"""The hidden answer of a case, opened after the explanation is written; the seal is checked.

What to use when: `cases` for the folders of a corpus, `opened` for one answer.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.model import factorise

SCHEMAS = ("gyrorig/hidden-answer/2", "gyrorig/hidden-answer/1")  # the first: with sizes counted
ANSWER, SEAL, RECORDING = "answer.json", "sealed.txt", "recording.mcap"
HELD, HELD_RATES, RATES = "held.mcap", "held.npz", "rates.npz"
COUNTED = 1000.0  # size of causes that are counted in the stream; noise cannot hide them


class SealError(Exception):
    """An answer does not match its seal, or is not a valid answer."""


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """One thing that was hidden."""

    cause: str  # in the catalogue, or a shape outside it
    place: str | None
    times: float  # size in minimum detectable sizes, from the true non-centrality
    beside_others: float  # the same with the other hidden causes projected out too
    parameters: Mapping[str, float]  # by the truth's names, SI
    noncentrality: float | None = None  # None for causes that are counted


@dataclass(frozen=True, slots=True)
class Answer:
    """Everything that was hidden in a case."""

    seed: int
    kind: str  # null, one, two, many, outside, nearly, unobservable
    tier: str
    program: str
    soak_k: float
    decoy: str | None
    causes: tuple[HiddenCause, ...]
    groups: tuple[
        str, ...
    ]  # covariates, one of which must be the strongest for a shape outside the catalogue
    allowed: tuple[str, ...]  # the right set where a program cannot separate causes
    near: str | None  # the cause that a shape is near to
    calibration: Mapping[str, float]  # the board's, by the names of `PARAMETERS`
    gain: tuple[tuple[float, ...], ...]  # its G = S T M

    @property
    def names(self) -> list[str]:
        """The names of the hidden causes."""
        return [cause.cause for cause in self.causes]


def cases(corpus: Path) -> list[Path]:
    """Return the folders of all complete cases, sorted by seed."""
    folders = [p.parent for p in corpus.glob(f"*/{RECORDING}") if p.parent.name.isdigit()]
    return sorted(folders, key=lambda p: int(p.name))


def sealed(case: Path) -> str:
    """Return the seal of a case's answer, SHA-256; the answer itself stays closed."""
    return (case / SEAL).read_text(encoding="ascii").split()[0]


def opened(case: Path, seal: str) -> Answer:
    """Return a case's answer.

    Args:
        case: its folder.
        seal: as read before the case was explained.

    Raises:
        SealError: the answer does not match its seal, or has another schema.
    """
    raw = (case / ANSWER).read_bytes()
    if hashlib.sha256(raw).hexdigest() != seal:
        raise SealError(f"{case.name}: the answer is not the one that was sealed")
    document = json.loads(raw)
    if document["schema"] not in SCHEMAS or str(document["seed"]) != case.name:
        raise SealError(f"{case.name}: the answer is of another kind or case")
    detectable = float(document.get("detectable", 0.0))
    (board,) = document["truth"]["boards"].values()
    return Answer(
        seed=int(document["seed"]),
        kind=str(document["kind"]),
        tier=str(document["tier"]),
        program=str(document["program"]),
        soak_k=float(document["soak_k"] or 0.0),
        decoy=document.get("decoy"),
        causes=tuple(_cause(entry, detectable) for entry in document["causes"]),
        groups=tuple(document.get("expected_groups") or ()),
        allowed=tuple(document.get("expected_set") or ()),
        near=document.get("near"),
        calibration=_calibration(board, document["causes"]),
        gain=tuple(tuple(map(float, row)) for row in board["STM"]),
    )


def _cause(entry: Mapping[str, Any], detectable: float) -> HiddenCause:
    times, beside_others = entry.get("times_detectable"), entry.get("beside_others")
    seen = COUNTED if times is None else float(times)
    least = float(entry.get("detectable", detectable))
    return HiddenCause(
        cause=str(entry["cause"]),
        place=entry.get("place"),
        times=seen,
        beside_others=seen if beside_others is None else math.sqrt(max(beside_others, 0.0) / least),
        parameters=dict(_flat(entry.get("parameters") or {})),
        noncentrality=entry.get("noncentrality"),
    )


def _flat(parameters: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield each value; values per sensor axis as name.x and so on."""
    for name, parameter in parameters.items():
        value = parameter["value"]
        if isinstance(value, list):
            yield from ((f"{name}.{axis}", float(v)) for axis, v in zip("xyz", value, strict=True))
        else:
            yield name, float(value)


def _calibration(board: Mapping[str, Any], causes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the true calibration of a board, its bias as the recording's mean.

    The time offset is the total lag, including that of a hidden low-pass filter.
    """
    factors = factorise(np.array(board["STM"]))
    offset_s = float(board["time_offset_s"])
    for cause in causes:
        if cause["cause"] == "low_pass_lag":
            change = float(cause["parameters"]["cutoff_change"]["value"])
            # Butterworth, second order: its delay at zero frequency is sqrt(2) / omega.
            delay_s = math.sqrt(2.0) / (2.0 * math.pi * float(board["low_pass"]["cutoff_hz"]))
            offset_s += delay_s * (1.0 / (1.0 + change) - 1.0)
    values = [*factors.as_vector(), *board["mean_bias_rad_s"], offset_s]
    return dict(zip(CALIBRATION_PARAMETERS, map(float, values), strict=True))
