"""Temperature of a board: self-heating after power-up, and a temperature cycle of the room.

    T(t) = ambient + h (1 - exp(-t / w)) + s (1 - cos(2 pi (t - b) / P)) / 2

with the self-heating h, and the amplitude s of the room, which starts at b with period P.

The die of a sensor follows its board with a first-order lag; both parts have a closed form. A
measured curve can replace the model (`TemperatureCurve`).
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TemperatureCurve:
    """A temperature by time with straight lines between its knots, constant beyond the ends."""

    time_s: tuple[float, ...]  # since the origin, increasing
    degc: tuple[float, ...]

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the temperature, (n,)."""
        return np.interp(time_s, *self._knots)

    @cached_property
    def _knots(self) -> tuple[FloatArray, FloatArray]:
        return np.array(self.time_s), np.array(self.degc)

    def behind(self, time_s: FloatArray, lag_s: float) -> FloatArray:
        """Return the temperature of a part that follows with a first-order lag, (n,)."""
        knots_s, deficit_k, slope_k_s = _lag_deficits(self, lag_s)
        knot = np.clip(np.searchsorted(knots_s, time_s, side="right") - 1, 0, None)
        elapsed_s = np.maximum(time_s - knots_s[knot], 0.0)
        steady_k = slope_k_s[knot] * lag_s
        # x' = (u - x) / lag with u linear: u - x decays to slope lag.
        decay = np.exp(-elapsed_s / lag_s)
        return np.asarray(self.at(time_s) - steady_k - (deficit_k[knot] - steady_k) * decay)


@lru_cache(maxsize=64)
def _lag_deficits(
    curve: TemperatureCurve, lag_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the knots, how far the part is behind at each, and the slope after each, (k,)."""
    knots_s, degc = np.array(curve.time_s), np.array(curve.degc)
    slope_k_s = np.append(np.diff(degc) / np.diff(knots_s), 0.0)
    deficit_k = np.zeros(len(knots_s))
    for k in range(len(knots_s) - 1):
        steady_k = slope_k_s[k] * lag_s
        decay = math.exp(-(knots_s[k + 1] - knots_s[k]) / lag_s)
        deficit_k[k + 1] = steady_k + (deficit_k[k] - steady_k) * decay
    return knots_s, deficit_k, slope_k_s


@dataclass(frozen=True, slots=True)
class BoardTemperature:
    """The temperature of a board that was switched on at `start_s`."""

    ambient_degc: float
    self_heating_k: float
    warm_up_s: float
    start_s: float
    soak_k: float = 0.0  # temperature rise of the room, before it cools down again
    soak_s: tuple[float, float] = (0.0, 120.0)  # its start and end
    curve: TemperatureCurve | None = None  # instead of all this

    @property
    def power_up_degc(self) -> float:
        """The temperature at power-up."""
        if self.curve is None:
            return self.ambient_degc
        return float(self.curve.at(np.array([self.start_s]))[0])

    def degc(self, time_s: FloatArray) -> FloatArray:
        """Return the temperature of the board, (n,)."""
        if self.curve is not None:
            return self.curve.at(time_s)
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
            lag_s: time constant with which the part follows the board. Below 0 the board follows
                the part, with the slope of the board as a mean over this time.
        """
        if lag_s <= 0.0:
            ahead = self.degc(time_s)
            if lag_s < 0.0:
                ahead = ahead + self.degc(time_s - 0.5 * lag_s) - self.degc(time_s + 0.5 * lag_s)
            return np.asarray(ahead - self.power_up_degc)
        if self.curve is not None:
            return np.asarray(self.curve.behind(time_s, lag_s) - self.power_up_degc)
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
