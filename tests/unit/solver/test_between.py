"""Reading between grid times, against scipy's own Hermite splines."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from gyrorig_solver.model.between import Between

RNG = np.random.default_rng(4)
GRID = np.cumsum(1.0 + 1e-4 * RNG.random(80))


def test_it_is_the_hermite_spline_of_scipy() -> None:
    signal, slope = RNG.standard_normal((80, 3)), RNG.standard_normal((80, 3))
    at = RNG.uniform(GRID[0], GRID[-1], 200)
    value, steep = Between.of(GRID, at).read(signal, slope)
    spline = CubicHermiteSpline(GRID, signal, slope)
    assert value == pytest.approx(spline(at), abs=1e-12)
    assert steep == pytest.approx(spline(at, 1), abs=1e-12)


def test_the_operator_reads_what_differences_for_slopes_read() -> None:
    signal = RNG.standard_normal(80)
    step_s = float(GRID[-1] - GRID[0]) / 79
    at = np.concatenate([GRID, RNG.uniform(GRID[0] - 3.0, GRID[-1] + 3.0, 300)])
    there = Between.of(GRID, at)
    slope = np.gradient(signal, step_s)
    wanted, _ = there.read(signal[:, None], slope[:, None])
    assert there.operator(step_s) @ signal == pytest.approx(wanted[:, 0], abs=1e-12)


def test_beyond_the_ends_it_stays() -> None:
    signal = RNG.standard_normal((80, 1))
    value, _ = Between.of(GRID, np.array([-50.0, 500.0])).read(signal, np.ones((80, 1)))
    assert value[:, 0] == pytest.approx(signal[[0, -1], 0])
