"""Temperature of a board: self-heating after power-up, and a temperature cycle of the room.

    T(t) = ambient + h (1 - exp(-t / w)) + s (1 - cos(2 pi (t - b) / P)) / 2

with the self-heating h, and the amplitude s of the room, which starts at b with period P.

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
    soak_k: float = 0.0  # temperature rise of the room, before it cools down again
    soak_s: tuple[float, float] = (0.0, 120.0)  # its start and end

    def degc(self, time_s: FloatArray) -> FloatArray:
        """Return the temperature of the board, (n,)."""
        warmed_share = -np.expm1(-(time_s - self.start_s) / self.warm_up_s)
        temperature_degc: FloatArray = self.ambient_degc + self.self_heating_k * warmed_share
        if self.soak_k != 0.0:
            temperature_degc = temperature_degc + 0.5 * self.soak_k * (
                1.0 - np.cos(self._soak_rad_s * self._soak_time_s(time_s))
            )
        return temperature_degc

    def rise_k(self, time_s: FloatArray, lag_s: float = 0.0) -> FloatArray:
        """Return the temperature rise of a part since power-up, (n,).

        Args:
            time_s: since the origin.
            lag_s: time constant with which the part follows the board.
        """
        if lag_s <= 0.0:
            return np.asarray(self.degc(time_s) - self.ambient_degc)
        elapsed_s = np.maximum(time_s - self.start_s, 0.0)
        # The closed form is singular if the lag equals the warm-up time.
        lag = lag_s if abs(lag_s / self.warm_up_s - 1.0) > 1e-6 else lag_s * (1.0 + 1e-6)
        slow, fast = np.exp(-elapsed_s / self.warm_up_s), np.exp(-elapsed_s / lag)
        heat = 1.0 - (self.warm_up_s * slow - lag * fast) / (self.warm_up_s - lag)
        rise = self.self_heating_k * heat
        if self.soak_k != 0.0:
            w, soak_time_s = self._soak_rad_s, self._soak_time_s(time_s)
            decay = np.exp(-soak_time_s / lag_s)
            swing = np.cos(w * soak_time_s) + w * lag_s * np.sin(w * soak_time_s)
            soak = (1.0 - decay) - (swing - decay) / (1.0 + (w * lag_s) ** 2)
            rise = rise + 0.5 * self.soak_k * soak
        return np.asarray(rise)

    @property
    def _soak_rad_s(self) -> float:
        return 2.0 * math.pi / (self.soak_s[1] - self.soak_s[0])

    def _soak_time_s(self, time_s: FloatArray) -> FloatArray:
        return np.maximum(time_s - self.soak_s[0], 0.0)
