"""An angle error that is periodic in the angle: amplitude * sin(order * angle + phase).

The order is 1 for an eccentric gear, 2 for an oval one, and the number of worm turns per turn
of the axis for a worm. Order 1 on the tilt axis is also the sag under a payload, whose torque
follows the sine of the tilt angle.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One period in the angle."""

    amplitude_rad: float
    order: float  # periods per turn of the axis
    phase_rad: float

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `axis_effects.AngleEffect`."""
        return np.asarray(self.amplitude_rad * np.sin(self.order * angle_rad + self.phase_rad))

    def forget(self, time_s: float) -> None:
        """See `axis_effects.AngleEffect`; there is no state."""
