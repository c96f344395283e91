"""Wrong full scale: the sensor measures in another range than it reports.

The L3G4200D has the ranges 250, 500 and 2000 deg/s.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import (
    CarriedCause,
    Cause,
    InjectedCause,
    StatedCause,
)
from gyrorig_daemon.emulator.physics.effects.rig_hooks import RigHooks


class WrongFullScale(Cause):
    """A wider range gives fewer counts for the same rate."""

    name = "wrong_full_scale"
    size_meaning = "true full scale divided by the reported one"
    part = "link"
    unit = "1"
    typical = 2.0
    sampled_min, sampled_max = 0.5, 8.0
    max_size = 16.0
    parameter = "full_scale_ratio"
    min_size = 1.0 / 16.0
    is_signed = False
    allowed_sizes = (0.5, 2.0)
    neutral_size = 1.0

    @classmethod
    def from_findings(cls, stated: StatedCause) -> tuple[CarriedCause, ...]:
        """See `Cause`; the gain and the bias of a fit contain the effect."""
        return ()

    @classmethod
    def apply(cls, injected: InjectedCause, hooks: RigHooks, rng: np.random.Generator) -> None:
        """See `Cause`."""
        injected.board_hooks(hooks).count_factor /= injected.number("full_scale_ratio")
