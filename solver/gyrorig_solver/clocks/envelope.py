"""The lower envelope of arrival delay over device time: the latency floor is the clock.

Delay = floor + something that is never negative (queueing, stalls), so a line pressed
from below against the points follows the clock and no mean does (time synchronisation
notes, sections 2 and 3: after 75 s with stalls a least-squares line wanders by 222 us,
the envelope by 0.2 us).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, lil_matrix

from gyrorig_solver.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Envelope:
    """A continuous piecewise linear function, at or below every point it was made from."""

    knot_s: FloatArray  # (k,), device time
    delay_s: FloatArray  # (k,)

    def at(self, device_s: FloatArray) -> FloatArray:
        """Return the envelope's delay at device times, continued straight at both ends."""
        inner = np.interp(device_s, self.knot_s, self.delay_s)
        if self.knot_s.size < 2:
            return np.asarray(inner, dtype=np.float64)
        slope = np.diff(self.delay_s) / np.diff(self.knot_s)
        below, above = device_s < self.knot_s[0], device_s > self.knot_s[-1]
        inner = np.where(below, self.delay_s[0] + slope[0] * (device_s - self.knot_s[0]), inner)
        return np.where(above, self.delay_s[-1] + slope[-1] * (device_s - self.knot_s[-1]), inner)


def lower_hull(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the indices of the lower convex hull's corners, from left to right.

    Args:
        x: not decreasing, shape (n,).
        y: shape (n,).

    Andrew's monotone chain; points far above their neighbours are dropped first, block
    by block, which leaves the hull as it is and makes it linear in practice.
    """
    index = _hull_candidates(x, y) if x.size > 512 else np.arange(x.size)
    corners: list[int] = []
    for i in index:
        if corners and x[corners[-1]] == x[i]:
            if y[corners[-1]] <= y[i]:
                continue
            corners.pop()
        while len(corners) > 1:
            a, b = corners[-2], corners[-1]
            cross = (x[b] - x[a]) * (y[i] - y[a]) - (y[b] - y[a]) * (x[i] - x[a])
            if cross > 0.0:
                break
            corners.pop()
        corners.append(int(i))
    return np.array(corners, dtype=np.int64)


def _hull_candidates(x: FloatArray, y: FloatArray) -> IntArray:
    """Return the points that may be corners of the lower hull, block by block.

    A corner is never above the chords from its block's lowest point to the block's two
    ends, so whatever lies above them is dropped and no corner is lost.
    """
    keep = np.zeros(y.size, dtype=np.bool_)
    for start in range(0, y.size, 64):
        at, block = x[start : start + 64], y[start : start + 64]
        low = int(np.argmin(block))
        ends = [0, low, block.size - 1]
        keep[start : start + 64] = block <= np.interp(at, at[ends], block[ends]) + 1e-15
    return np.flatnonzero(keep).astype(np.int64)


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
    count = max(1, round((x[-1] - x[0]) / knot_spacing_s))
    knots = np.linspace(x[0], x[-1], count + 1)
    cell = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, count - 1)
    width = np.diff(knots)
    fraction = (x - knots[cell]) / width[cell]
    pull = np.bincount(cell, 1.0 - fraction, count + 1)
    pull += np.concatenate([[0.0], np.bincount(cell, fraction, count)])
    rows = np.concatenate(
        [
            inside[lower_hull(x[inside], y[inside])]
            for inside in np.split(np.arange(x.size), np.searchsorted(cell, np.arange(1, count)))
            if inside.size
        ]
    )
    bends = count - 1
    # Unknowns: the knots' delays, then the positive and negative part of each bend.
    under: Any = csr_matrix(
        (
            np.concatenate([1.0 - fraction[rows], fraction[rows]]),
            (np.tile(np.arange(rows.size), 2), np.concatenate([cell[rows], cell[rows] + 1])),
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
