"""Temperature coefficient of the scale factor: k (T - T0) u, with T0 the temperature at power-up.

Size: the I3G4250D data sheet gives 2 % from -40 to 85 degC, which is 1.6e-4 per kelvin.
"""

import numpy as np

from gyrorig_daemon.emulator.causes.cause import FloatArray, RateCause
from gyrorig_daemon.emulator.physics.effects.board_effects import MotionSamples


class ThermalScale(RateCause):
    """The gain changes with the temperature of the board."""

    name = "thermal_scale"
    size_meaning = "largest relative change of the gain with the temperature"
    unit = "1/K"
    typical = 3e-4
    sampled_min, sampled_max = 1e-4, 2e-3
    max_size = 0.05
    parameter = "share_per_k"

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """See `board_effects.RateEffect`."""
        rise_k = samples.temperature.rise_k(samples.time_s)
        return np.asarray(rise_k[:, None] * self.coefficient * samples.sensor_rad_s)
