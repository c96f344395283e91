"""Low-pass lag: the cut-off frequency of the sensor's filter differs from the nominal one."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import Cause, InjectedCause
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class LowPassLag(Cause):
    """A relative error of the cut-off frequency. It changes the group delay."""

    name = "low_pass_lag"
    size_meaning = "relative error of the low-pass cut-off frequency"
    part = "sensor"
    unit = "1"
    typical = 0.3
    sampled_min, sampled_max = 0.1, 0.5
    max_size = 0.9
    parameter = "cutoff_change"

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).bandwidth_factor *= 1.0 + injected.number("cutoff_change")
