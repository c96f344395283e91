"""Scale-factor asymmetry: a |u| per axis, with u the rate times the gain.

The scale factors of the two directions differ by 2 a. One BMI270 was off by 2 deg after 10 turns in
each direction, others by 0.2 to 0.4 deg (Bosch Sensortec community forum).
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, RateCause
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples


class ScaleAsymmetry(RateCause):
    """The scale factor depends on the sign of the rate."""

    name = "scale_asymmetry"
    size_meaning = "largest coefficient a of the term a |u|, where u is the rate"
    unit = "1"
    typical = 2e-3
    sampled_min, sampled_max = 5e-4, 1e-2
    max_size = 0.2
    parameter = "share"

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        return np.asarray(self.coefficient * np.abs(samples.limit_to_range(samples.sensor_rad_s)))
