"""Clock offset: a constant delay between the motion and the samples, besides the board's own."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class ClockOffset(Cause):
    """A constant delay is added to the board's lag tau."""

    name = "clock_offset"
    size_meaning = "delay of a sample behind the motion"
    part = "clock"
    unit = "s"
    typical = 5e-3
    sampled_min, sampled_max = 1e-3, 20e-3
    max_size = 0.2
    parameter = "lag"
    is_signed = False

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the time offset of a fit contains the effect."""
        return ()

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).tau_added_s += injected.number("lag")
