"""Whitened signals by channel: only rows that are not zero.

A channel is one sensor axis of one part of a series. Many causes act on one axis only, so that most
of their rows would be zero. Rows of hundreds of signals have single precision: an error of 1e-7 of
a signal is far below its noise. Their products have double precision.

What to use when: `SeriesSegment.whiten` for the rows, `WhitenedSignals` for the rows of all
channels; `join_signals` for more signals, `join_channels` for more channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray, RealArray


@dataclass(frozen=True, slots=True, eq=False)
class ChannelRows:
    """The signals that act on one channel.

    Joined signals stay in the blocks of their groups, because a copy of hundreds of rows takes tens
    of megabytes.
    """

    signal_index: IntArray  # (r,), which of the signals, ascending
    blocks: tuple[RealArray, ...]  # rows of each group, (r, n) together

    @property
    def length(self) -> int:
        """The number of values of a row."""
        return int(self.blocks[0].shape[1])

    @property
    def rows(self) -> RealArray:
        """All rows, (r, n); several blocks are copied."""
        return self.blocks[0] if len(self.blocks) == 1 else np.concatenate(self.blocks)

    def values(self, columns: slice) -> FloatArray:
        """Return a part of all rows with double precision, (r, columns)."""
        parts = [np.asarray(block[:, columns], dtype=np.float64) for block in self.blocks]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


@dataclass(frozen=True, slots=True, eq=False)
class WhitenedSignals:
    """Signals in units of the noise."""

    count: int
    channels: tuple[ChannelRows, ...]

    @classmethod
    def of_dense(cls, signals: FloatArray, lengths: Sequence[int]) -> Self:
        """Return signals (k, all) unchanged, with zeros; `lengths`: of each channel."""
        every = np.arange(len(signals))
        parts = np.split(signals, np.cumsum(lengths)[:-1], axis=1)
        return cls(len(signals), tuple(ChannelRows(every, (part,)) for part in parts))

    @property
    def size(self) -> int:
        """The number of stored values."""
        return sum(channel.signal_index.size * channel.length for channel in self.channels)

    def dense(self) -> FloatArray:
        """Return all values, with the channels in sequence, (k, all)."""
        signals = np.zeros((self.count, sum(channel.length for channel in self.channels)))
        first = 0
        for channel in self.channels:
            stop = first + channel.length
            signals[channel.signal_index, first:stop] = channel.rows
            first = stop
        return signals


def join_signals(groups: Sequence[WhitenedSignals]) -> WhitenedSignals:
    """Return several groups of signals of the same channels, in sequence."""
    if len(groups) == 1:
        return groups[0]
    first = np.cumsum([0, *(group.count for group in groups)])
    channels = []
    for channel_groups in zip(*(group.channels for group in groups), strict=True):
        index = [part.signal_index + at for part, at in zip(channel_groups, first, strict=False)]
        blocks = tuple(block for part in channel_groups for block in part.blocks)
        channels.append(ChannelRows(np.concatenate(index), blocks))
    return WhitenedSignals(int(first[-1]), tuple(channels))


def join_channels(boards: Sequence[WhitenedSignals]) -> WhitenedSignals:
    """Return the same signals on the channels of several boards."""
    channels = tuple(channel for board in boards for channel in board.channels)
    return WhitenedSignals(boards[0].count, channels)
