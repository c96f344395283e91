"""Where one stepper axis is, from rest to rest, when it was given orders on the way.

A course is a row of legs of constant acceleration. Below the base speed the speed changes
at once; between base and upper speed it ramps with one acceleration, up and down alike. A
new target or speed acts from where the axis is at that instant; a target behind it, or too
near to stop at, is reached by braking through the base speed first and coming back
(command reference manual v3.00D, section 5). Steps and seconds, signed.

What to use when: `lay` for a course; its methods for position, speed and share of the way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray

Kind = Literal["to", "by", "keep", "stop"]  # a target, an offset, a new speed, a halt
# Stopping distances are computed again on the way; rounding must not make them too long.
_SLACK_STEPS = 1e-6
_MOST_TURNS = 3  # away, too fast, and towards


@dataclass(frozen=True, slots=True)
class Limits:
    """What an order is carried out with."""

    speed_steps_s: float
    acceleration_steps_s2: float
    base_speed_steps_s: float

    def stopping_steps(self, speed_steps_s: float) -> float:
        """Return how far the axis goes on from a speed until it can stand."""
        excess = speed_steps_s**2 - self.base_speed_steps_s**2
        return max(0.0, excess) / (2.0 * self.acceleration_steps_s2)


@dataclass(frozen=True, slots=True)
class Instruction:
    """One order as it acts on the axis."""

    at_s: float
    kind: Kind
    steps: float  # the target, or the offset; not read otherwise
    limits: Limits


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Legs from a rest to a rest, the last one being the standstill."""

    start_s: FloatArray  # (n,), not decreasing
    steps: FloatArray  # (n,), at each leg's start
    speed: FloatArray  # (n,), signed
    acceleration: FloatArray  # (n,), signed
    way: FloatArray  # (n,), steps gone in either direction
    limits: Limits | None = None  # of its only order; None where there were several

    @property
    def end_s(self) -> float:
        """When the axis comes to rest."""
        return float(self.start_s[-1])

    def position_steps(self, time_s: FloatArray) -> FloatArray:
        """Return where the axis is, shape as `time_s`."""
        at, since = self._at(time_s)
        half = self.speed[at] + 0.5 * self.acceleration[at] * since
        return np.asarray(self.steps[at] + half * since, dtype=np.float64)

    def speed_steps_s(self, time_s: FloatArray) -> FloatArray:
        """Return the signed speed; 0 at rest."""
        at, since = self._at(time_s)
        speed = self.speed[at] + self.acceleration[at] * since
        return np.where(time_s < self.start_s[0], 0.0, speed)

    def state(self, time_s: float) -> tuple[float, float, float]:
        """Return position, signed speed and signed acceleration at a time not before its start."""
        at = max(0, int(np.searchsorted(self.start_s, time_s, side="right")) - 1)
        since = time_s - float(self.start_s[at])
        speed, acceleration = float(self.speed[at]), float(self.acceleration[at])
        steps = float(self.steps[at]) + (speed + 0.5 * acceleration * since) * since
        return steps, speed + acceleration * since, acceleration

    def share(self, time_s: FloatArray) -> FloatArray:
        """Return the share of the whole way that is done, 0 to 1."""
        at, since = self._at(time_s)
        gone = np.abs(self.speed[at] + 0.5 * self.acceleration[at] * since) * since
        return np.asarray((self.way[at] + gone) / max(self.way[-1], 1e-12), dtype=np.float64)

    def _at(self, time_s: FloatArray) -> tuple[IntArray, FloatArray]:
        at = np.maximum(np.searchsorted(self.start_s, time_s, side="right") - 1, 0)
        return at.astype(np.int64), np.maximum(time_s - self.start_s[at], 0.0)


def lay(from_steps: float, orders: Sequence[Instruction]) -> Course:
    """Return the course of an axis that stands at `from_steps` and is given `orders`.

    Args:
        from_steps: where it stands.
        orders: at least one; one that is dated before its forerunner acts with it.
    """
    path = _Path(orders[0].at_s, from_steps)
    target = from_steps
    for order in orders:
        path.cut(max(order.at_s, path.ordered_s))
        if order.kind == "stop":
            path.stop(order.limits)
            target = path.steps
            continue
        if order.kind != "keep":
            target = order.steps if order.kind == "to" else round(path.steps + order.steps)
        path.towards(target, order.limits)
    only = orders[0].limits if len(orders) == 1 and orders[0].kind in ("to", "by") else None
    return replace(path.course(), limits=only)


def carry_on(
    state: tuple[float, float, float], kind: Kind, target: float, limits: Limits
) -> Course:
    """Return the course of one order that finds the axis under way.

    Args:
        state: time, steps, and signed speed where the order takes hold.
        kind: of the order; only a halt has no target.
        target: where it shall go, steps.
        limits: what it is carried out with.
    """
    path = _Path(state[0], state[1])
    path.speed = state[2]
    if kind == "stop":
        path.stop(limits)
    else:
        path.towards(target, limits)
    return path.course()


class _Path:
    """A course under way: the state at its end so far, and its legs."""

    def __init__(self, time_s: float, steps: float) -> None:
        self.time_s, self.steps, self.speed, self.way = time_s, steps, 0.0, 0.0
        self.ordered_s = time_s
        self._legs: list[tuple[float, float, float, float, float]] = []

    def cut(self, time_s: float) -> None:
        """Forget what was planned from `time_s` on, and be there."""
        self.ordered_s = time_s
        while self._legs and self._legs[-1][0] >= time_s:
            self.time_s, self.steps, self.speed, _, self.way = self._legs.pop()
        if self._legs:
            start, steps, speed, acceleration, way = self._legs[-1]
            since = time_s - start
            gone = (speed + 0.5 * acceleration * since) * since
            self.steps, self.way = steps + gone, way + abs(gone)
            self.speed = speed + acceleration * since
        self.time_s = time_s

    def towards(self, target: float, limits: Limits) -> None:
        """Plan the way to rest at `target`."""
        base = limits.base_speed_steps_s
        for _ in range(_MOST_TURNS):
            left = target - self.steps
            if left == 0.0 and abs(self.speed) <= base:
                break
            sign = float(np.sign(left)) or float(np.sign(self.speed))
            forward = self.speed * sign
            if forward >= 0.0 and limits.stopping_steps(forward) <= abs(left) + _SLACK_STEPS:
                self._run(sign, abs(left), limits)
                self.steps = target
                break
            self._brake(limits)
        self._stand()

    def stop(self, limits: Limits) -> None:
        """Plan to brake and stand wherever that is."""
        self._brake(limits)
        self._stand()

    def course(self) -> Course:
        """Return what was planned."""
        columns = np.array(self._legs, dtype=np.float64).T
        return Course(*columns)

    def _run(self, sign: float, left: float, limits: Limits) -> None:
        base, wanted = limits.base_speed_steps_s, limits.speed_steps_s
        forward = self.speed * sign
        begun = self.way
        if wanted <= base:
            if forward > base:
                self._ramp(sign * base, limits)
            self.speed = sign * wanted
            self._cruise(left - (self.way - begun))
            return
        entry = max(forward, base)
        self.speed = sign * entry
        peak = wanted
        if entry <= wanted:
            squares = limits.acceleration_steps_s2 * left + 0.5 * (entry**2 + base**2)
            peak = max(entry, min(wanted, float(np.sqrt(squares))))
        self._ramp(sign * peak, limits)
        self._cruise(left - (self.way - begun) - limits.stopping_steps(peak))
        self._ramp(sign * base, limits)

    def _brake(self, limits: Limits) -> None:
        base = limits.base_speed_steps_s
        if abs(self.speed) > base:
            self._ramp(float(np.sign(self.speed)) * base, limits)
        self.speed = 0.0

    def _ramp(self, speed: float, limits: Limits) -> None:
        change = speed - self.speed
        if change == 0.0:
            return
        duration = abs(change) / limits.acceleration_steps_s2
        self._leg(float(np.sign(change)) * limits.acceleration_steps_s2, duration)
        self.speed = speed

    def _cruise(self, distance: float) -> None:
        if distance > 0.0:
            self._leg(0.0, distance / abs(self.speed))

    def _leg(self, acceleration: float, duration: float) -> None:
        self._legs.append((self.time_s, self.steps, self.speed, acceleration, self.way))
        gone = (self.speed + 0.5 * acceleration * duration) * duration
        self.steps, self.way = self.steps + gone, self.way + abs(gone)
        self.time_s += duration
        self.speed += acceleration * duration

    def _stand(self) -> None:
        self.speed = 0.0
        self._legs.append((self.time_s, self.steps, 0.0, 0.0, self.way))
