"""What an effect of a board sees and has to be, by where it acts on the way to counts.

    motion -> mount -> rate -> low-pass -> bias -> limit -> counts -> frames

`MountEffect` turns the board, `RateEffect` adds to the rate that the sensor element feels
(before the low-pass, on a grid much finer than the samples), `BiasEffect` adds to the
samples, `CountEffect` spoils the words. Effects of one place see the signal without each
other. A block of samples may be computed again when the motion changes; what is drawn at
random is drawn once a block, in `draw`.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import Motor
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """A row of instants, as the sensor element lives through them."""

    time_s: FloatArray  # since the origin, (n,)
    pan_rad: FloatArray  # of the axes, (n,)
    tilt_rad: FloatArray
    pan_rate_rad_s: FloatArray
    tilt_rate_rad_s: FloatArray
    sensor_rad_s: FloatArray  # rate times gain, sensor axes, (n, 3)
    force_m_s2: FloatArray  # specific force, sensor axes, (n, 3)
    temperature: BoardTemperature
    pan: Motor  # what drove the axes, and drives them
    tilt: Motor


class MountEffect(Protocol):
    """Turns the board on the stage."""

    def turned(self, time_s: FloatArray, vectors: FloatArray) -> FloatArray:
        """Return vectors as the turned sensor sees them, both (n, 3)."""
        ...


class RateEffect(Protocol):
    """Adds to what the sensor element feels."""

    def added_rad_s(self, moments: Moments) -> FloatArray:
        """Return the rate to add, sensor axes, (n, 3)."""
        ...


class BiasEffect(Protocol):
    """Adds to the samples."""

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """Return the rate to add, sensor axes, (n, 3); times grow from call to call."""
        ...


class CountEffect(Protocol):
    """Spoils the gyro's words."""

    def draw(self, count: int) -> None:
        """Go on to the next block, of `count` samples."""
        ...

    def changed(self, counts: IntArray) -> IntArray:
        """Return what is read instead of (n, 3) words of the block."""
        ...
