"""Reading between grid times, against scipy's own Hermite splines."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from gyrorig_solver.model.hermite_interpolation import HermiteInterpolator

RNG = np.random.default_rng(4)
GRID = np.cumsum(1.0 + 1e-4 * RNG.random(80))


def test_interpolation_matches_scipy() -> None:
    signal, slope = RNG.standard_normal((80, 3)), RNG.standard_normal((80, 3))
    at = RNG.uniform(GRID[0], GRID[-1], 200)
    interpolator = HermiteInterpolator.of(GRID, at)
    spline = CubicHermiteSpline(GRID, signal, slope)
    assert interpolator.interpolate(signal, slope) == pytest.approx(spline(at), abs=1e-12)
    steep = interpolator.differentiate(signal, slope)
    assert steep == pytest.approx(spline(at, 1), abs=1e-12)


def test_operator_uses_finite_difference_derivatives() -> None:
    signal = RNG.standard_normal(80)
    step_s = float(GRID[-1] - GRID[0]) / 79
    at = np.concatenate([GRID, RNG.uniform(GRID[0] - 3.0, GRID[-1] + 3.0, 300)])
    operator = HermiteInterpolator.of(GRID, at)
    slope = np.gradient(signal, step_s)
    wanted = operator.interpolate(signal[:, None], slope[:, None])
    assert operator.sparse_operator(step_s) @ signal == pytest.approx(wanted[:, 0], abs=1e-12)


def test_value_is_constant_beyond_the_ends() -> None:
    signal = RNG.standard_normal((80, 1))
    value = HermiteInterpolator.of(GRID, np.array([-50.0, 500.0])).interpolate(
        signal, np.ones((80, 1))
    )
    assert value[:, 0] == pytest.approx(signal[[0, -1], 0])
