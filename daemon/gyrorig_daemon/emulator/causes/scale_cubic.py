"""Cubic scale-factor non-linearity: c u^3 per axis, with u the rate times the gain.

Size: 0.2 % of the full scale is typical (I3G4250D data sheet, non-linearity).
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, RateCause
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples


class ScaleCubic(RateCause):
    """The output has a cubic term in the rate."""

    name = "scale_cubic"
    size_meaning = "largest coefficient c of the term c u^3, where u is the rate"
    unit = "s^2/rad^2"
    typical = 1e-3
    sampled_min, sampled_max = 3e-4, 1e-2
    max_size = 0.5
    parameter = "coefficient"

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        return np.asarray(self.coefficient * samples.limit_to_range(samples.sensor_rad_s) ** 3)
