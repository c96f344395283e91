"""Open the hidden answer of a case after its explanation, and check its seal.

What to use when: `list_cases` for the folders of a corpus, `open_answer` for one answer.
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

# The first schema states the number of sizes.
SCHEMAS = ("gyrorig/hidden-answer/2", "gyrorig/hidden-answer/1")
ANSWER, SEAL, RECORDING = "answer.json", "sealed.txt", "recording.mcap"
SECOND_RECORDING, SECOND_RATES, RATES = "held.mcap", "held.npz", "rates.npz"
COUNTED_TIMES = 1000.0  # size of causes that are counted in the stream; noise cannot hide them


class SealError(Exception):
    """An answer does not match its seal, or is not a valid answer."""


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """One hidden cause or shape."""

    cause: str  # in the catalogue, or a shape outside it
    place: str | None
    times: float  # size in minimum detectable sizes, from the true non-centrality
    times_with_others: float  # the same with the other hidden causes projected out too
    parameters: Mapping[str, float]  # SI values by the names of the truth
    noncentrality: float | None = None  # None for causes with a count


@dataclass(frozen=True, slots=True)
class Answer:
    """All hidden effects of a case, and the true calibration."""

    seed: int
    kind: str  # null, one, two, many, outside, nearly, unobservable
    tier: str
    program: str
    soak_k: float
    decoy: str | None
    causes: tuple[HiddenCause, ...]
    # covariates, one of which must be the strongest for a shape outside the catalogue
    groups: tuple[str, ...]
    allowed: tuple[str, ...]  # the right set if a program cannot separate causes
    near: str | None  # the cause that is similar to a shape
    calibration: Mapping[str, float]  # of the board, by the names of `CALIBRATION_PARAMETERS`
    gain: tuple[tuple[float, ...], ...]  # of the board, G = S T M

    @property
    def names(self) -> list[str]:
        """The names of the hidden causes."""
        return [cause.cause for cause in self.causes]


def list_cases(corpus: Path) -> list[Path]:
    """Return the folders of all complete cases, sorted by seed."""
    folders = [p.parent for p in corpus.glob(f"*/{RECORDING}") if p.parent.name.isdigit()]
    return sorted(folders, key=lambda p: int(p.name))


def read_seal(case: Path) -> str:
    """Return the seal of the answer of a case, SHA-256, without opening the answer."""
    return (case / SEAL).read_text(encoding="ascii").split()[0]


def open_answer(case: Path, seal: str) -> Answer:
    """Return the answer of a case.

    Args:
        case: its folder.
        seal: as read before the explanation of the case.

    Raises:
        SealError: the answer does not match its seal, or has another schema.
    """
    raw = (case / ANSWER).read_bytes()
    if hashlib.sha256(raw).hexdigest() != seal:
        raise SealError(f"{case.name}: the answer does not match its seal")
    document = json.loads(raw)
    if document["schema"] not in SCHEMAS or str(document["seed"]) != case.name:
        raise SealError(f"{case.name}: the answer has another schema or belongs to another case")
    detectable = float(document.get("detectable", 0.0))
    (board,) = document["truth"]["boards"].values()
    return Answer(
        seed=int(document["seed"]),
        kind=str(document["kind"]),
        tier=str(document["tier"]),
        program=str(document["program"]),
        soak_k=float(document["soak_k"] or 0.0),
        decoy=document.get("decoy"),
        causes=tuple(_read_cause(entry, detectable) for entry in document["causes"]),
        groups=tuple(document.get("expected_groups") or ()),
        allowed=tuple(document.get("expected_set") or ()),
        near=document.get("near"),
        calibration=_read_calibration(board, document["causes"]),
        gain=tuple(tuple(map(float, row)) for row in board["STM"]),
    )


def _read_cause(entry: Mapping[str, Any], detectable: float) -> HiddenCause:
    times, times_with_others = entry.get("times_detectable"), entry.get("beside_others")
    seen = COUNTED_TIMES if times is None else float(times)
    least = float(entry.get("detectable", detectable))
    return HiddenCause(
        cause=str(entry["cause"]),
        place=entry.get("place"),
        times=seen,
        times_with_others=seen
        if times_with_others is None
        else math.sqrt(max(times_with_others, 0.0) / least),
        parameters=dict(_flatten(entry.get("parameters") or {})),
        noncentrality=entry.get("noncentrality"),
    )


def _flatten(parameters: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield each value; values per sensor axis as name.x and so on."""
    for name, parameter in parameters.items():
        value = parameter["value"]
        if isinstance(value, list):
            yield from ((f"{name}.{axis}", float(v)) for axis, v in zip("xyz", value, strict=True))
        else:
            yield name, float(value)


def _read_calibration(
    board: Mapping[str, Any], causes: Sequence[Mapping[str, Any]]
) -> dict[str, float]:
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
