"""A board's temperature as its gyro feels it: readings made smooth, and the die's lag.

Sensors report in steps (1 K on an L3G4200D, refreshed once a second) while a board's
temperature is a slow thing (minutes): a staircase would put false edges into every thermal
column. What to use when: `Temperature.of` once for a recording; `at` in every scene.

Source: Whittaker's graduation, Eilers, "A perfect smoother", Anal. Chem. 75 (2003) 3631:
minimises sum (z - T)^2 + lambda sum (second difference of z)^2; its response is
1/(1 + (omega tau)^4) with lambda = (tau/step)^4. How smooth: as smooth as the readings' own
scatter bears (Morozov's discrepancy principle), for a room's swing may take a minute.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import solveh_banded

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.recursive import recursed

STEP_S = 1.0  # of the grid that is made smooth
SMOOTHED_S = (20.0, 12.0, 8.0, 5.0, 3.0, 2.0, 1.0)  # tau, tried in this order
# Of the readings' scatter: a staircase's steps follow a curve that is as smooth as this.
BORNE = 0.7
FEWEST = 8  # readings


@dataclass(frozen=True, slots=True, eq=False)
class Temperature:
    """One board's temperature over a recording, on a grid of `STEP_S`."""

    time_s: FloatArray  # (m,)
    degc: FloatArray  # (m,)
    mean_degc: float  # what thermal causes count from

    @classmethod
    def of(
        cls, time_s: FloatArray, readings_degc: FloatArray, mean_degc: float | None = None
    ) -> Self | None:
        """Return the smoothed temperature, None where there are too few readings.

        Args:
            time_s: shape (n,), not decreasing.
            readings_degc: shape (n,), nan where a sample has none.
            mean_degc: to count from, common to a board's recordings; else this one's mean.
        """
        some = np.isfinite(readings_degc)
        if some.sum() < FEWEST:
            return None
        grid_s, degc = _smooth(time_s[some], readings_degc[some])
        return cls(grid_s, degc, float(degc.mean()) if mean_degc is None else mean_degc)

    @property
    def span_k(self) -> float:
        """Warmest minus coldest."""
        return float(np.ptp(self.degc))

    def at(self, time_s: FloatArray, lag_s: float = 0.0) -> FloatArray:
        """Return the die's temperature minus the mean, shape as `time_s`.

        Args:
            time_s: on the recording's axis.
            lag_s: above 0, the thermometer is late, T_die = T + lag dT/dt; below 0, the
                die is, dT_die/dt = (T - T_die)/|lag|. To first order both are the former.
        """
        rise = self.degc - self.mean_degc
        if lag_s > 0.0:
            rise = rise + lag_s * np.gradient(rise, STEP_S)
        elif lag_s < 0.0:
            rise = _late(rise, -lag_s)
        return np.asarray(np.interp(time_s, self.time_s, rise), dtype=np.float64)


def _late(rise: FloatArray, tau_s: float) -> FloatArray:
    """Return x of x' = (u - x)/tau, exact for u linear between grid times.

    Begun as warm as the thermometer: so it is when the power comes on, and after a long rest.
    """
    decay = float(np.exp(-STEP_S / tau_s))
    share = (1.0 - decay) * tau_s / STEP_S
    driven = np.empty_like(rise)
    driven[0] = rise[0]
    driven[1:] = (share - decay) * rise[:-1] + (1.0 - share) * rise[1:]
    return recursed(np.ones(1), np.array([1.0, -decay]), driven)


def _smooth(time_s: FloatArray, degc: FloatArray) -> tuple[FloatArray, FloatArray]:
    count = max(4, int(np.ceil((time_s[-1] - time_s[0]) / STEP_S)) + 1)
    cell = np.minimum(((time_s - time_s[0]) / STEP_S + 0.5).astype(np.int64), count - 1)
    weight = np.bincount(cell, minlength=count).astype(np.float64)
    total = np.bincount(cell, degc, minlength=count)
    # A cell counts once, whatever the rate of its readings.
    here = (weight > 0.0).astype(np.float64)
    mean = total / np.maximum(weight, 1.0)
    found, scatter = mean, _scatter(degc, mean[here > 0.0])
    for tau_s in SMOOTHED_S:
        found = _graduated(mean, here, (tau_s / STEP_S) ** 4)
        misfit = float(np.sqrt(np.sum(here * (found - mean) ** 2) / np.sum(here)))
        if misfit <= BORNE * scatter:
            break
    return time_s[0] + STEP_S * np.arange(count), found


def _scatter(degc: FloatArray, means: FloatArray) -> float:
    """Return the deviation of the cells' means: that of the readings' steps, or their noise.

    Noise by second differences, of which a smooth course has next to none.
    """
    steps = np.diff(np.unique(degc))
    quantum = float(np.min(steps[steps > 1e-6], initial=np.inf))
    rounding = quantum / np.sqrt(12.0) if np.isfinite(quantum) else 0.0
    noise = float(np.std(np.diff(means, 2)) / np.sqrt(6.0)) if means.size > 2 else 0.0
    return max(rounding, noise)


def _graduated(mean: FloatArray, here: FloatArray, stiffness: float) -> FloatArray:
    count = mean.size
    # Upper bands of W + lambda D'D; the rows of D are 1, -2, 1.
    bands = np.zeros((3, count))
    bands[2] = here
    row = (1.0, -2.0, 1.0)
    for first in range(3):
        for second in range(first, 3):
            product = stiffness * row[first] * row[second]
            bands[2 - second + first, second : count - 2 + second] += product
    return np.asarray(solveh_banded(bands, mean * here), dtype=np.float64)
