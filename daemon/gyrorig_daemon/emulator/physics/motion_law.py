"""Motion law of a stepper: exact segments from a position and a speed to a target.

Theory of operation. Below the base speed a stepper changes speed at once. Above it, it
accelerates and decelerates at a constant rate (a trapezoid, or a triangle for a short move). A
target or a speed can change during a move: the new plan starts from the position and the speed of
that instant. For a reversal, or a target that is too near, the axis first decelerates through the
base speed and then returns. Each segment is a parabola of time, so that the position is exact at
any time. Source: command reference manual v3.00D, section 5.

Use `plan_motion` for a move and `halt_target` for the stopping position of a halt.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Replanning within the final ramp gives the same stopping distance, except for rounding.
_TOLERANCE_STEPS = 1e-6


@dataclass(frozen=True, slots=True)
class MotionLaw:
    """Limits of a move: base and commanded speed in steps/s, acceleration in steps/s^2."""

    base_speed_steps_s: float
    speed_steps_s: float
    acceleration_steps_s2: float

    def stopping_steps(self, speed_steps_s: float) -> float:
        """Return the stopping distance from an unsigned speed."""
        if speed_steps_s <= self.base_speed_steps_s:
            return 0.0
        squares = speed_steps_s**2 - self.base_speed_steps_s**2
        return squares / (2.0 * self.acceleration_steps_s2)


@dataclass(frozen=True, slots=True)
class Segment:
    """A segment of constant acceleration, valid from `start_s` to the next one."""

    start_s: float
    steps: float
    speed_steps_s: float
    acceleration_steps_s2: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position in steps and speed in steps/s at a time not before the start."""
        dt = time_s - self.start_s
        speed = self.speed_steps_s + self.acceleration_steps_s2 * dt
        return self.steps + 0.5 * (self.speed_steps_s + speed) * dt, speed

    def during(self, elapsed_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions and speeds at times since the start, each (n,)."""
        speed = self.speed_steps_s + self.acceleration_steps_s2 * elapsed_s
        return self.steps + 0.5 * (self.speed_steps_s + speed) * elapsed_s, speed


class _SegmentBuilder:
    """Collects segments; stores time, position and signed speed of the present end."""

    def __init__(self, time_s: float, steps: float, speed_steps_s: float) -> None:
        self.time_s, self.steps, self.speed = time_s, steps, speed_steps_s
        self.segments: list[Segment] = []

    def ramp(self, speed: float, acceleration: float) -> None:
        """Change to a signed speed with an unsigned acceleration."""
        if speed == self.speed:
            return
        duration = abs(speed - self.speed) / acceleration
        signed = math.copysign(acceleration, speed - self.speed)
        self.segments.append(Segment(self.time_s, self.steps, self.speed, signed))
        self.steps += 0.5 * (self.speed + speed) * duration
        self.time_s += duration
        self.speed = speed

    def cruise(self, distance: float) -> None:
        """Move an unsigned distance at the present speed."""
        if distance <= 0.0:
            return
        self.segments.append(Segment(self.time_s, self.steps, self.speed, 0.0))
        self.time_s += distance / abs(self.speed)
        self.steps += math.copysign(distance, self.speed)

    def stop_at(self, steps: float) -> None:
        self.steps, self.speed = steps, 0.0
        self.segments.append(Segment(self.time_s, steps, 0.0, 0.0))


def plan_motion(
    start_s: float, steps: float, speed_steps_s: float, target_steps: float, law: MotionLaw
) -> list[Segment]:
    """Return the segments from a position and a speed to rest at a target.

    Args:
        start_s: start of the plan.
        steps: position then.
        speed_steps_s: signed speed then.
        target_steps: position at which to stop.
        law: limits; its speed must be positive.

    Returns:
        Segments in order of time; the last one is the standstill at the target.
    """
    path = _SegmentBuilder(start_s, steps, speed_steps_s)
    while True:
        distance = target_steps - path.steps
        if distance == 0.0 and abs(path.speed) <= law.base_speed_steps_s:
            break
        sign = math.copysign(1.0, distance if distance != 0.0 else path.speed)
        forward = path.speed * sign
        if forward >= 0.0 and law.stopping_steps(forward) <= abs(distance) + _TOLERANCE_STEPS:
            _add_move(path, sign, abs(distance), law)
            break
        # Moving away, or too fast to stop in time: decelerate to a stop, then return.
        if abs(path.speed) > law.base_speed_steps_s:
            base = math.copysign(law.base_speed_steps_s, path.speed)
            path.ramp(base, law.acceleration_steps_s2)
        path.speed = 0.0
    path.stop_at(target_steps)
    return path.segments


def _add_move(path: _SegmentBuilder, sign: float, distance: float, law: MotionLaw) -> None:
    """Add the segments of a move without a reversal."""
    base, commanded, acceleration = (
        law.base_speed_steps_s,
        law.speed_steps_s,
        law.acceleration_steps_s2,
    )
    forward = path.speed * sign
    if commanded <= base:
        start_steps = path.steps
        if forward > base:
            path.ramp(sign * base, acceleration)
        path.speed = sign * commanded
        path.cruise(distance - abs(path.steps - start_steps))
        return
    entry = max(forward, base)
    path.speed = sign * entry
    peak = commanded
    if entry <= commanded:
        highest = math.sqrt(0.5 * (2.0 * acceleration * distance + entry**2 + base**2))
        peak = max(entry, min(commanded, highest))
    start_steps = path.steps
    path.ramp(sign * peak, acceleration)
    path.cruise(distance - abs(path.steps - start_steps) - law.stopping_steps(peak))
    path.ramp(sign * base, acceleration)


def halt_target(steps: float, speed_steps_s: float, law: MotionLaw) -> float:
    """Return the whole step at which an axis stops when it is halted now."""
    if speed_steps_s == 0.0:
        return float(round(steps))
    stop = steps + math.copysign(law.stopping_steps(abs(speed_steps_s)), speed_steps_s)
    nearest = float(round(stop))
    if abs(nearest - stop) < _TOLERANCE_STEPS:
        return nearest
    return float(math.ceil(stop) if speed_steps_s > 0.0 else math.floor(stop))
