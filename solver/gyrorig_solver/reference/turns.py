"""Known turns and rests, from the phases of a recording.

What to use when: `read_turns` for recordings whose `turn` phases say by how much the
stage turned, on a rate table, against a table's edge, or by hand.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_solver.arrays import FloatArray

ABORTED = "aborted"  # what ends a phase that a fault broke off: nobody knows what it came to


@dataclass(frozen=True, slots=True)
class Interval:
    """A stretch of time, s since the recording's origin."""

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class KnownTurn:
    """A turn by a known angle about an axis that stands still in the stage frame."""

    over: Interval
    axis: FloatArray  # (3,), unit length, stage frame
    angle_rad: float  # signed, right-handed about the axis
    std_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class TurnReference:
    """Every known turn and every rest of one recording."""

    turns: tuple[KnownTurn, ...]
    rests: tuple[Interval, ...]


def read_turns(events: Iterable[SessionEvent], origin_ns: int) -> TurnReference:
    """Return the turns and rests that a recording's events tell of, but for broken-off ones.

    Args:
        events: in the order of the recording.
        origin_ns: capture time that the samples' seconds count from.

    Raises:
        InputError: a turn's text is not what the contract says it is.
    """
    turns, rests = [], []
    open_ns: dict[tuple[str, str], int] = {}
    for event in events:
        key = (event.phase, event.text)
        if event.phase not in ("static", "turn"):
            continue
        if event.kind == EventKind.PHASE_BEGIN:
            open_ns[key] = event.host_time_ns
        elif event.kind == EventKind.PHASE_END:
            # The end of a phase may leave its text out.
            begun = key if key in open_ns else _begun(open_ns, event.phase)
            if begun is None:
                continue
            begin_ns = open_ns.pop(begun)
            over = Interval((begin_ns - origin_ns) * 1e-9, (event.host_time_ns - origin_ns) * 1e-9)
            if over.end_s <= over.begin_s or event.text == ABORTED:
                continue
            if event.phase == "static":
                rests.append(over)
            else:
                turns.append(_turn(over, begun[1]))
    return TurnReference(tuple(turns), tuple(rests))


def _begun(open_ns: dict[tuple[str, str], int], phase: str) -> tuple[str, str] | None:
    return next((key for key in reversed(open_ns) if key[0] == phase), None)


def _turn(over: Interval, text: str) -> KnownTurn:
    try:
        said = json.loads(text)
        axis = np.array([float(v) for v in said["axis"]])
        angle, std = float(said["angle_rad"]), float(said["std_rad"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"a turn at {over.begin_s:.1f} s says {text[:60]!r}",
            'it must be {"axis": [x, y, z], "angle_rad": a, "std_rad": s}',
        ) from error
    sound = axis.shape == (3,) and abs(float(np.linalg.norm(axis)) - 1.0) < 1e-3
    if not sound or not math.isfinite(angle) or not (0.0 < std < math.inf) or angle == 0.0:
        raise InputError(
            f"a turn at {over.begin_s:.1f} s is no turn: {text[:60]!r}",
            "axis of length 1, an angle, and a standard deviation above 0",
        )
    return KnownTurn(over, axis / np.linalg.norm(axis), angle, std)
