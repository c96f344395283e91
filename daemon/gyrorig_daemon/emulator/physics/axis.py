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
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import AngleEffect, StepEffect
from gyrorig_daemon.emulator.physics.effects.slip import Slip
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw, Segment, halt_target, plan
from gyrorig_daemon.emulator.physics.train import StepTrain

FloatArray = NDArray[np.float64]

ARCSEC_RAD = math.pi / (180.0 * 3600.0)
_JUST_BEFORE_S = 1e-9  # a slip happens at once: the other side of it


@dataclass(frozen=True, slots=True)
class AxisTruth:
    """How an axis turns commands into steps, and steps into an angle."""

    resolution_arcsec: float  # nominal, as the unit answers it
    scale_error: float = 0.0  # true step = nominal x (1 + scale_error)
    sign: int = 1  # -1: the unit counts against the frame of the contract
    acceleration_error: float = 0.0  # true acceleration = told x (1 + error)
    base_speed_added_steps_s: float = 0.0  # true base speed = told + this
    s_curve_s: float = 0.0  # the plan is averaged over this time
    slip: Slip | None = None
    play: tuple[StepEffect, ...] = ()  # between motor and gear
    effects: tuple[AngleEffect, ...] = ()  # behind the gear

    @property
    def step_rad(self) -> float:
        """The true angle of one step, signed."""
        return self.sign * self.resolution_arcsec * ARCSEC_RAD * (1.0 + self.scale_error)

    def real_law(self, law: MotionLaw) -> MotionLaw:
        """Return how the axis really moves when it is told a law."""
        if self.acceleration_error == 0.0 and self.base_speed_added_steps_s == 0.0:
            return law
        return replace(
            law,
            base_speed_steps_s=max(law.base_speed_steps_s + self.base_speed_added_steps_s, 1.0),
            acceleration_steps_s2=law.acceleration_steps_s2 * (1.0 + self.acceleration_error),
        )


Order = tuple[str, float, float, MotionLaw]  # what, when, to where, under which limits


class StepperAxis:
    """Counted position and true angle of an axis under commands.

    `revision` grows with every command that changes the motion, so that whoever computed
    ahead knows that it has to compute again. To its effects it is a `motor.Motor`.
    """

    def __init__(self, truth: AxisTruth, law: MotionLaw, true_steps: float = 0.0) -> None:
        """Stand still, counting zero, at a true position of `true_steps`."""
        self.truth = truth
        self.law = law
        self.revision = 0
        self._train = StepTrain(truth.s_curve_s)
        self._shift_starts = [-math.inf]
        self._shifts = [true_steps]  # true minus counted position from each start on
        self._slips: list[tuple[float, float]] = []  # those shifts that are motions
        self.orders: list[Order] = []  # all that it was told, for `obey`

    def state(self, time_s: float) -> tuple[float, float]:
        """Return continuous counted position (steps) and speed (steps/s)."""
        return self._train.state(time_s)

    def count(self, time_s: float) -> int:
        """Return the whole steps that have passed: what the unit answers."""
        steps, speed = self.state(time_s)
        near = round(steps)
        if abs(steps - near) < 1e-6:
            return near
        return math.floor(steps) if speed >= 0.0 else math.ceil(steps)

    def target(self) -> int:
        """Return where the axis will come to rest, in counted steps."""
        return round(self._train.target_steps)

    def rests_at_s(self) -> float:
        """Return when the axis comes to rest for good."""
        return self._train.rests_at_s

    def moving(self, time_s: float) -> bool:
        """Return whether the axis turns."""
        return time_s < self.rests_at_s()

    def move(self, time_s: float, target_steps: float, law: MotionLaw | None = None) -> None:
        """Go to a counted position from `time_s` on; `law` only for this move."""
        self.orders.append(("move", time_s, target_steps, law or self.law))
        self._move(time_s, target_steps, law or self.law)

    def _move(self, time_s: float, target_steps: float, law: MotionLaw) -> None:
        steps, speed = self._train.planned_state(time_s)
        segments = plan(time_s, steps, speed, target_steps, self.truth.real_law(law))
        self._train.append(segments)
        self._changed(time_s)
        slip = None if self.truth.slip is None else self.truth.slip.on_move(segments)
        if slip is not None:
            self._slip(*slip)

    def set_law(self, time_s: float, law: MotionLaw) -> None:
        """Change the limits; a move under way goes on under the new ones."""
        self.orders.append(("set_law", time_s, 0.0, law))
        self.law = law
        if self.moving(time_s):
            self._move(time_s, self._train.target_steps, law)

    def halt(self, time_s: float) -> None:
        """Decelerate and stop at the next whole step."""
        self.orders.append(("halt", time_s, 0.0, self.law))
        steps, speed = self._train.planned_state(time_s)
        if speed != 0.0:
            law = replace(self.law, speed_steps_s=abs(speed))
            self._move(time_s, halt_target(steps, speed, self.truth.real_law(law)), law)

    def recount(self, time_s: float, count: float) -> None:
        """Call the position of now `count` without turning: what homing does."""
        self.orders.append(("recount", time_s, count, self.law))
        self._shift_by(time_s, self._train.recount(time_s, count))

    def shift(self, time_s: float, steps: float) -> None:
        """From now on the true position is `steps` more away from the counted one."""
        self.orders.append(("shift", time_s, steps, self.law))
        self._slip(time_s, steps)

    def obey(self, orders: Sequence[Order]) -> None:
        """Do what another axis was told, at the same times."""
        for what, time_s, to, law in orders:
            if what == "set_law":
                self.set_law(time_s, law)
                continue
            self.law = law
            if what == "move":
                self.move(time_s, to)
            elif what == "halt":
                self.halt(time_s)
            elif what == "recount":
                self.recount(time_s, to)
            else:
                self.shift(time_s, to)

    def _slip(self, time_s: float, steps: float) -> None:
        self._slips.append((time_s, steps))
        self._shift_by(time_s, steps)

    def shift_steps(self, time_s: float) -> float:
        """Return true minus counted position."""
        return self._shifts[bisect_right(self._shift_starts, time_s) - 1]

    def angles_rad(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the true angle at `start_s + k period_s`, k = 0..count-1, shape (count,)."""
        offsets: FloatArray = period_s * np.arange(count, dtype=np.float64)
        steps = self.rotor_steps(start_s, offsets)
        for effect in self.truth.play:
            steps = effect.passed_steps(self, start_s, offsets, steps)
        angles = steps * self.truth.step_rad
        behind_gear = angles
        for added in self.truth.effects:
            angles = angles + added.added_rad(self, start_s, offsets, behind_gear)
        return angles

    @property
    def step_rad(self) -> float:
        """See `effects.motor.Motor`."""
        return self.truth.step_rad

    @property
    def s_curve_s(self) -> float:
        """See `effects.motor.Motor`."""
        return self.truth.s_curve_s

    def rotor_steps(self, start_s: float, offsets_s: FloatArray) -> FloatArray:
        """See `effects.motor.Motor`."""
        steps, _ = self._train.evaluate(start_s, offsets_s)
        at = np.searchsorted(self._shift_starts, start_s + offsets_s, side="right") - 1
        return np.asarray(steps + np.asarray(self._shifts, dtype=np.float64)[at])

    def driven_steps(self, start_s: float, offsets_s: FloatArray) -> FloatArray:
        """See `effects.motor.Motor`."""
        steps = self.rotor_steps(start_s, offsets_s)
        for slipped_s, by in self._slips:
            steps = steps - by * (start_s + offsets_s >= slipped_s)
        return steps

    def turning_times_s(self, after_s: float, until_s: float) -> list[float]:
        """See `effects.motor.Motor`."""
        times = self._train.turning_times_s(after_s, until_s)
        slips = [t - before for t, _ in self._slips for before in (_JUST_BEFORE_S, 0.0)]
        inside = [t for t in slips if after_s < t <= until_s]
        return sorted({*times, *inside}) if inside else times

    def planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """See `effects.motor.Motor`."""
        return self._train.planned(after_s, until_s)

    def _shift_by(self, time_s: float, steps: float) -> None:
        at = bisect_right(self._shift_starts, time_s)
        self._shift_starts.insert(at, time_s)
        self._shifts.insert(at, self._shifts[at - 1])
        self._shifts[at:] = [shift + steps for shift in self._shifts[at:]]
        self._changed(time_s)

    def _changed(self, time_s: float) -> None:
        self.revision += 1
        for gap in self.truth.play:
            gap.forget(time_s)
        for added in self.truth.effects:
            added.forget(time_s)
