"""A board's temperature at its gyroscope: smoothed readings, and the lag of the die.

Sensors report in steps (1 K on an L3G4200D, updated once per second), while the temperature of a
board changes over minutes. The steps would add false edges to every thermal signal.

What to use when: `BoardTemperature.of` once per recording; `die_temperature_rise` in every signal
state.

Source: Whittaker smoothing, Eilers, "A perfect smoother", Anal. Chem. 75 (2003) 3631: minimises sum
(z - T)^2 + lambda sum (second difference of z)^2; its response is 1/(1 + (omega tau)^4) with lambda
= (tau/step)^4. The smoothness is the largest that the scatter of the readings allows (Morozov's
discrepancy principle), because a room can change within a minute.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import solveh_banded

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.recursive_filters import filter_from_rest

GRID_STEP_S = 1.0  # of the smoothed grid
SMOOTHING_TIMES_S = (20.0, 12.0, 8.0, 5.0, 3.0, 2.0, 1.0)  # tau, in the order of the attempts
MIN_OCCUPIED_CELLS = 3  # with readings; fewer do not determine a curve
MAX_MISFIT_SHARE = 0.7  # of the readings' scatter; limit of the smooth curve's misfit
MIN_READINGS = 8  # readings
# A gradient over less time, multiplied by the lag, would amplify the noise of the thermometer.
MIN_GRADIENT_S = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class BoardTemperature:
    """The temperature of one board over a recording, on a grid of `GRID_STEP_S`."""

    time_s: FloatArray  # (m,)
    degc: FloatArray  # (m,)
    mean_degc: float  # the reference of thermal causes
    gradient_width_s: float = 0.0  # minimum time over which the gradient is a mean

    @classmethod
    def of(
        cls, time_s: FloatArray, readings_degc: FloatArray, mean_degc: float | None = None
    ) -> Self | None:
        """Return the smoothed temperature, or None if there are too few readings.

        Args:
            time_s: shape (n,), not decreasing.
            readings_degc: shape (n,), nan if a sample has no reading.
            mean_degc: the reference temperature, common to a board's recordings; by default the
                mean.
        """
        has_reading = np.isfinite(readings_degc)
        if has_reading.sum() < MIN_READINGS:
            return None
        grid_s, degc = _smooth_readings(time_s[has_reading], readings_degc[has_reading])
        return cls(grid_s, degc, float(degc.mean()) if mean_degc is None else mean_degc)

    @property
    def span_k(self) -> float:
        """The highest minus the lowest temperature."""
        return float(np.ptp(self.degc))

    def smoothed(self, width_s: float) -> Self:
        """Return the temperature as means over a window, which removes the thermometer's noise."""
        degc = _moving_means(_moving_means(self.degc, width_s), width_s)
        return replace(self, degc=degc, gradient_width_s=MIN_GRADIENT_S)

    def die_temperature_rise(self, time_s: FloatArray, lag_s: float = 0.0) -> FloatArray:
        """Return the die's temperature minus the reference temperature, shape as `time_s`.

        Args:
            time_s: on the recording's time axis.
            lag_s: above 0 the thermometer is late, T_die = T + lag dT/dt; below 0 the die is late,
                dT_die/dt = (T - T_die)/|lag|. To first order, both are T + lag dT/dt.
        """
        rise = self.degc - self.mean_degc
        if lag_s > 0.0:
            slope = np.gradient(rise, GRID_STEP_S)
            rise = rise + lag_s * _moving_means(slope, max(lag_s, self.gradient_width_s))
        elif lag_s < 0.0:
            rise = _lagged(rise, -lag_s)
        return np.asarray(np.interp(time_s, self.time_s, rise), dtype=np.float64)


def _moving_means(values: FloatArray, width_s: float) -> FloatArray:
    """Return means over a window of the grid, (n,); it is shorter at the ends."""
    half = min(int(0.5 * width_s / GRID_STEP_S), (values.size - 1) // 2)
    total = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(values.size)
    reach = np.minimum(half, np.minimum(index, values.size - 1 - index))
    means = (total[index + reach + 1] - total[index - reach]) / (2 * reach + 1)
    return np.asarray(means, dtype=np.float64)


def _lagged(rise: FloatArray, tau_s: float) -> FloatArray:
    """Return the solution x of x' = (u - x)/tau, exact for u linear between grid times.

    The initial state is the thermometer's value, as after power-on and after a long rest.
    """
    decay = float(np.exp(-GRID_STEP_S / tau_s))
    share = (1.0 - decay) * tau_s / GRID_STEP_S
    driven = np.empty_like(rise)
    driven[0] = rise[0]
    driven[1:] = (share - decay) * rise[:-1] + (1.0 - share) * rise[1:]
    return filter_from_rest(np.ones(1), np.array([1.0, -decay]), driven)


def _smooth_readings(time_s: FloatArray, degc: FloatArray) -> tuple[FloatArray, FloatArray]:
    count = max(4, int(np.ceil((time_s[-1] - time_s[0]) / GRID_STEP_S)) + 1)
    cell = np.minimum(((time_s - time_s[0]) / GRID_STEP_S + 0.5).astype(np.int64), count - 1)
    weight = np.bincount(cell, minlength=count).astype(np.float64)
    cell_sum = np.bincount(cell, degc, minlength=count)
    # Every cell has the same weight, for any number of readings.
    occupied = (weight > 0.0).astype(np.float64)
    mean = cell_sum / np.maximum(weight, 1.0)
    if np.sum(occupied) < MIN_OCCUPIED_CELLS:
        constant = np.full(count, np.mean(degc))
        return time_s[0] + GRID_STEP_S * np.arange(count), constant
    smoothed, scatter = mean, _cell_std(degc, mean[occupied > 0.0])
    for tau_s in SMOOTHING_TIMES_S:
        smoothed = _whittaker_smooth(mean, occupied, (tau_s / GRID_STEP_S) ** 4)
        misfit = float(np.sqrt(np.sum(occupied * (smoothed - mean) ** 2) / np.sum(occupied)))
        if misfit <= MAX_MISFIT_SHARE * scatter:
            break
    return time_s[0] + GRID_STEP_S * np.arange(count), smoothed


def _cell_std(degc: FloatArray, means: FloatArray) -> float:
    """Return the standard deviation of the cell means from quantisation or noise.

    The noise is estimated from second differences, which are small for a smooth curve.
    """
    steps = np.diff(np.unique(degc))
    quantum = float(np.min(steps[steps > 1e-6], initial=np.inf))
    rounding = quantum / np.sqrt(12.0) if np.isfinite(quantum) else 0.0
    noise = float(np.std(np.diff(means, 2)) / np.sqrt(6.0)) if means.size > 2 else 0.0
    return max(rounding, noise)


def _whittaker_smooth(mean: FloatArray, occupied: FloatArray, stiffness: float) -> FloatArray:
    count = mean.size
    # Upper bands of W + lambda D'D; the rows of D are 1, -2, 1.
    bands = np.zeros((3, count))
    bands[2] = occupied
    row = (1.0, -2.0, 1.0)
    for first in range(3):
        for second in range(first, 3):
            product = stiffness * row[first] * row[second]
            bands[2 - second + first, second : count - 2 + second] += product
    return np.asarray(solveh_banded(bands, mean * occupied), dtype=np.float64)
