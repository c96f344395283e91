"""Motion planning: a program in steps and steps/s of one unit, checked before anything moves."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from gyrorig_daemon.config import CommandLimits
from gyrorig_daemon.motion.unit_facts import AxisFacts, UnitFacts
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.program import Home, MotionProgram, Move, Rest, unroll_steps
from gyrorig_protocol.ptu import Axis


@dataclass(frozen=True, slots=True)
class AxisMove:
    """Target and speed of one axis, and the longest duration of the move."""

    axis: Axis
    target_steps: int
    speed_steps_s: int
    duration_s: float


@dataclass(frozen=True, slots=True)
class PlannedMove:
    """Axes that start together; `settle_s` of rest belongs to the phase, too."""

    phase: Literal["sweep", "home"]
    axes: tuple[AxisMove, ...]
    settle_s: float
    text: str


@dataclass(frozen=True, slots=True)
class PlannedRest:
    """A static interval."""

    phase: Literal["static", "dwell"]
    seconds: float


PlannedStep = PlannedMove | PlannedRest


def plan_program(
    program: MotionProgram,
    facts: UnitFacts,
    limits: CommandLimits,
    start: dict[Axis, int],
    limit_s: float | None = None,
) -> list[PlannedStep]:
    """Return the steps of the program for this unit.

    Args:
        program: the motion program.
        facts: capabilities of the unit.
        limits: limits of the rig.
        start: positions of the axes, in steps.
        limit_s: that the program may last.

    Raises:
        UsageError: a step is outside the limits of angle or speed, and the text has its number; or
            the program takes too long.
    """
    position_steps = dict(start)
    planned_steps: list[PlannedStep] = []
    for number, step in enumerate(unroll_steps(program.steps, program.name), start=1):
        if isinstance(step, Rest):
            planned_steps.append(PlannedRest(step.phase, step.seconds))
            continue
        move = _as_move(step, program.settings.default_speed_deg_s)
        step_name = f"step {number} of {program.name}"
        axes = []
        for axis, angle_deg, speed_deg_s in _axis_targets(
            move, program.settings.default_speed_deg_s
        ):
            if axis not in facts.axes:
                _check_fixed_axis(axis, angle_deg, step_name)
                continue
            axis_facts = facts.axis(axis)
            target = _target_steps(axis, axis_facts, limits, angle_deg, step_name)
            speed = _speed_steps_s(axis, axis_facts, limits, speed_deg_s, step_name)
            axes.append(
                AxisMove(
                    axis,
                    target,
                    speed,
                    move_duration_s(axis_facts, target - position_steps[axis], speed),
                )
            )
            position_steps[axis] = target
        for axis in facts.axes:
            if all(part.axis is not axis for part in axes):
                _check_resting_axis(axis, facts.axis(axis), limits, position_steps[axis], step_name)
        phase: Literal["sweep", "home"] = "home" if isinstance(step, Home) else "sweep"
        planned_steps.append(PlannedMove(phase, tuple(axes), move.settle_s, _describe(move)))
    planned_s = plan_duration_s(planned_steps)
    if limit_s is not None and planned_s > limit_s:
        raise UsageError(
            f"the motion program takes {planned_s:.0f} s, but {limit_s:.0f} s remain",
            "use a shorter program, or allow more minutes",
        )
    return planned_steps


def plan_duration_s(steps: Iterable[PlannedStep]) -> float:
    """Return the longest duration of the steps."""
    return sum(
        step.seconds
        if isinstance(step, PlannedRest)
        else max((part.duration_s for part in step.axes), default=0.0) + step.settle_s
        for step in steps
    )


def move_duration_s(axis_facts: AxisFacts, distance_steps: int, speed_steps_s: int) -> float:
    """Return the duration of a move with a trapezoidal speed profile above the base speed.

    Up to the base speed the unit starts and stops at once. Above it the speed changes with the
    acceleration (command reference manual v3.00D section 5).
    """
    distance = abs(distance_steps)
    if speed_steps_s <= axis_facts.base_speed or axis_facts.acceleration <= 0:
        return distance / speed_steps_s
    ramp_s = (speed_steps_s - axis_facts.base_speed) / axis_facts.acceleration
    ramps_steps = ramp_s * (speed_steps_s + axis_facts.base_speed)
    if ramps_steps <= distance:
        return 2 * ramp_s + (distance - ramps_steps) / speed_steps_s
    # a triangle: base v, acceleration a: distance = 2 v t + a t^2 with t of one ramp
    base_speed, acceleration = float(axis_facts.base_speed), float(axis_facts.acceleration)
    return 2 * (math.sqrt(base_speed**2 + acceleration * distance) - base_speed) / acceleration


def _as_move(step: Move | Home, default_deg_s: float) -> Move:
    if isinstance(step, Move):
        return step
    return Move(pan_deg=0.0, tilt_deg=0.0, speed_deg_s=step.speed_deg_s or default_deg_s)


def _axis_targets(move: Move, default_deg_s: float) -> Iterable[tuple[Axis, float, float]]:
    default_speed_deg_s = move.speed_deg_s or default_deg_s
    if move.pan_deg is not None:
        yield Axis.PAN, move.pan_deg, move.pan_speed_deg_s or default_speed_deg_s
    if move.tilt_deg is not None:
        yield Axis.TILT, move.tilt_deg, move.tilt_speed_deg_s or default_speed_deg_s


def _target_steps(
    axis: Axis, axis_facts: AxisFacts, limits: CommandLimits, angle_deg: float, step_name: str
) -> int:
    ends_deg = sorted(
        steps / axis_facts.steps_per_deg for steps in (axis_facts.min_steps, axis_facts.max_steps)
    )
    rig_low_deg, rig_high_deg = _rig_limits_deg(axis, limits)
    low_deg, high_deg = max(ends_deg[0], rig_low_deg), min(ends_deg[1], rig_high_deg)
    target_steps = axis_facts.to_steps(angle_deg)
    is_inside = axis_facts.min_steps <= target_steps <= axis_facts.max_steps
    if not is_inside or not low_deg - 1e-9 <= angle_deg <= high_deg + 1e-9:
        raise UsageError(
            f"{step_name} turns the {axis.label} axis to {angle_deg:g} deg, but its limits "
            f"are {low_deg:.2f} and {high_deg:.2f} deg",
            "change the motion program, or the limits in the rig file",
        )
    return target_steps


def _rig_limits_deg(axis: Axis, limits: CommandLimits) -> tuple[float, float]:
    low_deg, high_deg = (
        (limits.pan_min_deg, limits.pan_max_deg)
        if axis is Axis.PAN
        else (limits.tilt_min_deg, limits.tilt_max_deg)
    )
    return -math.inf if low_deg is None else low_deg, math.inf if high_deg is None else high_deg


def _check_resting_axis(
    axis: Axis, axis_facts: AxisFacts, limits: CommandLimits, steps: int, step_name: str
) -> None:
    """Check that an axis which does not move in a step is within the limits of the rig."""
    angle_deg, step_deg = steps / axis_facts.steps_per_deg, 1.0 / abs(axis_facts.steps_per_deg)
    low_deg, high_deg = _rig_limits_deg(axis, limits)
    if not low_deg - step_deg <= angle_deg <= high_deg + step_deg:
        raise UsageError(
            f"in {step_name}, the {axis.label} axis stays at {angle_deg:.2f} deg, but the limits "
            f"in the rig file are {low_deg:.2f} and {high_deg:.2f} deg",
            f"move the {axis.label} axis into its limits at the beginning of the motion program",
        )


def _check_fixed_axis(axis: Axis, angle_deg: float, step_name: str) -> None:
    if angle_deg != 0.0:
        raise UsageError(
            f"{step_name} turns the {axis.label} axis to {angle_deg:g} deg, but the unit has no "
            f"{axis.label} axis",
            "use a motion program that turns only the axes of the unit",
        )


def _speed_steps_s(
    axis: Axis, axis_facts: AxisFacts, limits: CommandLimits, speed_deg_s: float, step_name: str
) -> int:
    speed = axis_facts.to_speed(speed_deg_s)
    slowest = max(axis_facts.lower_speed, 1)
    fastest = axis_facts.upper_speed
    if limits.speed_deg_s is not None:
        fastest = min(fastest, axis_facts.to_speed(limits.speed_deg_s))
    if not slowest <= speed <= fastest:
        per_deg = abs(axis_facts.steps_per_deg)
        raise UsageError(
            f"{step_name} turns the {axis.label} axis at {speed_deg_s:g} deg/s, but its "
            f"limits are {slowest / per_deg:.2f} and {fastest / per_deg:.2f} deg/s",
            "change the motion program, or the limits in the rig file",
        )
    return speed


def _describe(move: Move) -> str:
    words = []
    if move.pan_deg is not None:
        words.append(f"pan to {move.pan_deg:g} deg")
    if move.tilt_deg is not None:
        words.append(f"tilt to {move.tilt_deg:g} deg")
    return ", ".join(words)
