"""Turns by known angles and rests, from the phases of a recording.

What to use when: `read_turns` for recordings with `turn` phases that specify the angle of a
turn, on a rate table, against the edge of a table, or by hand.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_solver.data import FloatArray

# A day at 60 rad/s; the direction of a much larger angle would be lost in rounding.
MAX_ANGLE_RAD = 1e7
ABORTED_TEXT = "aborted"  # text at the end of a phase that a fault interrupted


@dataclass(frozen=True, slots=True)
class TimeInterval:
    """A time interval, s since the recording's origin."""

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True, eq=False)
class KnownTurn:
    """A turn by a known angle about an axis fixed in the stage frame."""

    interval: TimeInterval
    axis: FloatArray  # (3,), unit length, stage frame
    angle_rad: float  # signed, right-handed about the axis
    std_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class TurnReference:
    """All known turns and rests of one recording."""

    turns: tuple[KnownTurn, ...]
    rests: tuple[TimeInterval, ...]


def read_turns(events: Iterable[SessionEvent], origin_ns: int) -> TurnReference:
    """Return the complete turns and rests in the events of a recording.

    Raises:
        InputError: the text of a turn is not valid.
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
            # The event at the end of a phase can lack its text.
            open_key = (
                key
                if key in open_ns
                else next((k for k in reversed(open_ns) if k[0] == event.phase), None)
            )
            if open_key is None:
                continue
            begin_ns = open_ns.pop(open_key)
            interval = TimeInterval(
                (begin_ns - origin_ns) * 1e-9, (event.host_time_ns - origin_ns) * 1e-9
            )
            if interval.end_s <= interval.begin_s or event.text == ABORTED_TEXT:
                continue
            if event.phase == "static":
                rests.append(interval)
            else:
                turns.append(_parse_turn(interval, open_key[1]))
    return TurnReference(tuple(turns), tuple(rests))


def _parse_turn(interval: TimeInterval, text: str) -> KnownTurn:
    try:
        turn_document = json.loads(text)
        axis = np.array([float(v) for v in turn_document["axis"]])
        angle, std = float(turn_document["angle_rad"]), float(turn_document["std_rad"])
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        raise InputError(
            f"the turn at {interval.begin_s:.1f} s has the invalid description {text[:60]!r}",
            'write the turn as {"axis": [x, y, z], "angle_rad": a, "std_rad": s}',
        ) from error
    is_unit_axis = axis.shape == (3,) and abs(float(np.linalg.norm(axis)) - 1.0) < 1e-3
    is_possible = 0.0 < abs(angle) <= MAX_ANGLE_RAD and 0.0 < std < math.inf
    if not is_unit_axis or not is_possible:
        raise InputError(
            f"the turn at {interval.begin_s:.1f} s has invalid values, {text[:60]!r}",
            f"give an axis of length 1, an angle of at most {MAX_ANGLE_RAD:g} rad other than 0, "
            "and a standard deviation above 0",
        )
    return KnownTurn(interval, axis / np.linalg.norm(axis), angle, std)
