"""Angle error of an integrated rate, and Allan deviation.

What to use when: `to_uniform_grid` to put a fit's arrays on one uniform grid, `angle_error` for the
rms error of the integrated angle, `allan_deviation` and `modelled_allan_deviation` for the noise.

Source: IEEE Std 952, Annex C, with the project's one-sided densities: white noise of density
N gives N^2 / (2 tau), a bias instability B gives (0.664 B)^2, a random walk K gives K^2 tau / 3.
"""

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray

SPAN_COUNT = 36  # integration times
_MIN_WINDOWS = 5  # complete windows of the longest span
_MIN_WINDOW_SHARE = 0.9  # of a window's blocks must be present
_MAX_GRID_FACTOR = 4  # in samples; a longer grid means recordings far apart
_MAX_WINDOWS_PER_SPAN = 20_000  # windows, overlapping, of each span


def to_uniform_grid(time_s: FloatArray, values: FloatArray) -> tuple[float, FloatArray]:
    """Return the grid's step and the values on it, nan where there are none.

    Args:
        time_s: shape (n,), increasing, uniform except for gaps.
        values: shape (n, 3).
    """
    step_s = float(np.median(np.diff(time_s)))
    row = np.rint((time_s - time_s[0]) / step_s).astype(np.int64)
    if row[-1] >= _MAX_GRID_FACTOR * time_s.size:
        return step_s, values
    gridded = np.full((int(row[-1]) + 1, values.shape[1]), np.nan)
    gridded[row] = values
    return step_s, gridded


def window_lengths(count: int) -> list[int]:
    """Return window lengths in blocks, ascending."""
    longest = max(1, count // _MIN_WINDOWS)
    return sorted({int(length) for length in np.rint(np.geomspace(1, longest, SPAN_COUNT))})


def angle_error(error_rad_s: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return integration times in s and the rms angle error in rad.

    Args:
        error_rad_s: of the rate, on a uniform grid, nan where there is none, shape (n, 3).
        step_s: of the grid.
    """
    lengths, angles = [], []
    sums = _RunningSums(error_rad_s)
    for window in window_lengths(error_rad_s.shape[0]):
        squares, count = sums.squared_means(window)
        if count:
            lengths.append(window * step_s)
            angles.append(float(np.sqrt(np.sum(squares) / count)) * window * step_s)
    return np.array(lengths), np.array(angles)


def allan_deviation(rate_rad_s: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return averaging times in s and the Allan deviation of each axis, shape (k, 3)."""
    taus, deviations = [], []
    sums = _RunningSums(rate_rad_s)
    for window in window_lengths(rate_rad_s.shape[0]):
        squares, count = sums.squared_means(window, behind=window)
        if count:
            taus.append(window * step_s)
            deviations.append(np.sqrt(0.5 * squares / count))
    return np.array(taus), np.array(deviations).reshape(-1, rate_rad_s.shape[1])


def modelled_allan_deviation(
    tau_s: FloatArray, white: float | None, instability: float | None, walk: float | None
) -> FloatArray:
    """Return the Allan deviation of noise with these coefficients, of one axis."""
    variance = (white or 0.0) ** 2 / (2.0 * tau_s) + (0.664 * (instability or 0.0)) ** 2
    return np.asarray(np.sqrt(variance + (walk or 0.0) ** 2 * tau_s / 3.0), dtype=np.float64)


class _RunningSums:
    """Cumulative sums of a signal, for the means of any windows."""

    def __init__(self, values: FloatArray) -> None:
        """Compute the sums.

        Args:
            values: shape (n, 3), nan where there are none.
        """
        known = np.asarray(np.isfinite(values).all(axis=1), dtype=np.bool_)
        self._total = np.zeros((values.shape[1], values.shape[0] + 1))
        np.cumsum(
            np.where(known, np.ascontiguousarray(values.T), 0.0), axis=1, out=self._total[:, 1:]
        )
        self._count = np.concatenate([[0], np.cumsum(known)])

    def squared_means(self, m: int, behind: int = 0) -> tuple[FloatArray, int]:
        """Return the sum over complete windows of the square of each axis' mean, and their number.

        Args:
            m: blocks in a window.
            behind: blocks between the starts of two windows, for the difference of their means;
                0: no difference.
        """
        last = self._count.size - 1 - m - behind
        stride = max(1, last // _MAX_WINDOWS_PER_SPAN)
        means, is_whole = self._means(slice(0, max(0, last + 1), stride), m)
        if behind:
            later = slice(behind, behind + max(0, last + 1), stride)
            later_means, later_is_whole = self._means(later, m)
            means, is_whole = later_means - means, is_whole & later_is_whole
        if not is_whole.all():
            means = means[:, is_whole]
        return np.einsum("ak,ak->a", means, means), means.shape[1]

    def _means(self, start: slice, m: int) -> tuple[FloatArray, BoolArray]:
        stop = slice(start.start + m, start.stop + m, start.step)
        block_count = self._count[stop] - self._count[start]
        means = self._total[:, stop] - self._total[:, start]
        means *= 1.0 / np.maximum(block_count, 1)
        return means, np.asarray(block_count >= _MIN_WINDOW_SHARE * m, dtype=np.bool_)
