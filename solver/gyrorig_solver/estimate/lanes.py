"""Derivatives that are zero outside a stretch, many of them packed into few long signals.

A motion has thousands of unknowns that act for a moment each. Those far enough apart not
to feel each other through the noise's memory share a lane, a signal as long as the
series; what holds for a lane (filtering, weighing) is then done once for all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.reference.motion import LocalColumn


@dataclass(frozen=True, slots=True, eq=False)
class Lanes:
    """Columns of local unknowns, in order of lane and time."""

    values: FloatArray  # (lanes, 3, n), stage rate by each unknown over its scale
    scale: FloatArray  # (c,), so that no column's faint end drowns a weaker neighbour
    unknown: IntArray  # (c,), which unknown of the reference
    lane: IntArray  # (c,)
    first: IntArray  # (c,), where its own part of the lane begins
    stop: IntArray  # (c,), where that has ended

    @property
    def count(self) -> int:
        """How many columns there are."""
        return int(self.unknown.size)

    def coarser(self, values: FloatArray, per: int, reach: int) -> "Lanes":
        """Return the same columns on a grid of `per` intervals to one.

        Args:
            values: the lanes on that grid, shape (lanes, 3, n / per).
            per: intervals of this grid to one of that.
            reach: how many of that grid's intervals beyond its ends a column is felt.
        """
        n = values.shape[2]
        first = np.clip(self.first // per - reach, 0, n)
        stop = np.clip(-(-self.stop // per) + reach, 0, n)
        return Lanes(values, self.scale, self.unknown, self.lane, first, stop)


def pack(columns: Sequence[LocalColumn], length: int, gap: int) -> Lanes:
    """Return columns in as few lanes as leave `gap` intervals between two of one lane."""
    some = [c for c in columns if c.values.shape[0] and c.values.any()]
    some.sort(key=lambda column: column.first)
    ends: list[int] = []
    lane = []
    for column in some:
        fits = [k for k, end in enumerate(ends) if end + gap <= column.first]
        # The lane that has waited longest, so that neighbours keep their distance.
        own = min(fits, key=ends.__getitem__) if fits else len(ends)
        if own == len(ends):
            ends.append(0)
        ends[own] = column.first + column.values.shape[0]
        lane.append(own)
    scale = np.array([np.sqrt(np.sum(c.values**2)) for c in some])
    values = np.zeros((len(ends), 3, length))
    for column, own, size in zip(some, lane, scale, strict=True):
        stop = column.first + column.values.shape[0]
        values[own, :, column.first : stop] = column.values.T / size
    order = np.argsort(lane, kind="stable")
    some = [some[k] for k in order]
    first = np.array([c.first for c in some], dtype=np.int64)
    return Lanes(
        values,
        scale[order],
        np.array([c.unknown for c in some], dtype=np.int64),
        np.array(lane, dtype=np.int64)[order],
        first,
        first + np.array([c.values.shape[0] for c in some], dtype=np.int64),
    )


def products(lanes: Lanes, whitened: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the inner products of every two columns whose parts of their lanes meet.

    Each column is its own part of its whitened lane and zero elsewhere, so that whatever
    is cut off the matrix of products stays one of inner products: positive semidefinite.

    Args:
        lanes: the columns.
        whitened: the lanes' sensor signals, whitened, (3, lanes, n).

    Returns:
        Unknown, unknown and product, both orders of every pair; far pairs left out.
    """
    rows, columns, values = [], [], []
    own = [np.flatnonzero(lanes.lane == a) for a in range(lanes.values.shape[0])]
    for a, mine in enumerate(own):
        for b in range(a, len(own)):
            theirs = own[b]
            low = np.searchsorted(lanes.stop[mine], lanes.first[theirs], side="right")
            high = np.searchsorted(lanes.first[mine], lanes.stop[theirs], side="left")
            if a == b:
                low, high = np.arange(mine.size), np.arange(mine.size) + 1
            count = np.maximum(high - low, 0)
            if not count.any():
                continue
            other = np.repeat(np.arange(theirs.size), count)
            owner = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
            k, o = mine[owner + np.repeat(low, count)], theirs[other]
            total = np.zeros(whitened.shape[2] + 1)
            np.cumsum(np.einsum("in,in->n", whitened[:, a], whitened[:, b]), out=total[1:])
            begin = np.maximum(lanes.first[k], lanes.first[o])
            end = np.minimum(lanes.stop[k], lanes.stop[o])
            value = (total[end] - total[begin]) * lanes.scale[k] * lanes.scale[o]
            k, o = lanes.unknown[k], lanes.unknown[o]
            rows += [k] if a == b else [k, o]
            columns += [o] if a == b else [o, k]
            values += [value] if a == b else [value, value]
    if not rows:
        none = np.zeros(0, dtype=np.int64)
        return none, none, np.zeros(0)
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
