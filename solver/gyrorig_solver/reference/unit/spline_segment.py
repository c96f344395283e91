"""Smoothing spline through the polled counts of one axis, from rest to rest.

The model assumes rests at both ends and white-noise acceleration; its intensity maximises the
likelihood of the counts. The spline has cubic B-splines with knots 20 to 50 ms apart. A count is
uniform over one step, its time is unknown inside its exchange, and counts of the same step share
one weight, because they have the same rounding error.

Source: Wahba, "Spline models for observational data", SIAM 1990, sections 1.3 and 4.8.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gyrorig_solver.data import FloatArray, IntArray

KNOT_SPACING_RANGE_S = (0.02, 0.05)  # shortest, longest distance of knots
POLLS_PER_KNOT = 2.0
REST_COEFFICIENTS = 3  # coefficients at each end that fix value, slope and curvature of the rest
MIN_REST_S = 0.25  # a constant count for this time is a rest
MOTION_MARGIN_S = 0.06  # the axis can move this long before the count changes
STEP_VARIANCE = 1.0 / 12.0
MIN_COUNT_SHARE = 0.05  # weight of one of many counts on the same step
# Intensity of the acceleration, steps^2/s^3: a step of 30/s in a second to 1e5/s in 0.1 s.
# The corners of ramps are rougher than the average of a segment.
INTENSITY_FACTOR = 10.0
INTENSITY_CANDIDATES = 10.0 ** np.arange(3.0, 11.1, 0.5)


@dataclass(frozen=True, slots=True, eq=False)
class SplineSegment:
    """One axis from one rest to the next, from its counts."""

    axis: int
    begin_s: float  # of the first interval of the spline
    knot_spacing_s: float
    intervals: int
    counts: tuple[int, int]  # at the rests before and after
    # Of (rest before, inner coefficients, rest after): lower band, shape (4, inner + 2).
    information: FloatArray
    information_vector: (
        FloatArray  # information times the likeliest values, rests relative to `counts`
    )

    @property
    def inner_count(self) -> int:
        """Number of coefficients other than those of the rests."""
        return self.intervals + 3 - 2 * REST_COEFFICIENTS

    @property
    def end_s(self) -> float:
        """End of the last interval."""
        return self.begin_s + self.intervals * self.knot_spacing_s

    def basis(self, time_s: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the four non-zero basis functions at times, and the index of the first.

        Args:
            time_s: inside the segment, shape (n,).
        """
        return _basis((time_s - self.begin_s) / self.knot_spacing_s, self.intervals)

    def all_coefficients(self, rest_offsets: tuple[float, float], inner: FloatArray) -> FloatArray:
        """Return all coefficients, from the rest offsets before and after, steps."""
        before = np.full(REST_COEFFICIENTS, self.counts[0] + rest_offsets[0])
        after = np.full(REST_COEFFICIENTS, self.counts[1] + rest_offsets[1])
        return np.concatenate([before, inner, after])

    def position_steps(self, time_s: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return the spline at times, constant outside the segment."""
        values, first = self.basis(np.clip(time_s, self.begin_s, self.end_s))
        return np.asarray(np.sum(values * coefficients[first[:, None] + np.arange(4)], axis=1))


def find_moving_spans(at_s: FloatArray, steps: FloatArray) -> list[tuple[float, float]]:
    """Return the time spans in which the counts of an axis change.

    Args:
        at_s: instants of its counts, shape (n,), increasing.
        steps: the counts.
    """
    changed = np.flatnonzero(np.diff(steps) != 0.0)
    if changed.size == 0:
        return []
    min_rest_s = max(MIN_REST_S, 3.0 * float(np.median(np.diff(at_s))))
    begins, ends = at_s[changed], at_s[changed + 1]
    is_new = np.concatenate([[True], begins[1:] - ends[:-1] > min_rest_s])
    first = np.flatnonzero(is_new)
    last = np.concatenate([first[1:] - 1, [changed.size - 1]])
    return [
        (float(begins[a]) - MOTION_MARGIN_S, float(ends[b]) + MOTION_MARGIN_S)
        for a, b in zip(first, last, strict=True)
    ]


def fit_segment(
    axis: int,
    span_s: tuple[float, float],
    counts: tuple[int, int],
    at_s: FloatArray,
    steps: FloatArray,
    spread_s: FloatArray,
) -> SplineSegment:
    """Return the likeliest spline of one segment.

    Args:
        axis: 0 pan, 1 tilt.
        span_s: beginning and end, both at rest.
        counts: at the rests before and after.
        at_s: sampling times of the counts, shape (n,).
        steps: the counts.
        spread_s: standard deviation of each sampling time.
    """
    poll_spacing_s = _poll_spacing_s(at_s)
    knot_spacing_s = _knot_spacing_s(at_s)
    intervals = interval_count(span_s, at_s)
    values, first = _basis((at_s - span_s[0]) / knot_spacing_s, intervals)
    speed = _speeds(at_s, steps)
    share = np.clip(np.abs(speed) * poll_spacing_s, MIN_COUNT_SHARE, 1.0)
    weight = share / (STEP_VARIANCE + (speed * spread_s) ** 2)
    fixed = np.zeros(intervals + 3)
    fixed[:REST_COEFFICIENTS], fixed[-REST_COEFFICIENTS:] = counts
    column = first[:, None] + np.arange(4)
    residual = steps - np.sum(values * fixed[column], axis=1)
    normal_matrix, normal_vector = _normal_equations(
        values, _unknown_of(column, intervals), weight, residual, intervals
    )
    bends = np.arange(intervals + 1)[:, None] + np.arange(3)
    bend = np.tile([1.0, -2.0, 1.0], (bends.shape[0], 1))
    bend_residual = -np.diff(fixed, n=2)
    unit_weights = np.ones(bends.shape[0])
    roughness, roughness_vector = _normal_equations(
        bend, _unknown_of(bends, intervals), unit_weights, bend_residual, intervals
    )
    ends = np.zeros_like(normal_matrix)
    ends[0, [0, -1]] = 1.0 / STEP_VARIANCE
    weighted_square = float(weight @ residual**2)
    best = (-np.inf, INTENSITY_CANDIDATES[-1])
    for intensity in INTENSITY_CANDIDATES:
        roughness_weight = 1.0 / (intensity * knot_spacing_s**3)
        log_evidence = _log_determinant(roughness_weight * roughness + ends)
        factor = cholesky_banded(
            normal_matrix + roughness_weight * roughness + ends, lower=True, check_finite=False
        )
        information_vector = normal_vector + roughness_weight * roughness_vector
        explained = float(
            information_vector
            @ cho_solve_banded((factor, True), information_vector, check_finite=False)
        )
        misfit = (
            weighted_square + roughness_weight * float(bend_residual @ bend_residual) - explained
        )
        log_evidence -= 2.0 * float(np.sum(np.log(factor[0])))
        if log_evidence - misfit > best[0]:
            best = (log_evidence - misfit, intensity)
    _, intensity = best
    roughness_weight = 1.0 / (INTENSITY_FACTOR * intensity * knot_spacing_s**3)
    total = normal_matrix + roughness_weight * roughness
    information_vector = normal_vector + roughness_weight * roughness_vector
    # The count of a rest belongs to two segments; the caller adds it once.
    return SplineSegment(
        axis, span_s[0], knot_spacing_s, intervals, counts, total, information_vector
    )


def unknown_segment(
    axis: int, span_s: tuple[float, float], counts: tuple[int, int]
) -> SplineSegment:
    """Return a spline with the fewest unknowns, of a motion that the counts do not show.

    Its unknowns have a prior about a straight line, and no relation to those of the rests.

    Args:
        axis: 0 pan, 1 tilt.
        span_s: beginning and end, both at rest.
        counts: at the rests before and after.
    """
    intervals = 2 * REST_COEFFICIENTS
    inner_count = intervals + 3 - 2 * REST_COEFFICIENTS
    information = np.zeros((4, inner_count + 2))
    information[0, 1:-1] = 1.0 / STEP_VARIANCE
    information_vector = information[0] * np.linspace(*counts, inner_count + 2)
    knot_spacing_s = (span_s[1] - span_s[0]) / intervals
    return SplineSegment(
        axis, span_s[0], knot_spacing_s, intervals, counts, information, information_vector
    )


def interval_count(span_s: tuple[float, float], at_s: FloatArray) -> int:
    """Return the number of intervals that `fit_segment` uses for a segment with these counts."""
    return max(2 * REST_COEFFICIENTS, int(np.ceil((span_s[1] - span_s[0]) / _knot_spacing_s(at_s))))


def _poll_spacing_s(at_s: FloatArray) -> float:
    return float(np.median(np.diff(at_s))) if at_s.size > 1 else KNOT_SPACING_RANGE_S[1]


def _knot_spacing_s(at_s: FloatArray) -> float:
    return float(np.clip(POLLS_PER_KNOT * _poll_spacing_s(at_s), *KNOT_SPACING_RANGE_S))


def _unknown_of(column: IntArray, intervals: int) -> IntArray:
    """Return the unknown of each coefficient; those at an end belong to the rest."""
    return np.clip(column - (REST_COEFFICIENTS - 1), 0, intervals + 4 - 2 * REST_COEFFICIENTS)


def _normal_equations(
    values: FloatArray, column: IntArray, weight: FloatArray, target: FloatArray, intervals: int
) -> tuple[FloatArray, FloatArray]:
    """Return the banded normal equations of rows with few neighbouring unknowns.

    Args:
        values: of each row, shape (n, k).
        column: indices of their unknowns, shape (n, k).
        weight: of the rows, shape (n,).
        target: right side of the rows, shape (n,).
        intervals: of the spline.

    Returns:
        The lower band of the matrix, shape (4, unknowns), and the right side.
    """
    size = intervals + 5 - 2 * REST_COEFFICIENTS
    band, moment = np.zeros((4, size)), np.zeros(size)
    weighted = values * weight[:, None]
    np.add.at(moment, column, weighted * target[:, None])
    for k in range(values.shape[1]):
        offset = column - column[:, k, None]
        is_lower = offset >= 0
        product = weighted * values[:, k, None]
        row = np.broadcast_to(column[:, k, None], offset.shape)
        np.add.at(band, (offset[is_lower], row[is_lower]), product[is_lower])
    return band, moment


def _log_determinant(band: FloatArray) -> float:
    """Return the log-determinant of a positive definite banded matrix."""
    factor = cholesky_banded(band, lower=True, check_finite=False)
    return 2.0 * float(np.sum(np.log(factor[0])))


def _speeds(at_s: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the speed at each count, over about five counts."""
    n = at_s.size
    if n < 3:
        return np.zeros(n)
    low = np.clip(np.arange(n) - 2, 0, None)
    high = np.clip(np.arange(n) + 2, None, n - 1)
    return np.asarray((steps[high] - steps[low]) / np.maximum(at_s[high] - at_s[low], 1e-6))


def _basis(position: FloatArray, intervals: int) -> tuple[FloatArray, IntArray]:
    """Return uniform cubic B-splines at positions in units of the knot spacing."""
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
