"""Arrays of signals of three axes, shape (..., n, 3), whose values of one axis are contiguous.

Filters and transforms run along the time axis. This order in memory needs no copies.

What to use when: `zero_signals` to fill in values, `stack_signals` for several signals,
`on_all_axes` for a signal that is the same on each axis, `split_axes` for one axis at a time;
`AxisBiases` for a bias of each axis without the zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AxisBiases:
    """Signals that act on one axis each: signal 3 k + a is row k on axis a."""

    rows: FloatArray  # (k, n)

    def __len__(self) -> int:
        """Return the number of signals."""
        return 3 * len(self.rows)


Signals = FloatArray | AxisBiases  # (k, n, 3), or each row on each axis


def dense_signals(signals: Signals) -> FloatArray:
    """Return signals with their zeros, (k, n, 3)."""
    return split_axes(on_all_axes(signals.rows)) if isinstance(signals, AxisBiases) else signals


def zero_signals(*shape: int) -> FloatArray:
    """Return zeros of shape (..., n, 3), from (..., n)."""
    *leading, length = shape
    return np.swapaxes(np.zeros((*leading, 3, length)), -1, -2)


def stack_signals(signals: Sequence[FloatArray]) -> FloatArray:
    """Return signals of shape (n, 3) as one array, (k, n, 3)."""
    stacked = zero_signals(len(signals), len(signals[0]))
    for row, signal in zip(stacked, signals, strict=True):
        row[...] = signal
    return stacked


def axis_rows(signals: FloatArray) -> FloatArray:
    """Return signals (..., n, 3) as contiguous rows (..., 3, n)."""
    return np.ascontiguousarray(np.swapaxes(signals, -1, -2))


def on_all_axes(signals: FloatArray) -> FloatArray:
    """Return signals (..., n) as equal signals on each axis, (..., n, 3); do not write to them."""
    return np.broadcast_to(signals[..., None], (*signals.shape, 3))


def is_on_all_axes(signals: FloatArray) -> bool:
    """Return whether signals come from `on_all_axes`."""
    return signals.strides[-1] == 0 and signals.shape[-1] == 3


def split_axes(signals: FloatArray) -> FloatArray:
    """Return signals of three axes, (..., n, 3), as signals of one axis each, (3 ..., n, 3)."""
    rows = signals.reshape(-1, *signals.shape[-2:])
    separated = np.zeros((len(rows), 3, 3, rows.shape[1]))
    for axis in range(3):
        separated[:, axis, axis] = rows[:, :, axis]
    return np.swapaxes(separated.reshape(-1, 3, rows.shape[1]), -1, -2)
