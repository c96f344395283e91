"""The lower envelope of arrival delays over device time.

A delay is the minimum latency plus queueing and stalls, which are never negative. Therefore the
lower envelope follows the clock, and a mean does not: in simulations of 75 s with stalls a
least-squares line wanders by 222 us, the envelope by 0.2 us.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, lil_matrix

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray

_EXTRAPOLATION_S = 1e5  # extrapolation of an envelope
_BLOCK_POINTS = 32  # points per block of the prefilter of a hull
_MAX_CACHED_POINTS = 1 << 14  # points of an envelope that is cached
_PIECE_POINTS = 1 << 16  # points per piece of a hull, which stay in the processor cache


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """A continuous piecewise linear function, at or below all points."""

    knot_s: FloatArray  # (k,), device time
    delay_s: FloatArray  # (k,)

    def delay_at(self, device_s: FloatArray) -> FloatArray:
        """Return the delay of the envelope at device times, extrapolated linearly."""
        knot_s, delay_s = self.knot_s, self.delay_s
        if knot_s.size > 1:
            slope = np.diff(delay_s) / np.diff(knot_s)
            far_s = _EXTRAPOLATION_S + float(knot_s[-1] - knot_s[0])
            knot_s = np.concatenate([[knot_s[0] - far_s], knot_s, [knot_s[-1] + far_s]])
            ends = delay_s[0] - slope[0] * far_s, delay_s[-1] + slope[-1] * far_s
            delay_s = np.concatenate([[ends[0]], delay_s, [ends[1]]])
        return np.asarray(np.interp(device_s, knot_s, delay_s), dtype=np.float64)


def lower_hull(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the indices of the corners of the lower convex hull, from left to right.

    Args:
        x: not decreasing, shape (n,).
        y: shape (n,).

    Andrew's monotone chain over the corners of the hulls of pieces, because a corner of the hull
    is a corner of its piece. In a piece, points far above their neighbours are dropped first.
    Neither changes the hull; time and memory are linear in practice.
    """
    if x.size <= _PIECE_POINTS:
        return _monotone_chain(x, y, _prefilter_points(x, y))
    corners = []
    for start in range(0, x.size, _PIECE_POINTS):
        rows = slice(start, start + _PIECE_POINTS)
        corners.append(
            start + _monotone_chain(x[rows], y[rows], _prefilter_points(x[rows], y[rows]))
        )
    return _monotone_chain(x, y, np.concatenate(corners))


def _prefilter_points(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the points that remain after repeated removal of interior points."""
    index = np.arange(x.size)
    while index.size > 4 * _BLOCK_POINTS:
        remaining = (
            _hull_candidates(x, y)
            if index.size == x.size
            else index[_hull_candidates(x[index], y[index])]
        )
        if remaining.size > 0.7 * index.size:
            break
        index = remaining
    return index


def _monotone_chain(x: FloatArray, y: FloatArray, index: IntArray) -> IntArray:
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


def _hull_candidates(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the candidates for corners of the lower hull.

    A corner is never above the chords from the lowest point of its block to both ends of the
    block. Therefore points above these chords are dropped.
    """
    block_end = x.size // _BLOCK_POINTS * _BLOCK_POINTS
    candidates = np.flatnonzero(_below_chords(x[:block_end], y[:block_end]))
    return np.concatenate([candidates, np.arange(block_end, x.size)])


def _below_chords(x: FloatArray, y: FloatArray) -> BoolArray:
    block_x, block_y = x.reshape(-1, _BLOCK_POINTS), y.reshape(-1, _BLOCK_POINTS)
    row = np.arange(block_x.shape[0])
    lowest = block_y.argmin(axis=1)
    lowest_x, lowest_y = block_x[row, lowest][:, None], block_y[row, lowest][:, None]
    is_left_of_lowest = np.arange(_BLOCK_POINTS)[None, :] <= lowest[:, None]
    end_offset = np.where(is_left_of_lowest, block_x[:, :1], block_x[:, -1:]) - lowest_x
    rise = np.where(is_left_of_lowest, block_y[:, :1], block_y[:, -1:]) - lowest_y
    with np.errstate(divide="ignore", invalid="ignore"):
        chord = np.where(end_offset != 0.0, (block_x - lowest_x) / end_offset * rise, 0.0)
    # Points on the chord up to rounding are kept, which costs time only.
    is_below = block_y - lowest_y <= chord + 1e-15
    is_below[row, lowest] = True
    is_below[:, [0, -1]] = True
    return np.asarray(is_below.ravel(), dtype=np.bool_)


def hull_line(x: FloatArray, y: FloatArray) -> Envelope:
    """Return the line below all points with the smallest sum of distances to them.

    It is the segment of the hull above the centroid of the points (Zhang, Liu and Xia, INFOCOM
    2002). Use it for recordings of up to two minutes.
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

    The linear program minimises the sum of distances of the points to the envelope plus
    `stiffness` times the sum of its absolute slope changes. Only the corners of each interval's
    hull can touch a line, therefore they are the only constraints. The sum of distances needs
    only the sums per interval. The size of the linear program depends on the knots, not on the
    samples.

    Args:
        x: device time, not decreasing, shape (n,).
        y: arrival delay, shape (n,).
        knot_spacing_s: distance of the knots.
        stiffness: s per unit slope change, times the number of points.
    """
    if x.size > _MAX_CACHED_POINTS:
        return _solve_linear_program(x, y, knot_spacing_s, stiffness)
    # `gyrorig explain` loads the samples of a recording twice.
    return _cached_envelope(x.tobytes(), y.tobytes(), knot_spacing_s, stiffness)


@lru_cache(maxsize=32)
def _cached_envelope(x: bytes, y: bytes, knot_spacing_s: float, stiffness: float) -> Envelope:
    return _solve_linear_program(np.frombuffer(x), np.frombuffer(y), knot_spacing_s, stiffness)


def _solve_linear_program(
    x: FloatArray, y: FloatArray, knot_spacing_s: float, stiffness: float
) -> Envelope:
    count = max(1, round((x[-1] - x[0]) / knot_spacing_s))
    knots = np.linspace(x[0], x[-1], count + 1)
    width = np.diff(knots)
    edges = np.searchsorted(x, knots)
    edges[0], edges[-1] = 0, x.size
    rows, intervals, knot_weights = _constraints(x, y, knots, edges)
    fraction = (x[rows] - knots[intervals]) / width[intervals]
    bends = count - 1
    # Unknowns: the delays at the knots, then the positive and negative part of each slope change.
    upper_bounds: Any = csr_matrix(
        (
            np.concatenate([1.0 - fraction, fraction]),
            (np.tile(np.arange(rows.size), 2), np.concatenate([intervals, intervals + 1])),
        ),
        shape=(rows.size, count + 1 + 2 * bends),
    )
    bend_equations: Any = lil_matrix((max(bends, 0), count + 1 + 2 * bends))
    for k in range(bends):
        bend_equations[k, k] = 1.0 / width[k]
        bend_equations[k, k + 1] = -1.0 / width[k] - 1.0 / width[k + 1]
        bend_equations[k, k + 2] = 1.0 / width[k + 1]
        bend_equations[k, count + 1 + k] = -1.0
        bend_equations[k, count + 1 + bends + k] = 1.0
    lowest_y = float(np.min(y))
    result: Any = linprog(
        np.concatenate([-knot_weights, np.full(2 * bends, stiffness)]),
        A_ub=upper_bounds,
        b_ub=(y[rows] - lowest_y) * 1e6,
        A_eq=bend_equations.tocsr() if bends else None,
        b_eq=np.zeros(bends) if bends else None,
        bounds=[(None, None)] * (count + 1) + [(0.0, None)] * (2 * bends),
        method="highs",
    )
    if not result.success:
        return hull_line(x, y)
    return Envelope(knots, lowest_y + result.x[: count + 1] * 1e-6)


def _constraints(
    x: FloatArray, y: FloatArray, knots: FloatArray, edges: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the hull corners, their intervals, and the weights of the knots."""
    knot_weights = np.zeros(knots.size)
    rows: list[IntArray] = []
    intervals: list[IntArray] = []
    for k in range(knots.size - 1):
        a, b = int(edges[k]), int(edges[k + 1])
        if a == b:
            continue
        part = x[a:b]
        right_weight = float(np.sum(part - knots[k]) / (knots[k + 1] - knots[k]))
        knot_weights[k] += (b - a) - right_weight
        knot_weights[k + 1] += right_weight
        corners = a + lower_hull(part, y[a:b])
        rows.append(corners)
        intervals.append(np.full(corners.size, k, dtype=np.int64))
    return np.concatenate(rows), np.concatenate(intervals), knot_weights
