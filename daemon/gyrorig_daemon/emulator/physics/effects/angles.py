"""Errors of an axis that depend on its angle alone: gears, sag, a wrong zero.

`Harmonic` is all of them: amplitude * sin(order * angle + phase). The order is 1 and 2 for
an eccentric and an oval gear, and the number of worm turns per turn of the axis for the
worm (17.5 on this unit); order 1 on tilt is the sag under a payload, whose torque follows
the sine of the tilt angle. `Offset` is a home switch that sits elsewhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import Motor

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Harmonic:
    """An error that comes back with the angle."""

    amplitude_rad: float
    order: float  # periods in a turn of the axis
    phase_rad: float

    def added_rad(
        self, _motor: Motor, _start_s: float, _offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`."""
        return np.asarray(self.amplitude_rad * np.sin(self.order * angle_rad + self.phase_rad))

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`: nothing is remembered."""


@dataclass(frozen=True, slots=True)
class Offset:
    """A zero that is not where it should be."""

    angle_rad: float

    def added_rad(
        self, _motor: Motor, _start_s: float, _offsets_s: FloatArray, angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`."""
        return np.full_like(angle_rad, self.angle_rad)

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`: nothing is remembered."""
