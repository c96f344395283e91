"""Step resolution: the angle per step differs from the nominal one."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import InjectedCause, UnitCause
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class StepResolution(UnitCause):
    """The angle per step has a relative error."""

    name = "step_resolution"
    size_meaning = "relative error of the angle per step"
    unit = "1"
    typical = 2e-3
    sampled_min, sampled_max = 1e-4, 1e-2
    max_size = 0.5
    parameter = "relative_error"
    stated_name = "share"

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            axis.scale_error += injected.number("relative_error")
