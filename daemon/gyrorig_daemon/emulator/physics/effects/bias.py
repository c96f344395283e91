"""Biases that move: with the die's temperature, since power-up, at an event, at random.

    thermal bias  k (T_die - T0), the die following the board with a lag; T0 at power-up
    warm-up       a exp(-t / w)
    ramp          r t
    step          s from an instant on
    random walk   K times a Wiener process, besides the one that every sensor has
    hum           A sin(2 pi f t + p), which the sampling folds

Times count from power-up. Sources: rig discovery survey, section 2; boards survey, 1.1, 1.4.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.temperature import BoardTemperature

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ThermalBias:
    """The bias follows the die."""

    slope_rad_s_k: FloatArray  # (3,)
    lag_s: float

    def added_rad_s(self, time_s: FloatArray, temperature: BoardTemperature) -> FloatArray:
        """See `sensor.BiasEffect`."""
        return np.outer(temperature.rise_k(time_s, self.lag_s), self.slope_rad_s_k)


@dataclass(frozen=True, slots=True, eq=False)
class WarmUp:
    """The bias settles after power-up."""

    start_rad_s: FloatArray  # (3,)
    time_constant_s: float

    def added_rad_s(self, time_s: FloatArray, _temperature: BoardTemperature) -> FloatArray:
        """See `sensor.BiasEffect`."""
        return np.outer(np.exp(-time_s / self.time_constant_s), self.start_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class Ramp:
    """The bias goes on and on."""

    slope_rad_s2: FloatArray  # (3,)

    def added_rad_s(self, time_s: FloatArray, _temperature: BoardTemperature) -> FloatArray:
        """See `sensor.BiasEffect`."""
        return np.outer(time_s, self.slope_rad_s2)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The bias jumps once."""

    step_rad_s: FloatArray  # (3,)
    at_s: float

    def added_rad_s(self, time_s: FloatArray, _temperature: BoardTemperature) -> FloatArray:
        """See `sensor.BiasEffect`."""
        return np.outer(time_s >= self.at_s, self.step_rad_s)


@dataclass(frozen=True, slots=True, eq=False)
class Hum:
    """The mains come through."""

    amplitude_rad_s: FloatArray  # (3,)
    frequency_hz: float
    phase_rad: float

    def added_rad_s(self, time_s: FloatArray, _temperature: BoardTemperature) -> FloatArray:
        """See `sensor.BiasEffect`."""
        phase = 2.0 * math.pi * self.frequency_hz * time_s + self.phase_rad
        return np.outer(np.sin(phase), self.amplitude_rad_s)


class RandomWalk:
    """The bias wanders, in straight pieces between knots that are drawn in order and kept."""

    _KNOT_S = 0.1

    def __init__(self, walk_rad_s_rts: FloatArray, rng: np.random.Generator) -> None:
        """Begin at zero.

        Args:
            walk_rad_s_rts: standard deviation after a second, (3,).
            rng: where the draws come from.
        """
        self._step = walk_rad_s_rts * math.sqrt(self._KNOT_S)
        self._rng = rng
        self._knots = np.zeros((1, 3))

    def added_rad_s(self, time_s: FloatArray, _temperature: BoardTemperature) -> FloatArray:
        """See `sensor.BiasEffect`."""
        place = np.maximum(time_s, 0.0) / self._KNOT_S
        missing = int(place.max()) + 2 - len(self._knots)
        if missing > 0:  # ahead, so that the whole path is copied now and then only
            steps = self._step * self._rng.standard_normal((max(missing, 1024), 3))
            self._knots = np.vstack([self._knots, self._knots[-1] + np.cumsum(steps, axis=0)])
        at = place.astype(np.int64)
        part = (place - at)[:, None]
        return np.asarray((1.0 - part) * self._knots[at] + part * self._knots[at + 1])
