"""Cubic Hermite interpolation of signals on a grid of times.

What to use when: `HermiteInterpolator.of` for the query times; `interpolate` for a signal with a
known derivative; `sparse_operator` for many signals at the same times.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from gyrorig_solver.data import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class HermiteInterpolator:
    """The position of each query time on a grid; times outside it are moved to its ends."""

    lower_index: IntArray  # (m,), index of the previous grid time
    width: FloatArray  # (m,), of the grid interval
    fraction: FloatArray  # (m,), of that interval
    grid_size: int  # of the grid

    @classmethod
    def of(cls, grid_s: FloatArray, query_s: FloatArray) -> Self:
        """Return the positions of query times (m,) on a grid (n,) of increasing times."""
        clipped_s = np.clip(query_s, grid_s[0], grid_s[-1])
        lower_index = np.clip(
            np.searchsorted(grid_s, clipped_s, side="right") - 1, 0, grid_s.size - 2
        )
        width = grid_s[lower_index + 1] - grid_s[lower_index]
        return cls(lower_index, width, (clipped_s - grid_s[lower_index]) / width, grid_s.size)

    def interpolate(self, signal: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a signal and its derivative, (m, c) each, from (n, c) on the grid."""
        width, fraction = self.width[:, None], self.fraction[:, None]
        lower, upper = signal[self.lower_index], signal[self.lower_index + 1]
        rise = (upper - lower) / width
        lower_slope, upper_slope = slope[self.lower_index], slope[self.lower_index + 1]
        quadratic = 3.0 * rise - 2.0 * lower_slope - upper_slope
        cubic = lower_slope + upper_slope - 2.0 * rise
        value = lower + width * fraction * (lower_slope + fraction * (quadratic + fraction * cubic))
        return value, lower_slope + fraction * (2.0 * quadratic + 3.0 * fraction * cubic)

    def sparse_operator(self, step_s: float) -> csr_array:
        """Return the interpolation matrix (m, n), with finite-difference derivatives.

        Args:
            step_s: of the grid, which must be nearly uniform.
        """
        fraction, width = self.fraction, self.width
        rise = fraction * fraction * (3.0 - 2.0 * fraction)
        entries = [(self.lower_index, 1.0 - rise), (self.lower_index + 1, rise)]
        for node, weight in (
            (self.lower_index, width * fraction * (1.0 - fraction) ** 2),
            (self.lower_index + 1, width * fraction * fraction * (fraction - 1.0)),
        ):
            right, left = np.minimum(node + 1, self.grid_size - 1), np.maximum(node - 1, 0)
            slope = weight / ((right - left) * step_s)
            entries += [(right, slope), (left, -slope)]
        columns, values = (np.concatenate(each) for each in zip(*entries, strict=True))
        rows = np.tile(np.arange(fraction.size), len(entries))
        return csr_array((values, (rows, columns)), shape=(fraction.size, self.grid_size))
