"""Base-speed jump: the axes start and stop at a higher speed than commanded."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import InjectedCause, UnitCause
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class BaseSpeedJump(UnitCause):
    """The base speed is higher than commanded."""

    name = "base_speed_jump"
    size_meaning = "excess of the base speed"
    unit = "rad/s"
    typical = 0.05
    sampled_min, sampled_max = 0.01, 0.15
    max_size = 1.0
    parameter = "added"
    stated_name = "speed"
    acts_on_all = True
    is_signed = False

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        for axis in injected.axis_hooks(hooks):
            axis.base_speed_added_rad_s += injected.number("added")
