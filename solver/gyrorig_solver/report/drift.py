"""What a rate error adds up to: the angle it turns into, and its Allan deviation.

What to use when: `on_grid` to put a fit's arrays on one uniform grid, `angle_error` for the
angle that goes wrong in a time, `allan_deviation` and `noise_says` for the noise.

Source: IEEE Std 952, Annex C, with the project's one-sided densities: white noise of density
N gives N^2 / (2 tau), a bias instability B gives (0.664 B)^2, a random walk K gives K^2 tau / 3.
"""

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray

SPANS = 36  # of time, that are looked at
_LEAST_WINDOWS = 5  # whole ones beside each other, behind the longest span
_WHOLE = 0.9  # of a window's blocks have to be there
_LONGEST_GRID = 4  # times as long as what is on it: recordings far apart get none
_STARTS = 20_000  # windows, overlapping, of each span


def on_grid(time_s: FloatArray, values: FloatArray) -> tuple[float, FloatArray]:
    """Return the grid's step and the values on it, nan where there are none.

    Args:
        time_s: shape (n,), increasing, of one step but for gaps.
        values: shape (n, 3).
    """
    step_s = float(np.median(np.diff(time_s)))
    at = np.rint((time_s - time_s[0]) / step_s).astype(np.int64)
    if at[-1] >= _LONGEST_GRID * time_s.size:
        return step_s, values
    out = np.full((int(at[-1]) + 1, values.shape[1]), np.nan)
    out[at] = values
    return step_s, out


def spans(count: int) -> list[int]:
    """Return lengths of windows in blocks, short to long."""
    longest = max(1, count // _LEAST_WINDOWS)
    return sorted({int(m) for m in np.rint(np.geomspace(1, longest, SPANS))})


def angle_error(error_rad_s: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return windows' lengths in s and the rms angle in rad that goes wrong in them.

    Args:
        error_rad_s: of the rate, on a uniform grid, nan where there is none, shape (n, 3).
        step_s: of the grid.
    """
    lengths, angles = [], []
    sums = _Sums(error_rad_s)
    for m in spans(error_rad_s.shape[0]):
        means, there = sums.window_means(m)
        if np.any(there):
            lengths.append(m * step_s)
            turned = means[there] * m * step_s
            angles.append(float(np.sqrt(np.mean(np.sum(turned**2, axis=1)))))
    return np.array(lengths), np.array(angles)


def allan_deviation(rate_rad_s: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return averaging times in s and the Allan deviation of each axis, shape (k, 3)."""
    taus, deviations = [], []
    sums = _Sums(rate_rad_s)
    for m in spans(rate_rad_s.shape[0]):
        means, there = sums.window_means(m, behind=m)
        if np.any(there):
            taus.append(m * step_s)
            deviations.append(np.sqrt(0.5 * np.mean(means[there] ** 2, axis=0)))
    return np.array(taus), np.array(deviations).reshape(-1, rate_rad_s.shape[1])


def noise_says(
    tau_s: FloatArray, white: float | None, instability: float | None, walk: float | None
) -> FloatArray:
    """Return the Allan deviation of noise with these coefficients, of one axis."""
    variance = (white or 0.0) ** 2 / (2.0 * tau_s) + (0.664 * (instability or 0.0)) ** 2
    return np.asarray(np.sqrt(variance + (walk or 0.0) ** 2 * tau_s / 3.0), dtype=np.float64)


class _Sums:
    """Running sums of a signal, out of which the means of any windows come."""

    def __init__(self, values: FloatArray) -> None:
        """Sum up.

        Args:
            values: shape (n, 3), nan where there are none.
        """
        known = np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)
        self._total = np.zeros((values.shape[0] + 1, 3))
        np.cumsum(np.where(known[:, None], values, 0.0), axis=0, out=self._total[1:])
        self._count = np.concatenate([[0], np.cumsum(known)])

    def window_means(self, m: int, behind: int = 0) -> tuple[FloatArray, BoolArray]:
        """Return windows' means, or each one's difference to another; and which are whole.

        Args:
            m: blocks in a window.
            behind: how far behind the other begins; 0: no difference.
        """
        last = self._count.size - 1 - m - behind
        starts = np.arange(0, last + 1, max(1, last // _STARTS)) if last >= 0 else np.zeros(0, int)
        first, there = self._means(starts, m)
        if not behind:
            return first, there
        second, too = self._means(starts + behind, m)
        return second - first, there & too

    def _means(self, at: IntArray, m: int) -> tuple[FloatArray, BoolArray]:
        many = self._count[at + m] - self._count[at]
        found = (self._total[at + m] - self._total[at]) / np.maximum(many, 1)[:, None]
        return np.asarray(found, dtype=np.float64), np.asarray(many >= _WHOLE * m, dtype=np.bool_)
