"""Lost steps: in one move the rotor falls behind the field and never catches up.

The count goes on as if nothing had happened. Every later angle is short by the lost steps until
the unit is homed. A rotor that falls back freely loses whole periods of its field, which are four
full steps. It happens where the torque is least: at the end of the first ramp.
"""

import math
from collections.abc import Sequence

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    InjectedCause,
    ParameterSampling,
    Quantity,
    StatedCause,
    UnitCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks
from gyrorig_daemon.emulator.physics.motion_law import Segment


class LostSteps(UnitCause):
    """Steps are lost once, in the first move that begins after an instant."""

    name = "lost_steps"
    size_meaning = "number of steps lost in one move, in the step mode at power-up"
    unit = "steps"
    typical = 8.0
    sampled_min, sampled_max = 1.0, 16.0
    max_size = 1000.0
    allowed_sizes = (1.0, 2.0, 4.0, 8.0, 16.0)
    is_integer = True

    def __init__(self, steps: float, after_s: float) -> None:
        """Take the number of steps (negative: gained) and the earliest time."""
        self._steps = steps
        self._after_s = after_s
        self.happened_s: float | None = None

    @classmethod
    def sample_parameters(cls, sampling: ParameterSampling) -> dict[str, Quantity]:
        """See `Cause`."""
        return {
            "steps": Quantity(sampling.size, "steps"),
            "after": Quantity(sampling.event_s(), "s"),
        }

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the shift is of the rotor against the count, at a time."""
        at = stated.event_s()
        return tuple(
            CarriedCause(
                {"shift": Quantity(-angle_rad / stated.step_rad[axis], "steps"), "at": at}, axis
            )
            for axis, angle_rad in stated.by_unit_axis("angle")
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            if "shift" in injected.parameters:
                axis.slips.append(RotorShift(injected.number("shift"), injected.number("at")))
            else:
                axis.slips.append(cls(injected.number("steps"), injected.number("after")))

    def on_move(self, segments: Sequence[Segment]) -> tuple[float, float] | None:
        """See `axis_effects.StepLoss`."""
        first = segments[0]
        if self.happened_s is not None or first.start_s < self._after_s or len(segments) < 2:
            return None
        self.happened_s = segments[1].start_s
        if len(segments) == 2:  # no ramp: in the middle of the move
            self.happened_s = 0.5 * (first.start_s + segments[1].start_s)
        direction = math.copysign(1.0, segments[-1].steps - first.steps)
        return self.happened_s, -direction * self._steps


class RotorShift:
    """A shift of the rotor at a time, or at the start of the next move if no axis moves then."""

    def __init__(self, shift_steps: float, at_s: float) -> None:
        """Take the shift of the true position against the count, and the time."""
        self._shift_steps = shift_steps
        self._at_s = at_s
        self.happened_s: float | None = None

    def on_move(self, segments: Sequence[Segment]) -> tuple[float, float] | None:
        """See `axis_effects.StepLoss`."""
        if self.happened_s is not None or segments[-1].start_s <= self._at_s:
            return None
        self.happened_s = max(self._at_s, segments[0].start_s)
        return self.happened_s, self._shift_steps
