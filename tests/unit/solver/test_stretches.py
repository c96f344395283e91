"""Splines through counts: the banded fit against dense matrices, windows against the whole."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from gyrorig_solver.reference import MotionLimits, plan_motion
from gyrorig_solver.reference.unit.counted_reference import CountedReference, counted_reference
from gyrorig_solver.reference.unit.motion_profile import ProfileCommand
from gyrorig_solver.reference.unit.move_fit import UnitPolls
from gyrorig_solver.reference.unit.spline_segment import (
    INTENSITY_CANDIDATES,
    INTENSITY_FACTOR,
    REST_COEFFICIENTS,
    SplineSegment,
    fit_segment,
)

LAW = MotionLimits(1200.0, 4000.0, 60.0)
STEP_RAD = 9e-4


def counts_of(target: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    course = plan_motion(0.0, [ProfileCommand(0.5, "to", target, LAW)])
    at_s = np.arange(0.4, course.end_s + 0.1, 0.012) + rng.uniform(0.0, 1e-3)
    spread_s = rng.uniform(1e-5, 2e-4, at_s.size)
    return at_s, np.rint(course.position_steps(at_s)), spread_s


def dense_of(
    stretch: SplineSegment, at_s: np.ndarray, steps: np.ndarray, spread_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return information and pull by full matrices, the basis from scipy."""
    k = stretch.intervals
    knots = stretch.begin_s + stretch.knot_spacing_s * np.arange(-3, k + 4)
    design = BSpline.design_matrix(at_s, knots, 3).toarray()
    held = np.zeros((k + 3, k - 1))
    held[:REST_COEFFICIENTS, 0] = held[-REST_COEFFICIENTS:, -1] = 1.0
    held[REST_COEFFICIENTS:-REST_COEFFICIENTS, 1:-1] = np.eye(k - 3)
    fixed = np.zeros(k + 3)
    fixed[:REST_COEFFICIENTS], fixed[-REST_COEFFICIENTS:] = stretch.counts
    bend = np.diff(np.eye(k + 3), n=2, axis=0)
    usual_s = float(np.median(np.diff(at_s)))
    low, high = np.maximum(np.arange(at_s.size) - 2, 0), np.arange(at_s.size) + 2
    high = np.minimum(high, at_s.size - 1)
    speed = (steps[high] - steps[low]) / (at_s[high] - at_s[low])
    weight = np.clip(np.abs(speed) * usual_s, 0.05, 1.0) / (1 / 12 + (speed * spread_s) ** 2)
    inner, left = design @ held, steps - design @ fixed
    gram, moment = (inner.T * weight) @ inner, (inner.T * weight) @ left
    rough, rough_pull = held.T @ bend.T @ bend @ held, -(held.T @ bend.T @ bend @ fixed)
    ends = np.zeros(k - 1)
    ends[[0, -1]] = 12.0
    likelihood = []
    for intensity in INTENSITY_CANDIDATES:
        per = 1.0 / (intensity * stretch.knot_spacing_s**3)
        total = gram + per * rough + np.diag(ends)
        result = np.linalg.solve(total, moment + per * rough_pull)
        bent = bend @ (fixed + held @ result)
        off = left - inner @ result
        worse = off @ (weight * off) + per * bent @ bent + ends @ result**2
        size = np.linalg.slogdet(per * rough + np.diag(ends))[1] - np.linalg.slogdet(total)[1]
        likelihood.append(size - worse)
    per = 1.0 / (
        INTENSITY_FACTOR
        * INTENSITY_CANDIDATES[int(np.argmax(likelihood))]
        * stretch.knot_spacing_s**3
    )
    return gram + per * rough, moment + per * rough_pull


@pytest.mark.parametrize("target", [40.0, 700.0, -2500.0])
def test_banded_and_dense_solutions_are_equal(target: float) -> None:
    at_s, steps, spread_s = counts_of(target)
    span_s = (float(at_s[0]) - 0.01, float(at_s[-1]) + 0.005)
    result = fit_segment(0, span_s, (0, round(target)), at_s, steps, spread_s)
    information, pull = dense_of(result, at_s, steps, spread_s)
    size = result.inner_count + 2
    for off in range(size):
        expected = np.diagonal(information, -off)
        banded = result.information[off, : size - off] if off < 4 else np.zeros(size - off)
        assert np.allclose(banded, expected, rtol=1e-9, atol=1e-9 * information.max())
    assert np.allclose(result.information_vector, pull, rtol=1e-9, atol=1e-9 * np.abs(pull).max())


def reference() -> CountedReference:
    time_s = np.arange(0.0, 40.0, 0.012)
    steps, stood, begin_s = np.zeros((time_s.size, 2)), [0.0, 0.0], 1.0
    for k in range(14):
        axis, target = int(k % 4 == 3), float(300 * (-1) ** k + 20 * k)
        course = plan_motion(stood[axis], [ProfileCommand(begin_s, "to", target, LAW)])
        after = time_s >= begin_s
        steps[after, axis] = course.position_steps(time_s[after])
        stood[axis], begin_s = target, course.end_s + 1.5
    valid = np.ones(steps.shape, dtype=np.bool_)
    polls = UnitPolls(time_s, time_s + 0.005, np.rint(steps), valid)
    return counted_reference(polls, (STEP_RAD, STEP_RAD), "no move was told")


def test_a_window_is_a_piece_of_the_whole() -> None:
    counted = reference()
    edges = np.linspace(0.5, 39.0, 3001)
    whole = counted.evaluate(edges)
    columns = {derivative.unknown: derivative for derivative in whole.local}
    rng = np.random.default_rng(1)
    for begin, size in zip(rng.integers(0, 2900, 10), rng.integers(2, 900, 10), strict=True):
        stop = min(3000, int(begin + size))
        result = counted.evaluate(edges[begin : stop + 1])
        assert np.allclose(result.rate_rad_s, whole.rate_rad_s[begin:stop], atol=1e-12)
        assert np.allclose(result.shared, whole.shared[:, begin:stop], atol=1e-12)
        assert len({derivative.unknown for derivative in result.local}) == len(result.local)
        here = {derivative.unknown: derivative for derivative in result.local}
        for unknown, derivative in columns.items():
            column = np.zeros((3000, 3))
            column[
                derivative.first_interval : derivative.first_interval + derivative.values.shape[0]
            ] = derivative.values
            output = np.zeros((stop - begin, 3))
            if unknown in here:
                windowed = here[unknown]
                output[
                    windowed.first_interval : windowed.first_interval + windowed.values.shape[0]
                ] = windowed.values
            assert np.allclose(output, column[begin:stop], atol=1e-12)
    size = sum(counted.information.size)
    few = counted.evaluate(edges[1500:1520]).local
    assert 0 < len(few) < size / 10
