"""Whitened signals that act in short windows, many of them in one transform.

Signals whose windows are far apart share one row. Whitening spreads a signal beyond its window. A
margin on both sides contains nearly all of it. The test statistic of such signals is also
chi-squared in noise. On 300 s of moves, the information of a delay differs by 1e-4 from that of the
exact signals. The information of a gain differs by 0.6 % in the median and by at most 12 %.

What to use when: `windowed_statistics` for a first test of hundreds of signals; the exact signals
if this test is significant.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate import NuisanceProjector, ScoreStatistics
from gyrorig_solver.model import SignalState

MARGIN_S = 4.0  # before and after a window
MAX_WINDOWS = 512  # of a long recording; memory grows with the square of their number


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Windows in one or several recordings, each of which has its own time."""

    spans_s: FloatArray  # (k, 2), start and end
    recording: IntArray  # (k,), its index

    @classmethod
    def of_moves(cls, states: Sequence[SignalState]) -> Self:
        """Return one window per move of each recording, or per group of moves if they are many."""
        contexts = {state.context.recording_index: state.context for state in states}
        spans, indices = [np.zeros((0, 2))], [np.zeros(0, np.int64)]
        for index, context in contexts.items():
            moves_s = [(float(p.start_s[0]), float(p.end_s)) for _, p in context.motion_profiles]
            if moves_s:
                spans.append(group_windows(np.array(moves_s), MAX_WINDOWS // len(contexts)))
                indices.append(np.full(len(spans[-1]), index))
        return cls(np.concatenate(spans), np.concatenate(indices))

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.spans_s)

    def __getitem__(self, chosen: slice | IntArray) -> Self:
        """Return some of the windows."""
        return type(self)(self.spans_s[chosen], self.recording[chosen])

    def in_recording_of(self, state: SignalState) -> IntArray:
        """Return the indices of the windows of a state's recording."""
        return np.flatnonzero(self.recording == state.context.recording_index)

    def extended(self, duration_s: float) -> Self:
        """Return the windows with a later end."""
        return type(self)(self.spans_s + np.array([0.0, duration_s]), self.recording)


# Maps the windows of a row and a state to the sum of their signals, (1, blocks, 3).
WindowFunction = Callable[[Windows, SignalState], FloatArray]


def windowed_statistics(
    projection: NuisanceProjector, function: WindowFunction, windows: Windows
) -> ScoreStatistics:
    """Return the score statistics of one signal per window.

    Args:
        projection: the nuisance projector at a fit.
        function: returns the sum of the signals of some windows.
        windows: of the signals, k.
    """
    windows_s = windows.spans_s
    row_of_window = _assign_rows(windows_s)
    rows = [np.flatnonzero(row_of_window == row) for row in range(int(row_of_window.max()) + 1)]
    whitened = projection.evaluate_together(
        [partial(function, windows[members]) for members in rows], len(rows)
    )
    values, columns, counts = [], [], np.zeros(len(windows_s), dtype=np.int64)
    entries: list[list[tuple[FloatArray, IntArray]]] = [[] for _ in windows_s]
    for (state, first), channel in zip(_channel_states(projection), whitened.channels, strict=True):
        times_s = state.sample_times_s[:: state.instants_per_block]
        is_here = windows.recording == state.context.recording_index
        begin = np.searchsorted(times_s, windows_s[:, 0] - MARGIN_S)
        end = np.searchsorted(times_s, windows_s[:, 1] + MARGIN_S)
        for signal, row in zip(channel.signal_index, channel.rows, strict=True):
            for k in rows[signal][is_here[rows[signal]]]:
                part = slice(int(begin[k]), int(end[k]))
                entries[k].append((row[part], first + np.arange(part.start, part.stop)))
    for k, parts in enumerate(entries):
        counts[k] = sum(part.size for part, _ in parts)
        values += [part for part, _ in parts]
        columns += [index for _, index in parts]
    pointer = np.concatenate([[0], np.cumsum(counts)])
    shape = (len(windows_s), projection.residual.size)
    data = (
        np.concatenate(values or [np.zeros(0)], dtype=np.float64),
        np.concatenate(columns or [np.zeros(0, np.int64)]),
    )
    return projection.sparse_statistics(csr_array((*data, pointer), shape=shape))


def group_windows(windows_s: FloatArray, max_windows: int = MAX_WINDOWS) -> FloatArray:
    """Return one window per group of consecutive windows, (k, 2); all windows if they are few."""
    size = -(-len(windows_s) // max_windows)
    if size <= 1:
        return windows_s
    windows_s = windows_s[np.argsort(windows_s[:, 0], kind="stable")]
    first = np.arange(0, len(windows_s), size)
    return np.column_stack([windows_s[first, 0], np.maximum.reduceat(windows_s[:, 1], first)])


def _assign_rows(windows_s: FloatArray) -> IntArray:
    """Return a row for each window, so that the margins of a row do not overlap."""
    row_of_window = np.zeros(len(windows_s), dtype=np.int64)
    row_ends_s: list[float] = []
    for k in np.argsort(windows_s[:, 0], kind="stable"):
        begin_s, end_s = windows_s[k]
        free = [row for row, end in enumerate(row_ends_s) if end + 2.0 * MARGIN_S <= begin_s]
        row = free[0] if free else len(row_ends_s)
        row_ends_s[row:] = [float(end_s), *row_ends_s[row + 1 :]]
        row_of_window[k] = row
    return row_of_window


def _channel_states(projection: NuisanceProjector) -> Iterator[tuple[SignalState, int]]:
    """Yield the state of each channel, and the index of its first value in the residual."""
    first = 0
    for state in projection.states:
        for _ in range(3):
            yield state, first
            first += state.block_count
