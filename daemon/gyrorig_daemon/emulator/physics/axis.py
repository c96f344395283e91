"""One open-loop stepper axis: what it counts, and where it really is.

A stepper unit answers the steps it has commanded, not the angle of its axis. `count` is
the answer on the wire; `angles_rad` is the truth that a sensor on the stage feels. The
two part by the gear's scale, by lost steps and homing (`shift`), and by whatever effects
are hung on the axis.

Times are seconds since the rig's origin. Commands must come in the order of time; a
question about the time before a command is answered as if the command had not come yet.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.motion_law import MotionLaw, Segment, halt_target, plan

FloatArray = NDArray[np.float64]

ARCSEC_RAD = math.pi / (180.0 * 3600.0)


class AngleEffect(Protocol):
    """What the mechanics add to an axis: the place to hang an imperfection on."""

    def added_rad(self, time_s: FloatArray, steps: FloatArray, speed: FloatArray) -> FloatArray:
        """Return the angle to add, given true steps and counted speed in steps/s."""
        ...


@dataclass(frozen=True, slots=True)
class AxisTruth:
    """How an axis turns steps into an angle."""

    resolution_arcsec: float  # nominal, as the unit answers it
    scale_error: float = 0.0  # true step = nominal x (1 + scale_error)
    sign: int = 1  # -1: the unit counts against the frame of the contract
    effects: tuple[AngleEffect, ...] = field(default=())

    @property
    def step_rad(self) -> float:
        """The true angle of one step, signed."""
        return self.sign * self.resolution_arcsec * ARCSEC_RAD * (1.0 + self.scale_error)


class StepperAxis:
    """Counted position and true angle of an axis under commands.

    `revision` grows with every command that changes the motion, so that whoever computed
    ahead knows that it has to compute again.
    """

    def __init__(self, truth: AxisTruth, law: MotionLaw, true_steps: float = 0.0) -> None:
        """Stand still, counting zero, at a true position of `true_steps`."""
        self.truth = truth
        self.law = law
        self.revision = 0
        self._segments = [Segment(0.0, 0.0, 0.0, 0.0)]
        self._starts = [0.0]
        self._shift_starts = [-math.inf]
        self._shifts = [true_steps]  # true minus counted position from each start on

    def state(self, time_s: float) -> tuple[float, float]:
        """Return continuous counted position (steps) and speed (steps/s)."""
        return self._segments[bisect_right(self._starts, time_s) - 1].at(time_s)

    def count(self, time_s: float) -> int:
        """Return the whole steps that have passed: what the unit answers."""
        steps, speed = self.state(time_s)
        near = round(steps)
        if abs(steps - near) < 1e-6:
            return near
        return math.floor(steps) if speed >= 0.0 else math.ceil(steps)

    def target(self) -> int:
        """Return where the axis will come to rest, in counted steps."""
        return round(self._segments[-1].steps)

    def rests_at_s(self) -> float:
        """Return when the axis comes to rest for good."""
        return self._segments[-1].start_s

    def moving(self, time_s: float) -> bool:
        """Return whether the axis turns."""
        return time_s < self.rests_at_s()

    def move(self, time_s: float, target_steps: float, law: MotionLaw | None = None) -> None:
        """Go to a counted position from `time_s` on; `law` only for this move."""
        steps, speed = self.state(time_s)
        self._append(plan(time_s, steps, speed, target_steps, law or self.law))

    def set_law(self, time_s: float, law: MotionLaw) -> None:
        """Change the limits; a move under way goes on under the new ones."""
        self.law = law
        if self.moving(time_s):
            self.move(time_s, self._segments[-1].steps)

    def halt(self, time_s: float) -> None:
        """Decelerate and stop at the next whole step."""
        steps, speed = self.state(time_s)
        if speed != 0.0:
            law = replace(self.law, speed_steps_s=abs(speed))
            self.move(time_s, halt_target(steps, speed, law), law)

    def recount(self, time_s: float, count: float) -> None:
        """Call the position of now `count` without turning: what homing does."""
        steps, speed = self.state(time_s)
        self.shift(time_s, steps - count)
        self._append([Segment(time_s, count, speed, 0.0)])

    def shift(self, time_s: float, steps: float) -> None:
        """From now on the true position is `steps` more away from the counted one."""
        at = bisect_right(self._shift_starts, time_s)
        self._shift_starts.insert(at, time_s)
        self._shifts.insert(at, self._shifts[at - 1])
        self._shifts[at:] = [shift + steps for shift in self._shifts[at:]]
        self.revision += 1

    def shift_steps(self, time_s: float) -> float:
        """Return true minus counted position."""
        return self._shifts[bisect_right(self._shift_starts, time_s) - 1]

    def angles_rad(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the true angle at `start_s + k period_s`, k = 0..count-1, shape (count,)."""
        offsets: FloatArray = period_s * np.arange(count, dtype=np.float64)
        steps, speed = self._evaluate(start_s, offsets)
        steps = steps + self._shift_array(start_s, offsets)
        angles = steps * self.truth.step_rad
        for effect in self.truth.effects:
            angles = angles + effect.added_rad(start_s + offsets, steps, speed)
        return angles

    def _append(self, segments: list[Segment]) -> None:
        keep = len(self._starts)
        while keep and self._starts[keep - 1] >= segments[0].start_s:
            keep -= 1
        self._segments[keep:] = segments
        self._starts[keep:] = [s.start_s for s in segments]
        self.revision += 1

    def _evaluate(self, start_s: float, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Counted position and speed at `start_s + offsets` (ascending)."""
        first = max(bisect_right(self._starts, start_s) - 1, 0)
        last = bisect_right(self._starts, start_s + float(offsets[-1]))
        edges = [s - start_s for s in self._starts[first + 1 : last]]
        cuts = [0, *np.searchsorted(offsets, edges).tolist(), len(offsets)]
        steps, speeds = np.empty_like(offsets), np.empty_like(offsets)
        for i, segment in enumerate(self._segments[first:last]):
            piece = slice(cuts[i], cuts[i + 1])
            dt = offsets[piece] + (start_s - segment.start_s)
            speed = segment.speed_steps_s + segment.acceleration_steps_s2 * dt
            steps[piece] = segment.steps + 0.5 * (segment.speed_steps_s + speed) * dt
            speeds[piece] = speed
        return steps, speeds

    def _shift_array(self, start_s: float, offsets: FloatArray) -> FloatArray:
        at = np.searchsorted(self._shift_starts, start_s + offsets, side="right") - 1
        return np.asarray(self._shifts, dtype=np.float64)[at]
