"""Interfaces of effects on a board, by their place in the signal path to counts.

    motion -> mount -> rate -> low-pass -> bias -> limit -> counts -> frames

A `MountEffect` rotates the board, a `RateEffect` adds to the rate at the sensor element (before the
low-pass, on a grid much finer than the samples), a `BiasEffect` adds to the samples, and a
`CountEffect` changes the counts. Effects at one place do not see each other. A block of samples can
be computed again when the motion changes; random values are drawn once per block, in `draw`.
`LagEffect` and `JitterEffect` change the instants of the samples, and a `SampleLoss` drops samples.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.axis_effects import Motor
from gyrorig_daemon.emulator.physics.temperature import BoardTemperature

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class MotionSamples:
    """Motion, temperature and signal at a row of instants, as seen by a rate effect."""

    time_s: FloatArray  # since the origin, (n,)
    pan_rad: FloatArray  # of the axes, (n,)
    tilt_rad: FloatArray
    pan_rate_rad_s: FloatArray
    tilt_rate_rad_s: FloatArray
    sensor_rad_s: FloatArray  # rate times gain, sensor axes, (n, 3)
    full_scale_rad_s: float  # of the counts
    force_m_s2: FloatArray  # specific force, sensor axes, (n, 3)
    temperature: BoardTemperature
    pan: Motor  # the motors of the axes
    tilt: Motor

    def limit_to_range(self, rate_rad_s: FloatArray) -> FloatArray:
        """Return a rate, limited to the full scale, as the argument of a non-linear term.

        Where the speed of a motor jumps, a stiff base turns at hundreds of rad/s for a fraction of
        a millisecond. A data sheet states a non-linearity for the range of the part only.
        """
        return np.clip(rate_rad_s, -self.full_scale_rad_s, self.full_scale_rad_s)


class MountEffect(Protocol):
    """Rotates the board on the stage."""

    def turned(self, time_s: FloatArray, vectors: FloatArray) -> FloatArray:
        """Return vectors in the frame of the rotated sensor, both (n, 3)."""
        ...


class RateEffect(Protocol):
    """Adds to the rate at the sensor element."""

    def added_rad_s(self, samples: MotionSamples) -> FloatArray:
        """Return the rate to add, sensor axes, (n, 3)."""
        ...


class BiasEffect(Protocol):
    """Adds to the samples."""

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """Return the rate to add, sensor axes, (n, 3); times increase from call to call."""
        ...


class CountEffect(Protocol):
    """Changes the counts of the gyroscope."""

    def draw(self, count: int) -> None:
        """Draw the random values of the next block, of `count` samples."""
        ...

    def changed(self, counts: IntArray) -> IntArray:
        """Return the counts that are read instead of those of the block, (n, 3)."""
        ...


class LagEffect(Protocol):
    """A delay of the samples behind the motion, in addition to the board's own lag."""

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the lag in s of a sample that is ready at a time, and its growth per s."""
        ...


class JitterEffect(Protocol):
    """A random delay of each sample."""

    def draw_s(self, count: int) -> FloatArray:
        """Return the lags of the next samples, (count,)."""
        ...


class SampleLoss(Protocol):
    """Loss of samples together with their sequence numbers."""

    def draw(self, count: int) -> NDArray[np.bool_]:
        """Return which of the next `count` samples are lost."""
        ...
