"""How warm a board is: it heats itself after power-up, and the room may swing around it.

    T(t) = ambient + h (1 - exp(-t / w)) + s (1 - cos(2 pi (t - b) / P)) / 2

with h the self-heating, and s the swing of the room, which begins at b with period P.

The die of a sensor follows its board with a first-order lag; both parts have a closed form.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BoardTemperature:
    """The temperature of a board that was switched on at `start_s`."""

    ambient_degc: float
    self_heating_k: float
    warm_up_s: float
    start_s: float
    soak_k: float = 0.0  # how far the room warms up and cools down again
    soak_s: tuple[float, float] = (0.0, 120.0)  # when it begins, and when it has cooled down

    def degc(self, time_s: FloatArray) -> FloatArray:
        """Return what a thermometer on the board shows, (n,)."""
        warm = -np.expm1(-(time_s - self.start_s) / self.warm_up_s)
        told: FloatArray = self.ambient_degc + self.self_heating_k * warm
        if self.soak_k != 0.0:
            told = told + 0.5 * self.soak_k * (
                1.0 - np.cos(self._turn_rad_s * self._soaked(time_s))
            )
        return told

    def rise_k(self, time_s: FloatArray, lag_s: float = 0.0) -> FloatArray:
        """Return how much warmer a part is than at power-up, (n,).

        Args:
            time_s: since the origin.
            lag_s: time constant with which the part follows the board.
        """
        if lag_s <= 0.0:
            return np.asarray(self.degc(time_s) - self.ambient_degc)
        since = np.maximum(time_s - self.start_s, 0.0)
        # A lag that equals the warm-up time has a form of its own; a shade beside it, this one.
        lag = lag_s if abs(lag_s / self.warm_up_s - 1.0) > 1e-6 else lag_s * (1.0 + 1e-6)
        slow, fast = np.exp(-since / self.warm_up_s), np.exp(-since / lag)
        heat = 1.0 - (self.warm_up_s * slow - lag * fast) / (self.warm_up_s - lag)
        rise = self.self_heating_k * heat
        if self.soak_k != 0.0:
            w, soaked = self._turn_rad_s, self._soaked(time_s)
            faded = np.exp(-soaked / lag_s)
            swing = np.cos(w * soaked) + w * lag_s * np.sin(w * soaked)
            soak = (1.0 - faded) - (swing - faded) / (1.0 + (w * lag_s) ** 2)
            rise = rise + 0.5 * self.soak_k * soak
        return np.asarray(rise)

    @property
    def _turn_rad_s(self) -> float:
        return 2.0 * math.pi / (self.soak_s[1] - self.soak_s[0])

    def _soaked(self, time_s: FloatArray) -> FloatArray:
        return np.maximum(time_s - self.soak_s[0], 0.0)
