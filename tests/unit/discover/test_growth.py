"""Scatter against shapes of a variance: its distribution in noise, and what it finds."""

import numpy as np
import pytest

from gyrorig_solver.discover.checks.variance_trend import fit_variance_trend, speed_shapes
from gyrorig_solver.numerics import normal_upper_tail

N, DRAWS = 3000, 1500
SPEED = np.abs(np.sin(np.linspace(0.0, 40.0, N))) * (np.arange(N) % 300 > 90)


@pytest.mark.parametrize("either_way", [False, True])
def test_chance_is_what_it_says(either_way: bool) -> None:
    rng = np.random.default_rng(1)
    shapes = speed_shapes(SPEED, float(SPEED.max()))
    p_values = [
        fit_variance_trend(shapes, rng.standard_normal(N) ** 2 - 1.0, either_way).p_value
        for _ in range(DRAWS)
    ]
    # The better of two is paid for twice, so a little too seldom; squares have longer tails
    # than a normal.
    for level in (0.2, 0.05, 0.01):
        share = float(np.mean(np.array(p_values) < level))
        assert share < level + 3.5 * np.sqrt(level / DRAWS)
        assert share > 0.3 * level


def test_a_single_shape_is_a_normal_deviate() -> None:
    excess = np.random.default_rng(2).standard_normal(N) ** 2 - 1.0
    shape = (SPEED > 0.0).astype(np.float64)
    weight = shape - shape.mean()
    z = float(weight @ excess) / np.sqrt(2.0 * np.sum(weight**2))
    assert fit_variance_trend(shape[None], excess).p_value == pytest.approx(normal_upper_tail(z))


def test_a_scatter_at_low_speeds_alone_is_found_by_the_speed() -> None:
    rng = np.random.default_rng(3)
    slow = (SPEED > 0.0) & (SPEED < 0.3)
    fast = SPEED > 0.8
    # As much more at low speeds as less at high ones: none in motion as a whole.
    variance = 1.0 + 0.8 * slow - 0.8 * fast * slow.sum() / fast.sum()
    excess = variance * rng.standard_normal(N) ** 2 - 1.0
    shapes = speed_shapes(SPEED, float(SPEED.max()))
    assert fit_variance_trend(shapes[:1], excess, two_sided=True).p_value > 1e-3
    assert fit_variance_trend(shapes, excess, two_sided=True).p_value < 1e-6


def test_what_never_moves_says_nothing() -> None:
    trend = fit_variance_trend(speed_shapes(np.zeros(N), 0.0), np.ones(N))
    assert (trend.degrees_of_freedom, trend.p_value) == (0, 1.0)
