"""A stretch of unexplained motion: a smoothing spline through one axis' polled counts.

Nothing is assumed of the motion but rests at both ends and a smoothness that the counts
themselves choose: acceleration is white noise, its intensity that under which the
stretch's counts are likeliest. Cubic B-splines, knots 20 to 50 ms apart. A count is
uniform over one step; its instant is unknown inside its exchange; counts of one and the
same step repeat each other's rounding and share their weight.

Source: Wahba, "Spline models for observational data", SIAM 1990, sections 1.3 and 4.8.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gyrorig_solver.arrays import FloatArray, IntArray

KNOT_S = (0.02, 0.05)  # shortest, longest distance of knots
POLLS_PER_KNOT = 2.0
PINNED = 3  # coefficients at each end that hold the rest: value, slope and curvature
QUIET_S = 0.25  # counts that stand still for this long are a rest
MARGIN_S = 0.06  # the axis may have moved this long before a count shows it
STEP_VARIANCE = 1.0 / 12.0
LEAST_SHARE = 0.05  # of an independent count, for one of many on the same step
# Intensity of the acceleration, steps^2/s^3: a step of 30/s in a second to 1e5/s in 0.1 s.
# Ramps begin and end at once: their corners are rougher than a stretch is on the average.
ROUGHER = 10.0
INTENSITIES = 10.0 ** np.arange(3.0, 11.1, 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One axis from one rest to the next, as counted."""

    axis: int
    begin_s: float  # of the spline's first interval
    knot_s: float
    intervals: int
    counts: tuple[int, int]  # at the rests before and after
    # Of (rest before, inner coefficients, rest after): lower band, shape (4, inner + 2).
    information: FloatArray
    pull: FloatArray  # information times their likeliest values, rests counted from `counts`

    @property
    def inner(self) -> int:
        """How many coefficients are not a rest's."""
        return self.intervals + 3 - 2 * PINNED

    @property
    def end_s(self) -> float:
        """Where the last interval ends."""
        return self.begin_s + self.intervals * self.knot_s

    def basis(self, time_s: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the four basis functions at times, and the number of the first of them.

        Args:
            time_s: inside the stretch, shape (n,).
        """
        return _basis((time_s - self.begin_s) / self.knot_s, self.intervals)

    def full(self, standing: tuple[float, float], inner: FloatArray) -> FloatArray:
        """Return all coefficients, given where the axis stands before and after, steps."""
        before = np.full(PINNED, self.counts[0] + standing[0])
        after = np.full(PINNED, self.counts[1] + standing[1])
        return np.concatenate([before, inner, after])

    def position_steps(self, time_s: FloatArray, full: FloatArray) -> FloatArray:
        """Return the spline of all coefficients at times, constant outside."""
        values, first = self.basis(np.clip(time_s, self.begin_s, self.end_s))
        return np.asarray(np.sum(values * full[first[:, None] + np.arange(4)], axis=1))


def find_spans(at_s: FloatArray, steps: FloatArray) -> list[tuple[float, float]]:
    """Return where an axis' counts say that it moved, in the order of time.

    Args:
        at_s: instants of its counts, shape (n,), increasing.
        steps: the counts.
    """
    changed = np.flatnonzero(np.diff(steps) != 0.0)
    if changed.size == 0:
        return []
    quiet_s = max(QUIET_S, 3.0 * float(np.median(np.diff(at_s))))
    begins, ends = at_s[changed], at_s[changed + 1]
    new = np.concatenate([[True], begins[1:] - ends[:-1] > quiet_s])
    first = np.flatnonzero(new)
    last = np.concatenate([first[1:] - 1, [changed.size - 1]])
    return [
        (float(begins[a]) - MARGIN_S, float(ends[b]) + MARGIN_S)
        for a, b in zip(first, last, strict=True)
    ]


def fit_stretch(
    axis: int,
    span_s: tuple[float, float],
    counts: tuple[int, int],
    at_s: FloatArray,
    steps: FloatArray,
    spread_s: FloatArray,
) -> Stretch:
    """Return the likeliest spline of one stretch.

    Args:
        axis: 0 pan, 1 tilt.
        span_s: begin and end, both at rest.
        counts: at the rests before and after.
        at_s: instants of the stretch's counts, shape (n,).
        steps: the counts.
        spread_s: standard deviation of each instant.
    """
    usual_s = float(np.median(np.diff(at_s))) if at_s.size > 1 else KNOT_S[1]
    knot_s = float(np.clip(POLLS_PER_KNOT * usual_s, *KNOT_S))
    intervals = max(2 * PINNED, int(np.ceil((span_s[1] - span_s[0]) / knot_s)))
    values, first = _basis((at_s - span_s[0]) / knot_s, intervals)
    speed = _speeds(at_s, steps)
    share = np.clip(np.abs(speed) * usual_s, LEAST_SHARE, 1.0)
    weight = share / (STEP_VARIANCE + (speed * spread_s) ** 2)
    fixed = np.zeros(intervals + 3)
    fixed[:PINNED], fixed[-PINNED:] = counts
    column = first[:, None] + np.arange(4)
    left = steps - np.sum(values * fixed[column], axis=1)
    gram, moment = _gram(values, _held(column, intervals), weight, left, intervals)
    bends = np.arange(intervals + 1)[:, None] + np.arange(3)
    bend = np.tile([1.0, -2.0, 1.0], (bends.shape[0], 1))
    straight = -np.diff(fixed, n=2)
    even = np.ones(bends.shape[0])
    rough, rough_pull = _gram(bend, _held(bends, intervals), even, straight, intervals)
    ends = np.zeros_like(gram)
    ends[0, [0, -1]] = 1.0 / STEP_VARIANCE
    square = float(weight @ left**2)
    best = (-np.inf, INTENSITIES[-1])
    for intensity in INTENSITIES:
        per = 1.0 / (intensity * knot_s**3)
        size = _size(per * rough + ends)
        factor = cholesky_banded(gram + per * rough + ends, lower=True, check_finite=False)
        pull = moment + per * rough_pull
        explained = float(pull @ cho_solve_banded((factor, True), pull, check_finite=False))
        worse = square + per * float(straight @ straight) - explained
        size -= 2.0 * float(np.sum(np.log(factor[0])))
        if size - worse > best[0]:
            best = (size - worse, intensity)
    _, intensity = best
    per = 1.0 / (ROUGHER * intensity * knot_s**3)
    total, pull = gram + per * rough, moment + per * rough_pull
    # A rest's own count belongs to both of its stretches; it is put in once, by who joins them.
    return Stretch(axis, span_s[0], knot_s, intervals, counts, total, pull)


def _held(column: IntArray, intervals: int) -> IntArray:
    """Return which unknown holds each coefficient: those at an end are all its rest's."""
    return np.clip(column - (PINNED - 1), 0, intervals + 4 - 2 * PINNED)


def _gram(
    values: FloatArray, column: IntArray, weight: FloatArray, left: FloatArray, intervals: int
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of rows that touch few neighbouring unknowns.

    Args:
        values: of each row, shape (n, k).
        column: which unknowns they belong to, shape (n, k).
        weight: of the rows, shape (n,).
        left: what the rows shall give, shape (n,).
        intervals: of the spline.

    Returns:
        The lower band of the matrix, shape (4, unknowns), and the right side.
    """
    size = intervals + 5 - 2 * PINNED
    band, moment = np.zeros((4, size)), np.zeros(size)
    weighed = values * weight[:, None]
    np.add.at(moment, column, weighed * left[:, None])
    for k in range(values.shape[1]):
        off = column - column[:, k, None]
        low = off >= 0
        product = weighed * values[:, k, None]
        at = np.broadcast_to(column[:, k, None], off.shape)
        np.add.at(band, (off[low], at[low]), product[low])
    return band, moment


def _size(band: FloatArray) -> float:
    """Return the logarithm of a positive banded matrix' determinant."""
    factor = cholesky_banded(band, lower=True, check_finite=False)
    return 2.0 * float(np.sum(np.log(factor[0])))


def _speeds(at_s: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the speed at each count, over about five of them."""
    n = at_s.size
    if n < 3:
        return np.zeros(n)
    low = np.clip(np.arange(n) - 2, 0, None)
    high = np.clip(np.arange(n) + 2, None, n - 1)
    return np.asarray((steps[high] - steps[low]) / np.maximum(at_s[high] - at_s[low], 1e-6))


def _basis(position: FloatArray, intervals: int) -> tuple[FloatArray, IntArray]:
    """Return uniform cubic B-splines at positions counted in knots."""
    first = np.clip(np.floor(position), 0, intervals - 1).astype(np.int64)
    u = position - first
    values = np.column_stack(
        [
            (1.0 - u) ** 3,
            3.0 * u**3 - 6.0 * u**2 + 4.0,
            -3.0 * u**3 + 3.0 * u**2 + 3.0 * u + 1.0,
            u**3,
        ]
    )
    return values / 6.0, first
