"""The motion program document, `gyrorig/program/1`.

    schema: gyrorig/program/1
    name: "two-sweeps"
    settings: {base_speed_deg_s: 3.0, acceleration_deg_s2: 200.0}
    steps:
      - {rest: {seconds: 10.0, phase: static}}
      - repeat:
          times: 4
          steps:
            - {move: {pan_deg: 60.0, speed_deg_s: 60.0}}
            - {rest: {seconds: 0.5}}

Angles are in degrees only here, because people write this document.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import UsageError

SCHEMA = "gyrorig/program/1"
MAX_STEPS = 100_000
STEP_KINDS = ("rest", "move", "repeat", "home", "turn")  # a step has exactly one of these keys

# Far beyond any unit, but finite in steps.
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Angle = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)]


class Rest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A static interval. Its `phase` is `static` if it is used to estimate noise, else `dwell`."""

    seconds: Seconds
    phase: Literal["static", "dwell"] = "dwell"


class Move(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A move of one or both axes to a position, started together; the phase is `sweep`.

    An axis that is left out keeps its position. `settle_s` is a pause after the move, part of
    the move, in which the mechanics come to rest.
    """

    pan_deg: Angle | None = None
    tilt_deg: Angle | None = None
    speed_deg_s: Positive | None = None
    pan_speed_deg_s: Positive | None = None
    tilt_speed_deg_s: Positive | None = None
    settle_s: Seconds = 0.0


class Repeat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Steps that are executed `times` times."""

    times: Annotated[int, msgspec.Meta(ge=1, le=10_000)]
    steps: Annotated[tuple["Step", ...], msgspec.Meta(min_length=1)]


class Home(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A move to pan 0, tilt 0 at the program's default speed."""

    speed_deg_s: Positive | None = None


class Turn(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A turn of the board by hand, from rest to rest; the phase is `turn`.

    `axis` is of the board, not of the room. `std_deg` is the standard deviation of the angle.
    """

    axis: tuple[float, float, float]
    angle_deg: Annotated[float, msgspec.Meta(ge=-36_000.0, le=36_000.0)]
    seconds: Annotated[float, msgspec.Meta(ge=1.0, le=600.0)] = 10.0
    std_deg: Annotated[float, msgspec.Meta(gt=0.0, le=30.0)] = 1.0


class Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One step; exactly one of its fields is set."""

    rest: Rest | None = None
    move: Move | None = None
    repeat: Repeat | None = None
    home: Home | None = None
    turn: Turn | None = None


class PtuSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of the pan-tilt unit, sent before the first move; others are not changed.

    Up to the base speed the unit starts and stops without a ramp, which makes it ring. With a
    low base speed its motion is the trapezoid that the solver assumes (source: command
    reference manual v3.00D, section 5).
    """

    base_speed_deg_s: Positive | None = None
    acceleration_deg_s2: Positive | None = None
    upper_speed_deg_s: Positive | None = None
    default_speed_deg_s: Positive = 30.0


class MotionProgram(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A motion program. In the recording, the phase `program` spans it."""

    name: str
    steps: tuple[Step, ...]
    schema: Literal["gyrorig/program/1"] = "gyrorig/program/1"
    description: str = ""
    settings: PtuSettings = PtuSettings()


def parse_program(text: str | bytes, name: str) -> MotionProgram:
    """Parse the YAML document of a motion program.

    Args:
        text: the document.
        name: the document's name in an error, usually its file name.

    Raises:
        UsageError: the document is not a program; the text gives the place and the reason.
    """
    program = convert_document(parse_yaml(text, name, schema=SCHEMA), MotionProgram, name)
    count = 0
    for _ in _unroll(program.steps, name):
        count += 1
        if count > MAX_STEPS:
            raise UsageError(
                f"the motion program {name} has more than {MAX_STEPS} steps in total, with "
                "all repeats",
                "give a lower number of repeats",
            )
    if not count:
        raise UsageError(
            f"the motion program {name} has no steps", "add at least one step with `rest` or `move`"
        )
    return program


def unroll_steps(steps: tuple[Step, ...], name: str) -> Iterator[Rest | Move | Home]:
    """Yield the rests, moves and homing moves of `steps` in order, with repeats expanded.

    Args:
        steps: the steps of a program, or of a repeat in it.
        name: the program's name in an error.

    Raises:
        UsageError: a step has none or several of its fields set, or it is a turn by hand.
    """
    for action in _unroll(steps, name):
        if isinstance(action, Turn):
            raise UsageError(
                f"the motion program {name} has turns by hand, which a pan-tilt unit cannot do",
                "set `driver: manual` under `ptu` in the rig file, or use another motion program",
            )
        yield action


def unroll_manual_steps(steps: tuple[Step, ...], name: str) -> Iterator[Rest | Turn]:
    """Yield the rests and turns of a program that a person executes, with repeats expanded.

    Raises:
        UsageError: a step has none or several of its fields set, or it is a move of a unit.
    """
    for action in _unroll(steps, name):
        if isinstance(action, Move | Home):
            raise UsageError(
                f"the motion program {name} has moves of a pan-tilt unit, which a person cannot do",
                "use a motion program with `rest` and `turn`, for example config/manual/turns.yaml",
            )
        yield action


def _unroll(
    steps: tuple[Step, ...], name: str, parent_number: str = ""
) -> Iterator[Rest | Move | Home | Turn]:
    """Yield the actions of `steps`; `parent_number`: of the enclosing repeat and a dot, `3.`."""
    for number, step in enumerate(steps, start=1):
        values = (step.rest, step.move, step.repeat, step.home, step.turn)
        actions = [value for value in values if value is not None]
        if len(actions) != 1:
            set_keys = " and ".join(key for key in STEP_KINDS if getattr(step, key) is not None)
            raise UsageError(
                f"step {parent_number}{number} of the motion program {name} has "
                f"{set_keys or 'no action'}",
                f"give each step exactly one of the keys {', '.join(STEP_KINDS)}",
            )
        action = actions[0]
        if isinstance(action, Repeat):
            inner_number = f"{parent_number}{number}."
            for _ in range(action.times):
                yield from _unroll(action.steps, name, inner_number)
        else:
            if isinstance(action, Move) and action.pan_deg is None and action.tilt_deg is None:
                raise UsageError(
                    f"the move in step {parent_number}{number} of the motion program {name} "
                    "has no target angle",
                    "give `pan_deg` or `tilt_deg`, or both",
                )
            if isinstance(action, Turn):
                _check_turn(action, f"{parent_number}{number}", name)
            yield action


def _check_turn(turn: Turn, number: str, name: str) -> None:
    if abs(math.hypot(*turn.axis) - 1.0) > 1e-3 or abs(turn.angle_deg) < 30.0:
        raise UsageError(
            f"the axis or the angle of the turn in step {number} of the motion program {name} is "
            "not valid",
            "give an axis of length 1, such as [0, 0, 1], and an angle of at least 30 degrees",
        )
