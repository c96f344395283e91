"""Motor coupling: a bias that is present while a motor turns, through the supply or the field."""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, RateCause
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples

# Rounding of angle differences over a substep stays below this; a motor turns far faster.
_STILL_RAD_S = 1e-6


class MotorCoupling(RateCause):
    """A constant rate adds to the output while an axis turns."""

    name = "motor_coupling"
    size_meaning = "largest bias while a motor turns"
    unit = "rad/s"
    typical = 6e-4
    sampled_min, sampled_max = 2e-4, 2e-3
    max_size = 0.1
    parameter = "bias"

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        speed_rad_s = np.abs(samples.pan_rate_rad_s) + np.abs(samples.tilt_rate_rad_s)
        is_turning = speed_rad_s > _STILL_RAD_S
        return np.asarray(is_turning[:, None] * self.coefficient)
