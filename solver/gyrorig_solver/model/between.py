"""Signals on a grid of times, read at other times: cubic Hermite interpolation.

What to use when: `Between.of` for the times; `read` where a signal and its slope are at
hand, `operator` where many signals are read at the same times.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from gyrorig_solver.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """Where each time lies on a grid; times beyond its ends lie at the ends."""

    after: IntArray  # (m,), the grid's time before it
    width: FloatArray  # (m,), to the next one
    share: FloatArray  # (m,), of that width
    size: int  # of the grid

    @classmethod
    def of(cls, grid_s: FloatArray, at_s: FloatArray) -> Self:
        """Return where times (m,) lie on a grid (n,) of rising times."""
        at = np.clip(at_s, grid_s[0], grid_s[-1])
        k = np.clip(np.searchsorted(grid_s, at, side="right") - 1, 0, grid_s.size - 2)
        width = grid_s[k + 1] - grid_s[k]
        return cls(k, width, (at - grid_s[k]) / width, grid_s.size)

    def read(self, signal: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a signal and its slope there, (m, c) each, of (n, c) on the grid."""
        width, u = self.width[:, None], self.share[:, None]
        low, high = signal[self.after], signal[self.after + 1]
        rise = (high - low) / width
        begin, end = slope[self.after], slope[self.after + 1]
        c, d = 3.0 * rise - 2.0 * begin - end, begin + end - 2.0 * rise
        value = low + width * u * (begin + u * (c + u * d))
        return value, begin + u * (2.0 * c + 3.0 * u * d)

    def operator(self, step_s: float) -> csr_array:
        """Return what takes a signal (n,) there, (m, n); slopes by differences over a step.

        Args:
            step_s: of the grid, about the same everywhere.
        """
        u, width = self.share, self.width
        rise = u * u * (3.0 - 2.0 * u)
        found = [(self.after, 1.0 - rise), (self.after + 1, rise)]
        for at, weight in (
            (self.after, width * u * (1.0 - u) ** 2),
            (self.after + 1, width * u * u * (u - 1.0)),
        ):
            right, left = np.minimum(at + 1, self.size - 1), np.maximum(at - 1, 0)
            slope = weight / ((right - left) * step_s)
            found += [(right, slope), (left, -slope)]
        columns, values = (np.concatenate(each) for each in zip(*found, strict=True))
        rows = np.tile(np.arange(u.size), len(found))
        return csr_array((values, (rows, columns)), shape=(u.size, self.size))
