"""The lower envelope of arrival delay over device time: the latency floor is the clock.

Delay = floor + something that is never negative (queueing, stalls), so a line pressed
from below against the points follows the clock and no mean does (time synchronisation
notes, sections 2 and 3: after 75 s with stalls a least-squares line wanders by 222 us,
the envelope by 0.2 us).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, lil_matrix

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray

_FAR_S = 1e5  # how far an envelope is continued
_BLOCK = 32  # points looked at together when a hull is thinned
_KEPT = 1 << 14  # points, at most, of an envelope that is not made twice
_PIECE = 1 << 16  # points whose hull is found at a time: they stay in the processor's cache


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """A continuous piecewise linear function, at or below every point it was made from."""

    knot_s: FloatArray  # (k,), device time
    delay_s: FloatArray  # (k,)

    def at(self, device_s: FloatArray) -> FloatArray:
        """Return the envelope's delay at device times, continued straight at both ends."""
        knot_s, delay_s = self.knot_s, self.delay_s
        if knot_s.size > 1:
            slope = np.diff(delay_s) / np.diff(knot_s)
            far_s = _FAR_S + float(knot_s[-1] - knot_s[0])
            knot_s = np.concatenate([[knot_s[0] - far_s], knot_s, [knot_s[-1] + far_s]])
            ends = delay_s[0] - slope[0] * far_s, delay_s[-1] + slope[-1] * far_s
            delay_s = np.concatenate([[ends[0]], delay_s, [ends[1]]])
        return np.asarray(np.interp(device_s, knot_s, delay_s), dtype=np.float64)


def lower_hull(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the indices of the lower convex hull's corners, from left to right.

    Args:
        x: not decreasing, shape (n,).
        y: shape (n,).

    Andrew's monotone chain, over the corners of pieces' own hulls, since a corner of all is
    one of its piece; in a piece, points far above their neighbours are dropped first. Both
    leave the hull as it is, and make it linear in practice, in time and in memory.
    """
    if x.size <= _PIECE:
        return _chain(x, y, _near_the_hull(x, y))
    corners = []
    for start in range(0, x.size, _PIECE):
        rows = slice(start, start + _PIECE)
        corners.append(start + _chain(x[rows], y[rows], _near_the_hull(x[rows], y[rows])))
    return _chain(x, y, np.concatenate(corners))


def _near_the_hull(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the points that remain when dropping some more does not pay."""
    index = np.arange(x.size)
    while index.size > 4 * _BLOCK:
        kept = _thinned(x, y) if index.size == x.size else index[_thinned(x[index], y[index])]
        if kept.size > 0.7 * index.size:
            break
        index = kept
    return index


def _chain(x: FloatArray, y: FloatArray, index: IntArray) -> IntArray:
    xs, ys = x[index].tolist(), y[index].tolist()
    chain: list[int] = []
    for i in range(len(xs)):
        if chain and xs[chain[-1]] == xs[i]:
            if ys[chain[-1]] <= ys[i]:
                continue
            chain.pop()
        while len(chain) > 1:
            a, b = chain[-2], chain[-1]
            if (xs[b] - xs[a]) * (ys[i] - ys[a]) - (ys[b] - ys[a]) * (xs[i] - xs[a]) > 0.0:
                break
            chain.pop()
        chain.append(i)
    return np.asarray(index[chain], dtype=np.int64)


def _thinned(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the points that may be corners of the lower hull.

    A corner is never above the chords from its block's lowest point to the block's two
    ends, so whatever lies above them is dropped and no corner is lost.
    """
    whole = x.size // _BLOCK * _BLOCK
    kept = np.flatnonzero(_below_chords(x[:whole], y[:whole]))
    return np.concatenate([kept, np.arange(whole, x.size)])


def _below_chords(x: FloatArray, y: FloatArray) -> BoolArray:
    at, delay = x.reshape(-1, _BLOCK), y.reshape(-1, _BLOCK)
    row = np.arange(at.shape[0])
    low = delay.argmin(axis=1)
    at_low, least = at[row, low][:, None], delay[row, low][:, None]
    left = np.arange(_BLOCK)[None, :] <= low[:, None]
    end = np.where(left, at[:, :1], at[:, -1:]) - at_low
    rise = np.where(left, delay[:, :1], delay[:, -1:]) - least
    with np.errstate(divide="ignore", invalid="ignore"):
        chord = np.where(end != 0.0, (at - at_low) / end * rise, 0.0)
    # On the chord to rounding is below it: dropping too few costs time only.
    below = delay - least <= chord + 1e-15
    below[row, low] = True
    below[:, [0, -1]] = True
    return np.asarray(below.ravel(), dtype=np.bool_)


def hull_line(x: FloatArray, y: FloatArray) -> Envelope:
    """Return the line under all points with the least sum of distances to them.

    It is the hull's segment above the points' centroid (Zhang, Liu and Xia, INFOCOM
    2002); for recordings of up to two minutes.
    """
    corners = lower_hull(x, y)
    if corners.size < 2:
        return Envelope(x[:1].copy(), y[:1].copy())
    at = int(np.clip(np.searchsorted(x[corners], float(np.mean(x))), 1, corners.size - 1))
    a, b = corners[at - 1], corners[at]
    slope = (y[b] - y[a]) / (x[b] - x[a])
    ends = np.array([x[0], x[-1]])
    return Envelope(ends, y[a] + slope * (ends - x[a]))


def piecewise_envelope(
    x: FloatArray, y: FloatArray, knot_spacing_s: float, stiffness: float
) -> Envelope:
    """Return the piecewise linear lower envelope, by linear programming.

    Minimises the sum of distances of the points to the envelope plus `stiffness` times
    the sum of its absolute slope changes. Only the corners of each interval's own hull
    can touch a line, so they are the only constraints; the sum of distances needs only
    each interval's sums: the programme's size depends on the knots, not on the samples.

    Args:
        x: device time, not decreasing, shape (n,).
        y: arrival delay, shape (n,).
        knot_spacing_s: distance of the knots.
        stiffness: s per unit slope change, times the number of points; see `stiffness`.
    """
    if x.size > _KEPT:
        return _programmed(x, y, knot_spacing_s, stiffness)
    # Whoever explains a recording asks for its samples, and so for their clock, twice.
    return _kept(x.tobytes(), y.tobytes(), knot_spacing_s, stiffness)


def forget_envelopes() -> None:
    """Forget what was made before; a benchmark does, to measure a recording as a new one."""
    _kept.cache_clear()


@lru_cache(maxsize=32)
def _kept(x: bytes, y: bytes, knot_spacing_s: float, stiffness: float) -> Envelope:
    return _programmed(np.frombuffer(x), np.frombuffer(y), knot_spacing_s, stiffness)


def _programmed(x: FloatArray, y: FloatArray, knot_spacing_s: float, stiffness: float) -> Envelope:
    count = max(1, round((x[-1] - x[0]) / knot_spacing_s))
    knots = np.linspace(x[0], x[-1], count + 1)
    width = np.diff(knots)
    edges = np.searchsorted(x, knots)
    edges[0], edges[-1] = 0, x.size
    rows, cell, pull = _constraints(x, y, knots, edges)
    fraction = (x[rows] - knots[cell]) / width[cell]
    bends = count - 1
    # Unknowns: the knots' delays, then the positive and negative part of each bend.
    under: Any = csr_matrix(
        (
            np.concatenate([1.0 - fraction, fraction]),
            (np.tile(np.arange(rows.size), 2), np.concatenate([cell, cell + 1])),
        ),
        shape=(rows.size, count + 1 + 2 * bends),
    )
    bending: Any = lil_matrix((max(bends, 0), count + 1 + 2 * bends))
    for k in range(bends):
        bending[k, k] = 1.0 / width[k]
        bending[k, k + 1] = -1.0 / width[k] - 1.0 / width[k + 1]
        bending[k, k + 2] = 1.0 / width[k + 1]
        bending[k, count + 1 + k] = -1.0
        bending[k, count + 1 + bends + k] = 1.0
    low = float(np.min(y))
    result: Any = linprog(
        np.concatenate([-pull, np.full(2 * bends, stiffness)]),
        A_ub=under,
        b_ub=(y[rows] - low) * 1e6,
        A_eq=bending.tocsr() if bends else None,
        b_eq=np.zeros(bends) if bends else None,
        bounds=[(None, None)] * (count + 1) + [(0.0, None)] * (2 * bends),
        method="highs",
    )
    if not result.success:
        return hull_line(x, y)
    return Envelope(knots, low + result.x[: count + 1] * 1e-6)


def _constraints(
    x: FloatArray, y: FloatArray, knots: FloatArray, edges: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the hull corners of every cell, their cells, and how points pull at the knots."""
    pull = np.zeros(knots.size)
    rows: list[IntArray] = []
    cells: list[IntArray] = []
    for k in range(knots.size - 1):
        a, b = int(edges[k]), int(edges[k + 1])
        if a == b:
            continue
        part = x[a:b]
        right = float(np.sum(part - knots[k]) / (knots[k + 1] - knots[k]))
        pull[k] += (b - a) - right
        pull[k + 1] += right
        corners = a + lower_hull(part, y[a:b])
        rows.append(corners)
        cells.append(np.full(corners.size, k, dtype=np.int64))
    return np.concatenate(rows), np.concatenate(cells), pull
