"""A program in steps and steps/s of one unit, checked as a whole before anything moves."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from gyrorig_daemon.config import CommandLimits
from gyrorig_daemon.motion.facts import AxisFacts, UnitFacts
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, unrolled
from gyrorig_protocol.ptu import Axis


@dataclass(frozen=True, slots=True)
class AxisMove:
    """Where one axis goes, how fast, and how long that takes at most."""

    axis: Axis
    target_steps: int
    speed_steps_s: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class PlannedMove:
    """Axes that start together; `settle_s` of rest still belongs to the phase."""

    phase: Literal["sweep", "home"]
    axes: tuple[AxisMove, ...]
    settle_s: float
    text: str


@dataclass(frozen=True, slots=True)
class PlannedRest:
    """A rest."""

    phase: Literal["static", "dwell"]
    seconds: float


PlannedStep = PlannedMove | PlannedRest


def plan_program(
    program: MotionProgram, facts: UnitFacts, limits: CommandLimits, start: dict[Axis, int]
) -> list[PlannedStep]:
    """Return the program's steps for this unit.

    Args:
        program: what shall be done.
        facts: what the unit can do.
        limits: what the rig allows.
        start: where the axes stand, in steps.

    Raises:
        UsageError: a step leaves the limits or the speeds; its number is in the text.
    """
    at = dict(start)
    planned: list[PlannedStep] = []
    for number, step in enumerate(unrolled(program.steps, program.name), start=1):
        if isinstance(step, Rest):
            planned.append(PlannedRest(step.phase, step.seconds))
            continue
        move = _as_move(step, program.settings.default_speed_deg_s)
        where = f"step {number} of {program.name}"
        axes = []
        for axis, angle_deg, speed_deg_s in _parts(move, program.settings.default_speed_deg_s):
            fact = facts.axis(axis)
            target = _target(axis, fact, limits, angle_deg, where)
            speed = _speed(axis, fact, limits, speed_deg_s, where)
            axes.append(AxisMove(axis, target, speed, duration_s(fact, target - at[axis], speed)))
            at[axis] = target
        phase: Literal["sweep", "home"] = "home" if isinstance(step, Home) else "sweep"
        planned.append(PlannedMove(phase, tuple(axes), move.settle_s, _describe(move)))
    return planned


def plan_duration_s(steps: Iterable[PlannedStep]) -> float:
    """Return how long the steps take at most."""
    return sum(
        step.seconds
        if isinstance(step, PlannedRest)
        else max((part.duration_s for part in step.axes), default=0.0) + step.settle_s
        for step in steps
    )


def duration_s(fact: AxisFacts, distance_steps: int, speed_steps_s: int) -> float:
    """Return how long a move takes: the trapezoid above the base speed.

    Up to the base speed the unit starts and stops at once; above, it changes speed by
    its acceleration (command reference manual v3.00D section 5).
    """
    distance = abs(distance_steps)
    if speed_steps_s <= fact.base_speed or fact.acceleration <= 0:
        return distance / speed_steps_s
    ramp_s = (speed_steps_s - fact.base_speed) / fact.acceleration
    ramps_steps = ramp_s * (speed_steps_s + fact.base_speed)
    if ramps_steps <= distance:
        return 2 * ramp_s + (distance - ramps_steps) / speed_steps_s
    # a triangle: base v, acceleration a: distance = 2 v t + a t^2 with t of one ramp
    base, gain = float(fact.base_speed), float(fact.acceleration)
    return 2 * (math.sqrt(base**2 + gain * distance) - base) / gain


def _as_move(step: Move | Home, default_deg_s: float) -> Move:
    if isinstance(step, Move):
        return step
    return Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s or default_deg_s)


def _parts(move: Move, default_deg_s: float) -> Iterable[tuple[Axis, float, float]]:
    both = move.speed_deg_s or default_deg_s
    if move.pan_deg is not None:
        yield Axis.PAN, move.pan_deg, move.pan_speed_deg_s or both
    if move.tilt_deg is not None:
        yield Axis.TILT, move.tilt_deg, move.tilt_speed_deg_s or both


def _target(
    axis: Axis, fact: AxisFacts, limits: CommandLimits, angle_deg: float, where: str
) -> int:
    low_deg, high_deg = (
        (limits.pan_min_deg, limits.pan_max_deg)
        if axis is Axis.PAN
        else (limits.tilt_min_deg, limits.tilt_max_deg)
    )
    ends_deg = sorted(steps / fact.steps_per_deg for steps in (fact.min_steps, fact.max_steps))
    low_deg = max(ends_deg[0], -math.inf if low_deg is None else low_deg)
    high_deg = min(ends_deg[1], math.inf if high_deg is None else high_deg)
    target = fact.to_steps(angle_deg)
    inside = fact.min_steps <= target <= fact.max_steps
    if not inside or not low_deg - 1e-9 <= angle_deg <= high_deg + 1e-9:
        raise UsageError(
            f"{where} turns {axis.word} to {angle_deg:g} deg, the limits are "
            f"{low_deg:.2f} to {high_deg:.2f} deg",
            "change the program",
        )
    return target


def _speed(
    axis: Axis, fact: AxisFacts, limits: CommandLimits, speed_deg_s: float, where: str
) -> int:
    speed = fact.to_speed(speed_deg_s)
    slowest = max(fact.lower_speed, 1)
    fastest = fact.upper_speed
    if limits.speed_deg_s is not None:
        fastest = min(fastest, fact.to_speed(limits.speed_deg_s))
    if not slowest <= speed <= fastest:
        per_deg = abs(fact.steps_per_deg)
        raise UsageError(
            f"{where} turns {axis.word} at {speed_deg_s:g} deg/s, the limits are "
            f"{slowest / per_deg:.2f} to {fastest / per_deg:.2f} deg/s",
            "change the program",
        )
    return speed


def _describe(move: Move) -> str:
    words = []
    if move.pan_deg is not None:
        words.append(f"pan to {move.pan_deg:g} deg")
    if move.tilt_deg is not None:
        words.append(f"tilt to {move.tilt_deg:g} deg")
    return ", ".join(words)
