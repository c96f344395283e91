"""What else a gyro feels: gravity, vibration, the motors' current, a warm die.

    g-sensitivity       G f            f the specific force at rest, sensor axes
    rectification       v (p^2 + t^2)  p, t the speeds of the axes: a stepper shakes with its
                                       speed, and a sensor rectifies the square
    motor coupling      m              while a motor turns
    thermal scale       k (T - T0) u   T0 the temperature at power-up

Sources: rig discovery survey, section 2; boards survey, section 1.1 (sensitivity change).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.sensor import Moments

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GSensitivity:
    """The output moves with the force on the proof mass."""

    matrix: FloatArray  # rad/s per m/s^2, (3, 3)

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        return np.asarray(moments.force_m_s2 @ self.matrix.T)


@dataclass(frozen=True, slots=True, eq=False)
class Rectification:
    """The output moves with the power of the vibration."""

    coefficient_s: FloatArray  # rad/s per (rad/s)^2, (3,)

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        power = moments.pan_rate_rad_s**2 + moments.tilt_rate_rad_s**2
        return np.asarray(power[:, None] * self.coefficient_s)


@dataclass(frozen=True, slots=True, eq=False)
class MotorCoupling:
    """The output moves while a motor is driven."""

    bias_rad_s: FloatArray  # (3,)

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        turning = np.abs(moments.pan_rate_rad_s) + np.abs(moments.tilt_rate_rad_s) > _STILL_RAD_S
        return np.asarray(turning[:, None] * self.bias_rad_s)


# Differences of angles over a substep have this much of rounding; a motor turns far faster.
_STILL_RAD_S = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ThermalScale:
    """The gain moves with the temperature."""

    share_per_k: FloatArray  # (3,)

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        rise = moments.temperature.rise_k(moments.time_s)
        return np.asarray(rise[:, None] * self.share_per_k * moments.sensor_rad_s)
