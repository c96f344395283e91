"""Vibration rectification error: v (p^2 + t^2), with p and t the speeds of the two axes.

A stepper motor vibrates with its speed, and a sensor rectifies the square of the vibration.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, RateCause
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples


class VibrationRectification(RateCause):
    """The vibration power of the turning axes adds to the bias."""

    name = "vibration_rectification"
    size_meaning = "largest coefficient v of v times the axis speeds squared"
    unit = "s/rad"
    typical = 1e-3
    sampled_min, sampled_max = 2e-4, 5e-3
    max_size = 0.1
    parameter = "coefficient"

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        pan, tilt = map(samples.limit_to_range, (samples.pan_rate_rad_s, samples.tilt_rate_rad_s))
        power = pan**2 + tilt**2
        return np.asarray(power[:, None] * self.coefficient)
