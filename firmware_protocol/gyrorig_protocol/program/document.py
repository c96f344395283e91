"""The motion program's document, `gyrorig/program/1`.

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

Degrees stand only here, at the edge where a person writes them.
"""

from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import parse_yaml, read_as
from gyrorig_protocol.errors import UsageError

SCHEMA = "gyrorig/program/1"
MAX_STEPS = 100_000
KINDS = ("rest", "move", "repeat", "home")  # of a step: one of them

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)]


class Rest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Stand still. `phase` is `static` for a rest that serves the noise, else `dwell`."""

    seconds: Seconds
    phase: Literal["static", "dwell"] = "dwell"


class Move(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Turn one or both axes to a position, both starting together; a `sweep` phase.

    An axis that is left out stays where it is. `settle_s` is the rest after the move
    that still belongs to it, for the mechanics to come to rest.
    """

    pan_deg: float | None = None
    tilt_deg: float | None = None
    speed_deg_s: Positive | None = None
    pan_speed_deg_s: Positive | None = None
    tilt_speed_deg_s: Positive | None = None
    settle_s: Seconds = 0.0


class Repeat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The same steps again, `times` times in all."""

    times: Annotated[int, msgspec.Meta(ge=1, le=10_000)]
    steps: Annotated[tuple["Step", ...], msgspec.Meta(min_length=1)]


class Home(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Go to pan 0, tilt 0 at the program's default speed."""

    speed_deg_s: Positive | None = None


class Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One step: exactly one of its fields is set."""

    rest: Rest | None = None
    move: Move | None = None
    repeat: Repeat | None = None
    home: Home | None = None


class UnitSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the unit is told before the first move; what is left out stays as it is.

    Up to the base speed the unit starts and stops at once, without a ramp, and rings;
    a low base speed makes the edges what the solver's trapezoid says (reference:
    command reference manual v3.00D section 5).
    """

    base_speed_deg_s: Positive | None = None
    acceleration_deg_s2: Positive | None = None
    upper_speed_deg_s: Positive | None = None
    default_speed_deg_s: Positive = 30.0


class MotionProgram(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A whole program. The phase `program` spans it in the recording."""

    name: str
    steps: tuple[Step, ...]
    schema: Literal["gyrorig/program/1"] = "gyrorig/program/1"
    description: str = ""
    settings: UnitSettings = UnitSettings()


def parse_program(text: str | bytes, name: str) -> MotionProgram:
    """Return the program that a YAML document describes.

    Args:
        text: the document.
        name: what to call it in an error, usually its file name.

    Raises:
        UsageError: the document is not a program; the text says where and why.
    """
    program = read_as(parse_yaml(text, name), MotionProgram, name)
    count = 0
    for _ in unrolled(program.steps, name):
        count += 1
        if count > MAX_STEPS:
            raise UsageError(
                f"{name} has more than {MAX_STEPS} steps, repeats counted", "repeat less"
            )
    if not count:
        raise UsageError(f"{name} has no steps", "give it at least one rest or move")
    return program


def unrolled(steps: tuple[Step, ...], name: str, within: str = "") -> Iterator[Rest | Move | Home]:
    """Yield the rests, moves and homings of `steps` in order, repeats written out.

    Args:
        steps: of a program, or of a repeat in it.
        name: of the program, for an error.
        within: the number of the repeat with a dot behind it: `3.`; empty for a program's own.

    Raises:
        UsageError: a step has none or several of its fields set; the text has its number.
    """
    for number, step in enumerate(steps, start=1):
        parts = [p for p in (step.rest, step.move, step.repeat, step.home) if p is not None]
        if len(parts) != 1:
            named = " and ".join(key for key in KINDS if getattr(step, key) is not None)
            raise UsageError(
                f"step {within}{number} of {name} is {named or 'empty'}",
                f"give it one of {', '.join(KINDS)}",
            )
        part = parts[0]
        if isinstance(part, Repeat):
            inside = f"{within}{number}."
            for _ in range(part.times):
                yield from unrolled(part.steps, name, inside)
        else:
            if isinstance(part, Move) and part.pan_deg is None and part.tilt_deg is None:
                raise UsageError(
                    f"step {within}{number} of {name} moves nowhere", "give it pan_deg or tilt_deg"
                )
            yield part
