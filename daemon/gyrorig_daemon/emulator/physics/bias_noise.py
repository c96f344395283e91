"""Bias wander: bias instability (flicker noise) and rate random walk, drawn block by block.

Flicker of instability B has the two-sided density B^2 / (2 pi f), one-sided twice that, and an
Allan deviation of 0.664 B. Here it is a sum of first-order Gauss-Markov processes with time
constants in the ratio r. Their one-sided sum is s^2 / (f ln r) between the corner frequencies, so
that each one has the variance s^2 = B^2 ln r / pi. Source: IEEE Std 952-1997, annex C.

Both start at zero, so that the bias at power-on is the one in the truth document.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_TIME_CONSTANTS_S = np.array([0.25 * 4.0**k for k in range(7)])  # 0.25 s .. 1024 s


class BiasWander:
    """Wander of three biases: flicker plus random walk."""

    def __init__(
        self,
        instability: FloatArray,
        random_walk: FloatArray,
        period_s: float,
        rng: np.random.Generator,
    ) -> None:
        """Start at zero.

        Args:
            instability: flicker coefficient B of each axis, in units of the output, (3,).
            random_walk: in units of the output per sqrt(s), (3,).
            period_s: time between two calls of `advance`.
            rng: source of the random numbers.
        """
        ratio = math.log(_TIME_CONSTANTS_S[1] / _TIME_CONSTANTS_S[0])
        sigma = np.asarray(instability) * math.sqrt(ratio / math.pi)
        self._keep = np.exp(-period_s / _TIME_CONSTANTS_S)[:, None]
        self._step = np.sqrt(1.0 - self._keep**2) * sigma[None, :]
        self._walk_step = np.asarray(random_walk) * math.sqrt(period_s)
        self._flicker = np.zeros((len(_TIME_CONSTANTS_S), 3))
        self._walk = np.zeros(3)
        self._rng = rng

    def advance(self) -> FloatArray:
        """Return the wander one period later, shape (3,)."""
        draws = self._rng.standard_normal((len(_TIME_CONSTANTS_S) + 1, 3))
        self._flicker = self._keep * self._flicker + self._step * draws[:-1]
        self._walk = self._walk + self._walk_step * draws[-1]
        return np.asarray(self._flicker.sum(axis=0) + self._walk)


def white_step_sigma(density_per_rthz: FloatArray, period_s: float) -> FloatArray:
    """Return the standard deviation of substeps for a one-sided noise density.

    White noise held over substeps of T has the two-sided density sigma^2 T at frequencies
    far below 1 / T; one-sided it is twice that, so sigma = density / sqrt(2 T).
    """
    return np.asarray(density_per_rthz) / math.sqrt(2.0 * period_s)
