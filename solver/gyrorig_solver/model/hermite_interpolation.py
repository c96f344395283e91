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

    def interpolate(self, signal: FloatArray, slope: FloatArray) -> FloatArray:
        """Return a signal, (m, c), from the signal and its derivative on the grid, (n, c) each."""
        fraction, rest = self.fraction, 1.0 - self.fraction
        return self._sum_at_nodes(
            (signal, (1.0 + 2.0 * fraction) * rest**2, fraction**2 * (3.0 - 2.0 * fraction)),
            (slope, self.width * fraction * rest**2, -self.width * fraction**2 * rest),
        )

    def differentiate(self, signal: FloatArray, slope: FloatArray) -> FloatArray:
        """Return the derivative of the signal that `interpolate` returns, (m, c)."""
        fraction, rest = self.fraction, 1.0 - self.fraction
        rise = 6.0 * fraction * rest / self.width
        return self._sum_at_nodes(
            (signal, -rise, rise),
            (slope, rest * (1.0 - 3.0 * fraction), fraction * (3.0 * fraction - 2.0)),
        )

    def _sum_at_nodes(self, *weighted: tuple[FloatArray, FloatArray, FloatArray]) -> FloatArray:
        """Return the sum of grid values times the weights of the lower and the upper node.

        The values of one column are contiguous, because numpy is slow on rows of three.
        """
        total = np.zeros((weighted[0][0].shape[1], self.fraction.size))
        for values, lower_weight, upper_weight in weighted:
            columns = values.T
            for index, weight in (
                (self.lower_index, lower_weight),
                (self.lower_index + 1, upper_weight),
            ):
                total += columns.take(index, axis=1) * weight
        return total.T

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
