"""What was hidden in a case, opened after all was said of it; the seal is checked.

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

from gyrorig_solver.discover.changes import PARAMETERS
from gyrorig_solver.model.gain import factorise

SCHEMAS = ("gyrorig/hidden-answer/2", "gyrorig/hidden-answer/1")  # the first: with sizes counted
ANSWER, SEAL, RECORDING = "answer.json", "sealed.txt", "recording.mcap"
HELD, HELD_RATES, RATES = "held.mcap", "held.npz", "rates.npz"
COUNTED = 1000.0  # times: what is counted in the stream, not weighed against noise, shows


class SealError(Exception):
    """An answer is not the one that was sealed, or is none."""


@dataclass(frozen=True, slots=True)
class HiddenCause:
    """One thing that was hidden."""

    cause: str  # of the catalogue, or of a shape that is not in it
    place: str | None
    times: float  # its size in minimal detectable ones, by the truth's own non-centrality
    beside_others: float  # the same once the other hidden causes are projected off too
    parameters: Mapping[str, float]  # by the truth's names, SI
    noncentrality: float | None = None  # as it is seen; None for what is counted


@dataclass(frozen=True, slots=True)
class Answer:
    """All that was hidden in a case."""

    seed: int
    kind: str  # null, one, two, many, outside, nearly, unobservable
    tier: str
    program: str
    soak_k: float
    decoy: str | None
    causes: tuple[HiddenCause, ...]
    groups: tuple[str, ...]  # signatures of which a shape outside the catalogue shows one first
    allowed: tuple[str, ...]  # the set that is right where a program cannot part causes
    near: str | None  # the cause that a shape is near to
    calibration: Mapping[str, float]  # the board's, by the names of `PARAMETERS`
    gain: tuple[tuple[float, ...], ...]  # its G = S T M

    @property
    def names(self) -> list[str]:
        """What was hidden, by name."""
        return [one.cause for one in self.causes]


def cases(corpus: Path) -> list[Path]:
    """Return the folders of all cases that are whole, by seed."""
    found = [p.parent for p in corpus.glob(f"*/{RECORDING}") if p.parent.name.isdigit()]
    return sorted(found, key=lambda p: int(p.name))


def sealed(case: Path) -> str:
    """Return the seal of a case's answer, SHA-256; the answer itself stays closed."""
    return (case / SEAL).read_text(encoding="ascii").split()[0]


def opened(case: Path, seal: str) -> Answer:
    """Return a case's answer.

    Args:
        case: its folder.
        seal: as it was told before anything was said of the case.

    Raises:
        SealError: it is not the answer that was sealed, or has another schema.
    """
    raw = (case / ANSWER).read_bytes()
    if hashlib.sha256(raw).hexdigest() != seal:
        raise SealError(f"{case.name}: the answer is not the one that was sealed")
    told = json.loads(raw)
    if told["schema"] not in SCHEMAS or str(told["seed"]) != case.name:
        raise SealError(f"{case.name}: the answer is of another kind or case")
    detectable = float(told.get("detectable", 0.0))
    (board,) = told["truth"]["boards"].values()
    return Answer(
        seed=int(told["seed"]),
        kind=str(told["kind"]),
        tier=str(told["tier"]),
        program=str(told["program"]),
        soak_k=float(told["soak_k"] or 0.0),
        decoy=told.get("decoy"),
        causes=tuple(_cause(one, detectable) for one in told["causes"]),
        groups=tuple(told.get("expected_groups") or ()),
        allowed=tuple(told.get("expected_set") or ()),
        near=told.get("near"),
        calibration=_calibration(board, told["causes"]),
        gain=tuple(tuple(map(float, row)) for row in board["STM"]),
    )


def _cause(told: Mapping[str, Any], detectable: float) -> HiddenCause:
    times, beside = told.get("times_detectable"), told.get("beside_others")
    seen = COUNTED if times is None else float(times)
    least = float(told.get("detectable", detectable))
    return HiddenCause(
        cause=str(told["cause"]),
        place=told.get("place"),
        times=seen,
        beside_others=seen if beside is None else math.sqrt(max(beside, 0.0) / least),
        parameters=dict(_flat(told.get("parameters") or {})),
        noncentrality=told.get("noncentrality"),
    )


def _flat(parameters: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yield each value; those by sensor axis as name.x and so on."""
    for name, told in parameters.items():
        value = told["value"]
        if isinstance(value, list):
            yield from ((f"{name}.{axis}", float(v)) for axis, v in zip("xyz", value, strict=True))
        else:
            yield name, float(value)


def _calibration(board: Mapping[str, Any], causes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the true calibration of a board, its bias as the recording's mean.

    The time offset is the whole lag: with a hidden filter that of the filter as it is.
    """
    factors = factorise(np.array(board["STM"]))
    offset_s = float(board["time_offset_s"])
    for one in causes:
        if one["cause"] == "low_pass_lag":
            change = float(one["parameters"]["cutoff_change"]["value"])
            # Butterworth, second order: its delay at zero frequency is sqrt(2) / omega.
            delay_s = math.sqrt(2.0) / (2.0 * math.pi * float(board["low_pass"]["cutoff_hz"]))
            offset_s += delay_s * (1.0 / (1.0 + change) - 1.0)
    values = [*factors.as_vector(), *board["mean_bias_rad_s"], offset_s]
    return dict(zip(PARAMETERS, map(float, values), strict=True))
