"""Non-orthogonality of the pan and tilt axes.

The attitude of the stage is computed in `physics.stage_motion`.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    Quantity,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class AxisNonorthogonality(Cause):
    """The tilt axis is not perpendicular to the pan axis."""

    name = "axis_nonorthogonality"
    size_meaning = "deviation of the two axes from a right angle"
    part = "ptu"
    unit = "rad"
    typical = 3.5e-3
    sampled_min, sampled_max = 1.7e-3, 9e-3
    max_size = 0.1
    parameter = "angle"
    components = ("tilt",)

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`."""
        angle_rad = -stated.number("angle")  # findings: positive leans the pan axis towards +x
        return (CarriedCause({cls.parameter: Quantity(angle_rad, cls.unit)}, "tilt"),)

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        hooks.tilt_axis_error_rad += injected.number("angle")
