"""A sensor whose output is no straight line of the rate, axis by axis.

    quadratic  q u^2        cubic  c u^3        asymmetry  a |u|        dead zone  -u where |u| < d

with u the rate times the gain. Sources: I3G4250D data sheet (non-linearity), rig discovery
survey, section 2; a sensor whose scale depends on the sign: boards survey, section 1.4.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.sensor import Moments

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Power:
    """coefficient * u^power."""

    coefficient: FloatArray  # (3,)
    power: int

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        return np.asarray(self.coefficient * moments.sensor_rad_s**self.power)


@dataclass(frozen=True, slots=True, eq=False)
class Asymmetry:
    """The scale differs between the two directions by twice the share."""

    share: FloatArray  # (3,)

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        return np.asarray(self.share * np.abs(moments.sensor_rad_s))


@dataclass(frozen=True, slots=True, eq=False)
class DeadZone:
    """Rates below a width are not felt at all."""

    width_rad_s: FloatArray  # (3,)

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """See `sensor.RateEffect`."""
        u = moments.sensor_rad_s
        return np.where(np.abs(u) < self.width_rad_s, -u, 0.0)
