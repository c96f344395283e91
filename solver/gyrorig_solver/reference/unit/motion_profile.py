"""Trapezoidal motion profile of a stepper axis, from rest to rest, with commands in motion.

A profile consists of segments of constant acceleration. Below the base speed, the speed changes
immediately; between base and upper speed it has ramps of one acceleration, up and down. A new
target or speed acts from the current position. If the target is behind the axis, or too near to
stop, the axis brakes through the base speed and returns (FLIR PTU command reference manual v3.00D,
section 5). Units are steps and seconds, signed.

What to use when: `plan_motion` for a profile; its methods give position, speed and progress.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray

CommandKind = Literal["to", "by", "keep", "stop"]  # target, offset, new speed, halt
# Tolerance of stopping distances, which are computed again after rounding.
_SLACK_STEPS = 1e-6
_MAX_REVERSALS = 3  # brake, return, approach


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Speed and acceleration limits of a command."""

    speed_steps_s: float
    acceleration_steps_s2: float
    base_speed_steps_s: float

    def stopping_steps(self, speed_steps_s: float) -> float:
        """Return the stopping distance from a speed."""
        excess = speed_steps_s**2 - self.base_speed_steps_s**2
        return max(0.0, excess) / (2.0 * self.acceleration_steps_s2)


@dataclass(frozen=True, slots=True)
class ProfileCommand:
    """One command with the time at which it acts."""

    at_s: float
    kind: CommandKind
    steps: float  # target or offset; not used otherwise
    limits: MotionLimits


@dataclass(frozen=True, slots=True, eq=False)
class MotionProfile:
    """Segments from rest to rest; the last one is the standstill."""

    start_s: FloatArray  # (n,), not decreasing
    start_steps: FloatArray  # (n,), position at the start of each segment
    start_speed_steps_s: FloatArray  # (n,), signed
    acceleration_steps_s2: FloatArray  # (n,), signed
    distance_steps: FloatArray  # (n,), distance covered before each segment
    # executed by this profile; empty if the profile starts in motion
    commands: tuple[ProfileCommand, ...] = ()

    @property
    def end_s(self) -> float:
        """Time at which the axis comes to rest."""
        return float(self.start_s[-1])

    def position_steps(self, time_s: FloatArray) -> FloatArray:
        """Return the position, shape of `time_s`."""
        segment, since = self._segment_at(time_s)
        mean_speed = (
            self.start_speed_steps_s[segment] + 0.5 * self.acceleration_steps_s2[segment] * since
        )
        return np.asarray(self.start_steps[segment] + mean_speed * since, dtype=np.float64)

    def speed_steps_s(self, time_s: FloatArray) -> FloatArray:
        """Return the signed speed; 0 at rest."""
        segment, since = self._segment_at(time_s)
        speed = self.start_speed_steps_s[segment] + self.acceleration_steps_s2[segment] * since
        return np.where(time_s < self.start_s[0], 0.0, speed)

    def state_at(self, time_s: float) -> tuple[float, float, float]:
        """Return position, speed and acceleration, signed, at a time after the start."""
        segment = max(0, int(np.searchsorted(self.start_s, time_s, side="right")) - 1)
        since = time_s - float(self.start_s[segment])
        speed = float(self.start_speed_steps_s[segment])
        acceleration = float(self.acceleration_steps_s2[segment])
        steps = float(self.start_steps[segment]) + (speed + 0.5 * acceleration * since) * since
        return steps, speed + acceleration * since, acceleration

    def progress(self, time_s: FloatArray) -> FloatArray:
        """Return the covered share of the distance, 0 to 1."""
        segment, since = self._segment_at(time_s)
        segment_steps = (
            np.abs(
                self.start_speed_steps_s[segment]
                + 0.5 * self.acceleration_steps_s2[segment] * since
            )
            * since
        )
        return np.asarray(
            (self.distance_steps[segment] + segment_steps) / max(self.distance_steps[-1], 1e-12),
            dtype=np.float64,
        )

    def _segment_at(self, time_s: FloatArray) -> tuple[IntArray, FloatArray]:
        segment = np.maximum(np.searchsorted(self.start_s, time_s, side="right") - 1, 0)
        return segment.astype(np.int64), np.maximum(time_s - self.start_s[segment], 0.0)


def plan_motion(start_steps: float, commands: Sequence[ProfileCommand]) -> MotionProfile:
    """Return the profile of an axis that is at rest at `start_steps` and receives `commands`.

    Args:
        start_steps: position at rest.
        commands: at least one; a command dated before its predecessor acts together with it.
    """
    builder = _ProfileBuilder(commands[0].at_s, start_steps)
    target = start_steps
    for command in commands:
        builder.truncate(max(command.at_s, builder.commanded_s))
        if command.kind == "stop":
            builder.stop(command.limits)
            target = builder.steps
            continue
        if command.kind != "keep":
            target = command.steps if command.kind == "to" else round(builder.steps + command.steps)
        builder.move_to(target, command.limits)
    return replace(builder.profile(), commands=tuple(commands))


def plan_from_state(
    state: tuple[float, float, float], kind: CommandKind, target: float, limits: MotionLimits
) -> MotionProfile:
    """Return the profile of one command that starts while the axis moves.

    Args:
        state: time, steps and signed speed when the command acts.
        kind: of the command; only a halt has no target.
        target: target position, steps.
        limits: of the command.
    """
    builder = _ProfileBuilder(state[0], state[1])
    builder.speed = state[2]
    if kind == "stop":
        builder.stop(limits)
    else:
        builder.move_to(target, limits)
    return builder.profile()


class _ProfileBuilder:
    """Builds a profile segment by segment."""

    def __init__(self, time_s: float, steps: float) -> None:
        self.time_s, self.steps, self.speed, self.distance_steps = time_s, steps, 0.0, 0.0
        self.commanded_s = time_s
        self._segments: list[tuple[float, float, float, float, float]] = []

    def truncate(self, time_s: float) -> None:
        """Remove the segments after `time_s`, and continue from there."""
        self.commanded_s = time_s
        while self._segments and self._segments[-1][0] >= time_s:
            self.time_s, self.steps, self.speed, _, self.distance_steps = self._segments.pop()
        if self._segments:
            start, steps, speed, acceleration, distance_steps = self._segments[-1]
            since = time_s - start
            change_steps = (speed + 0.5 * acceleration * since) * since
            self.steps = steps + change_steps
            self.distance_steps = distance_steps + abs(change_steps)
            self.speed = speed + acceleration * since
        self.time_s = time_s

    def move_to(self, target: float, limits: MotionLimits) -> None:
        """Plan the motion to rest at `target`."""
        base = limits.base_speed_steps_s
        for _ in range(_MAX_REVERSALS):
            remaining = target - self.steps
            if remaining == 0.0 and abs(self.speed) <= base:
                break
            sign = float(np.sign(remaining)) or float(np.sign(self.speed))
            forward = self.speed * sign
            if forward >= 0.0 and limits.stopping_steps(forward) <= abs(remaining) + _SLACK_STEPS:
                self._trapezoid(sign, abs(remaining), limits)
                self.steps = target
                break
            self._brake(limits)
        self._add_standstill()

    def stop(self, limits: MotionLimits) -> None:
        """Plan to brake to rest."""
        self._brake(limits)
        self._add_standstill()

    def profile(self) -> MotionProfile:
        """Return the profile."""
        columns = np.array(self._segments, dtype=np.float64).T
        return MotionProfile(*columns)

    def _trapezoid(self, sign: float, remaining: float, limits: MotionLimits) -> None:
        base, commanded_speed = limits.base_speed_steps_s, limits.speed_steps_s
        forward = self.speed * sign
        start_distance = self.distance_steps
        if commanded_speed <= base:
            if forward > base:
                self._ramp(sign * base, limits)
            self.speed = sign * commanded_speed
            self._cruise(remaining - (self.distance_steps - start_distance))
            return
        entry = max(forward, base)
        self.speed = sign * entry
        peak = commanded_speed
        if entry <= commanded_speed:
            squares = limits.acceleration_steps_s2 * remaining + 0.5 * (entry**2 + base**2)
            peak = max(entry, min(commanded_speed, float(np.sqrt(squares))))
        self._ramp(sign * peak, limits)
        self._cruise(
            remaining - (self.distance_steps - start_distance) - limits.stopping_steps(peak)
        )
        self._ramp(sign * base, limits)

    def _brake(self, limits: MotionLimits) -> None:
        base = limits.base_speed_steps_s
        if abs(self.speed) > base:
            self._ramp(float(np.sign(self.speed)) * base, limits)
        self.speed = 0.0

    def _ramp(self, speed: float, limits: MotionLimits) -> None:
        change = speed - self.speed
        if change == 0.0:
            return
        duration = abs(change) / limits.acceleration_steps_s2
        self._add_segment(float(np.sign(change)) * limits.acceleration_steps_s2, duration)
        self.speed = speed

    def _cruise(self, distance: float) -> None:
        if distance > 0.0:
            self._add_segment(0.0, distance / abs(self.speed))

    def _add_segment(self, acceleration: float, duration: float) -> None:
        self._segments.append(
            (self.time_s, self.steps, self.speed, acceleration, self.distance_steps)
        )
        change_steps = (self.speed + 0.5 * acceleration * duration) * duration
        self.steps = self.steps + change_steps
        self.distance_steps = self.distance_steps + abs(change_steps)
        self.time_s += duration
        self.speed += acceleration * duration

    def _add_standstill(self) -> None:
        self.speed = 0.0
        self._segments.append((self.time_s, self.steps, 0.0, 0.0, self.distance_steps))
