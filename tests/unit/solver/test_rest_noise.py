"""Fitted noise levels are compared with the differences of successive samples at rest."""

import numpy as np
import pytest
from scipy.signal import welch

from gyrorig_solver.estimate import NoiseModel, nominal_levels
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.estimate.noise.rest_noise import RestDifferences, limit_to_rest

RATE_HZ, N = 100.0, 20_000
WHITE = 2e-7  # (rad/s)^2/Hz
SAMPLING = Sampling(RATE_HZ, 1, None, 1e-6, False)
STD_RAD_S = np.sqrt(WHITE * RATE_HZ / 2.0)


@pytest.fixture(scope="module")
def residual() -> np.ndarray:
    """White noise; in the second half the unit moves and the model does not fit."""
    rng = np.random.default_rng(5)
    values = rng.normal(scale=STD_RAD_S, size=(N, 3))
    values[N // 2 :, 2] += 0.2 * np.sin(np.arange(N // 2) * 0.05)
    return values


def differences(residual: np.ndarray, rest: slice) -> RestDifferences:
    at_rest = np.zeros(N, np.bool_)
    at_rest[rest] = True
    return RestDifferences.of([residual], [at_rest])


def test_levels_that_agree_with_the_rest_stay(residual: np.ndarray) -> None:
    noise = NoiseModel(np.tile(nominal_levels(WHITE), (3, 1)), SAMPLING)
    assert limit_to_rest(noise, differences(residual, slice(0, N // 2))) is noise


def test_white_noise_that_became_flicker_is_restored(residual: np.ndarray) -> None:
    levels = np.tile(nominal_levels(WHITE), (3, 1))
    levels[2] = [1e-10, 1e-3, 1e-9, 0.0]
    limited = limit_to_rest(NoiseModel(levels, SAMPLING), differences(residual, slice(0, N // 2)))
    assert np.array_equal(limited.levels[:2], levels[:2])
    assert limited.levels[2, 0] == pytest.approx(WHITE, rel=0.05)
    assert limited.levels[2, 1] == pytest.approx(nominal_levels(WHITE)[1], rel=0.05)
    # An independent estimate of the density at rest.
    frequency_hz, density = welch(residual[: N // 2, 2], RATE_HZ, nperseg=512)
    band = (frequency_hz > 20.0) & (frequency_hz < 45.0)
    stated = limited.density(frequency_hz[band])[:, 2]
    assert stated.mean() == pytest.approx(density[band].mean(), rel=0.1)


def test_a_limited_axis_is_released_at_a_smaller_ratio(residual: np.ndarray) -> None:
    """With one limit, a fit whose ratio was near it alternated between two sets of levels."""
    at_rest = differences(residual, slice(0, N // 2))
    levels = np.tile(nominal_levels(WHITE), (3, 1))
    levels[2] *= 4.1
    limited = limit_to_rest(NoiseModel(levels, SAMPLING), at_rest)
    assert limited.levels[2, 0] == pytest.approx(WHITE, rel=0.05)
    levels[2] *= 3.0 / 4.1
    noise = NoiseModel(levels, SAMPLING)
    assert limit_to_rest(noise, at_rest) is noise
    again = limit_to_rest(noise, at_rest, limited.levels)
    assert np.array_equal(again.levels, limited.levels)
    levels[2] *= 1.5 / 3.0
    assert limit_to_rest(noise, at_rest, limited.levels) is noise


def test_a_short_rest_decides_nothing(residual: np.ndarray) -> None:
    levels = np.full((3, 4), 1e-10)
    noise = NoiseModel(levels, SAMPLING)
    assert limit_to_rest(noise, differences(residual, slice(0, 100))) is noise


def test_differences_do_not_cross_the_edge_of_a_rest() -> None:
    residual = np.zeros((400, 3))
    residual[200:] = 1.0
    at_rest = np.ones(400, np.bool_)
    at_rest[200] = False
    result = RestDifferences.of([residual], [at_rest])
    assert result.count == 397
    assert not result.power.any()
