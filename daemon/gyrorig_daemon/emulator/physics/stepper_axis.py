"""Open-loop stepper axis: its counted position and its true angle.

A stepper unit reports the steps that it has commanded, not the angle of its axis. `count` is the
reported value; `angles_rad` is the true angle that acts on a sensor on the stage. They differ by
the scale of the gear, by lost steps and homing (`shift`), and by the effects on the axis.

Times are seconds since the rig's origin. Commands must come in order of time. A query about the
time before a command is answered as if the command had not been given.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import AngleEffect, StepEffect, StepLoss
from gyrorig_daemon.emulator.physics.motion_law import MotionLaw, Segment, halt_target, plan_motion
from gyrorig_daemon.emulator.physics.step_train import StepTrain

FloatArray = NDArray[np.float64]

ARCSEC_RAD = math.pi / (180.0 * 3600.0)
_BEFORE_SLIP_S = 1e-9  # a slip happens at once: the other side of it


@dataclass(frozen=True, slots=True)
class AxisTruth:
    """True properties of an axis: commands to steps, and steps to an angle."""

    resolution_arcsec: float  # nominal, as reported by the unit
    scale_error: float = 0.0  # true step = nominal x (1 + scale_error)
    sign: int = 1  # -1: the unit counts opposite to docs/conventions.md
    acceleration_error: float = 0.0  # true acceleration = commanded x (1 + error)
    base_speed_added_steps_s: float = 0.0  # true base speed = commanded + this
    s_curve_s: float = 0.0  # length of the window that averages the plan
    start_delay_s: float = 0.0  # from a command to the change of the motion
    slips: tuple[StepLoss, ...] = ()
    step_effects: tuple[StepEffect, ...] = ()  # between motor and gear
    angle_effects: tuple[AngleEffect, ...] = ()  # behind the gear

    @property
    def step_rad(self) -> float:
        """The true angle of one step, signed."""
        return self.sign * self.resolution_arcsec * ARCSEC_RAD * (1.0 + self.scale_error)

    def true_law(self, law: MotionLaw) -> MotionLaw:
        """Return the law by which the axis moves when `law` is commanded."""
        if self.acceleration_error == 0.0 and self.base_speed_added_steps_s == 0.0:
            return law
        return replace(
            law,
            base_speed_steps_s=max(law.base_speed_steps_s + self.base_speed_added_steps_s, 1.0),
            acceleration_steps_s2=law.acceleration_steps_s2 * (1.0 + self.acceleration_error),
        )


AxisCommand = tuple[str, float, float, MotionLaw]  # kind, time, target, limits


class StepperAxis:
    """Counted position and true angle of an axis that executes commands.

    `revision` grows with every command that changes the motion, so that whoever computed
    ahead knows that it has to compute again. To its effects it is a `motor.Motor`.
    """

    def __init__(self, truth: AxisTruth, law: MotionLaw, true_steps: float = 0.0) -> None:
        """Start at rest, with count zero, at a true position of `true_steps`."""
        self.truth = truth
        self.law = law
        self.revision = 0
        self._train = StepTrain(truth.s_curve_s)
        self._shift_starts = [-math.inf]
        self._shifts = [true_steps]  # true minus counted position from each start on
        self._slips: list[tuple[float, float]] = []  # shifts in which the rotor moves
        self.commands: list[AxisCommand] = []  # all commands, for `replay`

    def state(self, time_s: float) -> tuple[float, float]:
        """Return continuous counted position (steps) and speed (steps/s)."""
        return self._train.state(time_s)

    def count(self, time_s: float) -> int:
        """Return the whole steps that have passed, which the unit reports."""
        steps, speed = self.state(time_s)
        nearest = round(steps)
        if abs(steps - nearest) < 1e-6:
            return nearest
        return math.floor(steps) if speed >= 0.0 else math.ceil(steps)

    def target(self) -> int:
        """Return the position at which the axis will stop, in counted steps."""
        return round(self._train.target_steps)

    def rests_at_s(self) -> float:
        """Return when the axis stops."""
        return self._train.rests_at_s

    def is_moving(self, time_s: float) -> bool:
        """Return whether the axis is moving."""
        return time_s < self.rests_at_s()

    def move(self, time_s: float, target_steps: float, law: MotionLaw | None = None) -> None:
        """Move to a counted position from `time_s` on; `law` applies to this move only."""
        self.commands.append(("move", time_s, target_steps, law or self.law))
        self._move(time_s, target_steps, law or self.law)

    def _move(self, commanded_s: float, target_steps: float, law: MotionLaw) -> None:
        time_s = commanded_s + self.truth.start_delay_s
        steps, speed = self._train.planned_state(time_s)
        segments = plan_motion(time_s, steps, speed, target_steps, self.truth.true_law(law))
        self._train.append(segments)
        self._invalidate(time_s)
        losses = [slip.on_move(segments) for slip in self.truth.slips]
        for loss in sorted(loss for loss in losses if loss is not None):
            self._slip(*loss)

    def set_law(self, time_s: float, law: MotionLaw) -> None:
        """Change the limits; a move in progress continues with the new ones."""
        self.commands.append(("set_law", time_s, 0.0, law))
        self.law = law
        if self.is_moving(time_s):
            self._move(time_s, self._train.target_steps, law)

    def halt(self, time_s: float) -> None:
        """Decelerate and stop at the next whole step."""
        self.commands.append(("halt", time_s, 0.0, self.law))
        steps, speed = self._train.planned_state(time_s + self.truth.start_delay_s)
        if speed != 0.0:
            law = replace(self.law, speed_steps_s=abs(speed))
            self._move(time_s, halt_target(steps, speed, self.truth.true_law(law)), law)

    def recount(self, time_s: float, count: float) -> None:
        """Set the count of the present position without motion, as homing does."""
        self.commands.append(("recount", time_s, count, self.law))
        self._shift_by(time_s, self._train.recount(time_s, count))

    def shift(self, time_s: float, steps: float) -> None:
        """Shift the true position by `steps` against the counted one from now on."""
        self.commands.append(("shift", time_s, steps, self.law))
        self._slip(time_s, steps)

    def replay(self, commands: Sequence[AxisCommand]) -> None:
        """Execute the commands of another axis at the same times."""
        for kind, time_s, value, law in commands:
            if kind == "set_law":
                self.set_law(time_s, law)
                continue
            self.law = law
            if kind == "move":
                self.move(time_s, value)
            elif kind == "halt":
                self.halt(time_s)
            elif kind == "recount":
                self.recount(time_s, value)
            else:
                self.shift(time_s, value)

    def _slip(self, time_s: float, steps: float) -> None:
        self._slips.append((time_s, steps))
        self._shift_by(time_s, steps)

    def shift_steps(self, time_s: float) -> float:
        """Return true minus counted position."""
        return self._shifts[bisect_right(self._shift_starts, time_s) - 1]

    def angles_rad(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the true angle at `start_s + k period_s`, k = 0..count-1, shape (count,)."""
        offsets: FloatArray = period_s * np.arange(count, dtype=np.float64)
        angles = self._wheel_steps(start_s, offsets) * self.truth.step_rad
        gear_angles = angles
        for angle_effect in self.truth.angle_effects:
            angles = angles + angle_effect.added_rad(self, start_s, offsets, gear_angles)
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
        first = bisect_right(self._shift_starts, start_s + float(offsets_s[0]))
        if first == bisect_right(self._shift_starts, start_s + float(offsets_s[-1])):
            return steps + self._shifts[first - 1]
        indices = np.searchsorted(self._shift_starts, start_s + offsets_s, side="right") - 1
        return np.asarray(steps + np.asarray(self._shifts, dtype=np.float64)[indices])

    def _wheel_steps(self, start_s: float, offsets_s: FloatArray) -> FloatArray:
        steps = self.rotor_steps(start_s, offsets_s)
        for effect in self.truth.step_effects:
            steps = effect.passed_steps(self, start_s, offsets_s, steps)
        return steps

    def wheel_acceleration_steps_s2(
        self, start_s: float, offsets_s: FloatArray, rise_s: float
    ) -> FloatArray:
        """See `effects.motor.Motor`."""
        now, previous, earlier = (
            self._wheel_steps(start_s - delay * rise_s, offsets_s) for delay in range(3)
        )
        acceleration = (now - 2.0 * previous + earlier) / rise_s**2
        for slipped_s, _ in self._slips:
            since_s = start_s + offsets_s - slipped_s
            acceleration[(since_s >= 0.0) & (since_s < 2.0 * rise_s)] = 0.0
        return np.asarray(acceleration)

    def reversal_times_s(self, after_s: float, until_s: float) -> list[float]:
        """See `effects.motor.Motor`."""
        times = self._train.reversal_times_s(after_s, until_s)
        slips = [t - before for t, _ in self._slips for before in (_BEFORE_SLIP_S, 0.0)]
        inside = [t for t in slips if after_s < t <= until_s]
        return sorted({*times, *inside}) if inside else times

    def planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """See `effects.motor.Motor`."""
        return self._train.planned(after_s, until_s)

    def wheel_planned(self, after_s: float, until_s: float) -> list[tuple[Segment, float]]:
        """See `effects.motor.Motor`."""
        segments = self.planned(after_s, until_s)
        for effect in self.truth.step_effects:
            standing_s = effect.standing_s(self, segments[0][0].start_s, until_s)
            segments = _with_rests(segments, standing_s)
        begun = [(segment, before) for segment, before in segments if segment.start_s <= until_s]
        return begun or segments[:1]

    def _shift_by(self, time_s: float, steps: float) -> None:
        index = bisect_right(self._shift_starts, time_s)
        self._shift_starts.insert(index, time_s)
        self._shifts.insert(index, self._shifts[index - 1])
        self._shifts[index:] = [shift + steps for shift in self._shifts[index:]]
        self._invalidate(time_s)

    def _invalidate(self, time_s: float) -> None:
        self.revision += 1
        for step_effect in self.truth.step_effects:
            step_effect.forget(time_s)
        for angle_effect in self.truth.angle_effects:
            angle_effect.forget(time_s)


def _with_rests(
    segments: Sequence[tuple[Segment, float]], rests_s: Sequence[tuple[float, float]]
) -> list[tuple[Segment, float]]:
    """Return segments, each with the speed before it, with rests in them."""
    if not rests_s:
        return list(segments)
    pieces: list[Segment] = []
    for k, (segment, _) in enumerate(segments):
        start_s = segment.start_s
        end_s = segments[k + 1][0].start_s if k + 1 < len(segments) else math.inf
        for rest_start_s, rest_end_s in rests_s:
            if rest_end_s <= start_s or rest_start_s >= end_s:
                continue
            if rest_start_s > start_s:
                pieces.append(_from(segment, start_s))
            begin_s = max(rest_start_s, start_s)
            pieces.append(Segment(begin_s, segment.at(begin_s)[0], 0.0, 0.0))
            start_s = min(rest_end_s, end_s)
        if start_s < end_s:
            pieces.append(_from(segment, start_s))
    speeds = [segments[0][1], *(before.at(piece.start_s)[1] for before, piece in pairwise(pieces))]
    return list(zip(pieces, speeds, strict=True))


def _from(segment: Segment, start_s: float) -> Segment:
    """Return a segment from a time in it on."""
    steps, speed = segment.at(start_s)
    return Segment(start_s, steps, speed, segment.acceleration_steps_s2)
