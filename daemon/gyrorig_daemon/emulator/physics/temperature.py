"""How warm a board is: it heats itself after power-up, and the room may swing around it.

    T(t) = ambient + h (1 - exp(-t / w)) + s (1 - cos(2 pi t / P)) / 2

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
    soak_period_s: float = 120.0

    def degc(self, time_s: FloatArray) -> FloatArray:
        """Return what a thermometer on the board shows, (n,)."""
        warm = -np.expm1(-(time_s - self.start_s) / self.warm_up_s)
        told: FloatArray = self.ambient_degc + self.self_heating_k * warm
        if self.soak_k != 0.0:
            told = told + 0.5 * self.soak_k * (1.0 - np.cos(self._turn_rad_s * time_s))
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
            w = self._turn_rad_s
            swing = np.cos(w * since) + w * lag_s * np.sin(w * since)
            soak = (1.0 - fast) - (swing - fast) / (1.0 + (w * lag_s) ** 2)
            rise = rise + 0.5 * self.soak_k * soak
        return np.asarray(rise)

    @property
    def _turn_rad_s(self) -> float:
        return 2.0 * math.pi / self.soak_period_s
