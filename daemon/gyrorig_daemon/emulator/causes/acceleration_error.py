"""Acceleration error: the controller accelerates faster or slower than commanded.

A step generator rounds its ramp table to ticks of a timer.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import InjectedCause, UnitCause
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class AccelerationError(UnitCause):
    """The acceleration has a relative error."""

    name = "acceleration_error"
    size_meaning = "relative error of the acceleration"
    unit = "1"
    typical = 5e-3
    sampled_min, sampled_max = 5e-4, 2e-2
    max_size = 0.5
    parameter = "relative_error"
    stated_name = "share"
    acts_on_all = True

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            axis.acceleration_error += injected.number("relative_error")
