"""Quadratic scale-factor non-linearity: q u^2 per axis, with u the rate times the gain.

Size: 0.2 % of the full scale is typical (I3G4250D data sheet, non-linearity).
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, RateCause
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples


class ScaleQuadratic(RateCause):
    """The output has a quadratic term in the rate."""

    name = "scale_quadratic"
    size_meaning = "largest coefficient q of the term q u^2, where u is the rate"
    unit = "s/rad"
    typical = 1e-3
    sampled_min, sampled_max = 3e-4, 5e-3
    max_size = 0.1
    parameter = "coefficient"

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        return np.asarray(self.coefficient * samples.limit_to_range(samples.sensor_rad_s) ** 2)
