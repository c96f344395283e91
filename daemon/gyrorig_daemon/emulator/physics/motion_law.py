"""The stepper's motion law: from a speed and a place to a target, in exact pieces.

Theory of operation. Below the base speed a stepper changes speed at once; above it, it
ramps with one acceleration up and down (a trapezoid, a triangle when the way is short).
A target or a speed may change on the fly: the new plan starts from the position and speed
of that instant. A reversal, or a target too near to stop at, brakes through the base speed
first and comes back. Each piece is a parabola of time, so that the position at any time is
exact. Source: command reference manual v3.00D, section 5.

Use `plan` for a move, `halt_target` for where a halt comes to rest.
"""

import math
from dataclasses import dataclass

# Replanning inside the final ramp finds its own stopping distance again, less rounding.
_SLACK_STEPS = 1e-6


@dataclass(frozen=True, slots=True)
class MotionLaw:
    """What limits a move: base and wanted speed in steps/s, acceleration in steps/s^2."""

    base_speed_steps_s: float
    speed_steps_s: float
    acceleration_steps_s2: float

    def stopping_steps(self, speed_steps_s: float) -> float:
        """Return how far the axis still goes from a speed (unsigned) until it can stop."""
        if speed_steps_s <= self.base_speed_steps_s:
            return 0.0
        squares = speed_steps_s**2 - self.base_speed_steps_s**2
        return squares / (2.0 * self.acceleration_steps_s2)


@dataclass(frozen=True, slots=True)
class Segment:
    """A piece of constant acceleration, valid from `start_s` until the next one begins."""

    start_s: float
    steps: float
    speed_steps_s: float
    acceleration_steps_s2: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position in steps and speed in steps/s at a time not before the start."""
        dt = time_s - self.start_s
        speed = self.speed_steps_s + self.acceleration_steps_s2 * dt
        return self.steps + 0.5 * (self.speed_steps_s + speed) * dt, speed


class _Path:
    """Collects pieces; keeps time, position and signed speed of the end so far."""

    def __init__(self, time_s: float, steps: float, speed_steps_s: float) -> None:
        self.time_s, self.steps, self.speed = time_s, steps, speed_steps_s
        self.segments: list[Segment] = []

    def ramp(self, speed: float, acceleration: float) -> None:
        """Go to a signed speed with an unsigned acceleration."""
        if speed == self.speed:
            return
        duration = abs(speed - self.speed) / acceleration
        signed = math.copysign(acceleration, speed - self.speed)
        self.segments.append(Segment(self.time_s, self.steps, self.speed, signed))
        self.steps += 0.5 * (self.speed + speed) * duration
        self.time_s += duration
        self.speed = speed

    def cruise(self, distance: float) -> None:
        """Go an unsigned distance at the speed of now."""
        if distance <= 0.0:
            return
        self.segments.append(Segment(self.time_s, self.steps, self.speed, 0.0))
        self.time_s += distance / abs(self.speed)
        self.steps += math.copysign(distance, self.speed)

    def stand(self, steps: float) -> None:
        self.steps, self.speed = steps, 0.0
        self.segments.append(Segment(self.time_s, steps, 0.0, 0.0))


def plan(
    start_s: float, steps: float, speed_steps_s: float, target_steps: float, law: MotionLaw
) -> list[Segment]:
    """Return the pieces that bring an axis from a place and a speed to rest at a target.

    Args:
        start_s: when the plan begins.
        steps: position then.
        speed_steps_s: signed speed then.
        target_steps: where to come to rest.
        law: limits; its speed must be positive.

    Returns:
        Pieces in the order of time; the last one is the standstill at the target.
    """
    path = _Path(start_s, steps, speed_steps_s)
    while True:
        way = target_steps - path.steps
        if way == 0.0 and abs(path.speed) <= law.base_speed_steps_s:
            break
        sign = math.copysign(1.0, way if way != 0.0 else path.speed)
        forward = path.speed * sign
        if forward >= 0.0 and law.stopping_steps(forward) <= abs(way) + _SLACK_STEPS:
            _run(path, sign, abs(way), law)
            break
        # Moving away, or too fast to stop in time: brake to a stop, then come back.
        if abs(path.speed) > law.base_speed_steps_s:
            base = math.copysign(law.base_speed_steps_s, path.speed)
            path.ramp(base, law.acceleration_steps_s2)
        path.speed = 0.0
    path.stand(target_steps)
    return path.segments


def _run(path: _Path, sign: float, way: float, law: MotionLaw) -> None:
    """Add the pieces of a move that needs no reversal."""
    base, wanted, acceleration = (
        law.base_speed_steps_s,
        law.speed_steps_s,
        law.acceleration_steps_s2,
    )
    forward = path.speed * sign
    if wanted <= base:
        begun = path.steps
        if forward > base:
            path.ramp(sign * base, acceleration)
        path.speed = sign * wanted
        path.cruise(way - abs(path.steps - begun))
        return
    entry = max(forward, base)
    path.speed = sign * entry
    peak = wanted
    if entry <= wanted:
        highest = math.sqrt(0.5 * (2.0 * acceleration * way + entry**2 + base**2))
        peak = max(entry, min(wanted, highest))
    begun = path.steps
    path.ramp(sign * peak, acceleration)
    path.cruise(way - abs(path.steps - begun) - law.stopping_steps(peak))
    path.ramp(sign * base, acceleration)


def halt_target(steps: float, speed_steps_s: float, law: MotionLaw) -> float:
    """Return the whole step at which an axis comes to rest when it is halted now."""
    if speed_steps_s == 0.0:
        return float(round(steps))
    stop = steps + math.copysign(law.stopping_steps(abs(speed_steps_s)), speed_steps_s)
    near = float(round(stop))
    if abs(near - stop) < _SLACK_STEPS:
        return near
    return float(math.ceil(stop) if speed_steps_s > 0.0 else math.floor(stop))
