"""Base compliance: the tripod twists under the torque that accelerates the head.

Turning a load of inertia I with the acceleration a needs the torque I a. A base of torsional
stiffness k twists by I a / k against it. With c = I / k in s^2 the stage turns by

    x - c x''

and its rate has a double pulse at each edge of the speed. This is the limit of a base that is
much stiffer than the bandwidth of the sensor. A softer base oscillates, see `ringing`.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    FloatArray,
    InjectedCause,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks

# A jump of the speed takes the rotor some time, much shorter than the low-pass resolves.
_RISE_S = 0.125e-3


class BaseCompliance(Cause):
    """The base twists in proportion to the acceleration."""

    name = "base_compliance"
    size_meaning = "twist of the base per acceleration"
    part = "ptu"
    unit = "s^2"
    typical = 5e-5
    sampled_min, sampled_max = 1.5e-5, 1.5e-4
    max_size = 1e-2
    parameter = "compliance"
    stated_name = "coefficient"
    components = ("pan",)
    is_signed = False

    def __init__(self, compliance_s2: float) -> None:
        """Take inertia divided by stiffness."""
        self._compliance_s2 = compliance_s2

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        return tuple(
            CarriedCause({cls.parameter: Quantity(value, cls.unit)}, axis)
            for axis, value in stated.by_unit_axis(cls.stated_name)
        )

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            axis.angle_effects.append(cls(injected.number("compliance")))

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`; only the load behind the gear has inertia."""
        acceleration = motor.wheel_acceleration_steps_s2(start_s, offsets_s, _RISE_S)
        return np.asarray(-self._compliance_s2 * motor.step_rad * acceleration)

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`; there is no state."""
