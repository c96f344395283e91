"""Missing samples change neither the stated noise nor the meaning of the uncertainties."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.fft import dct, idct
from tests.bench.accuracy.noise import Levels
from tests.unit.solver import conftest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate import UNIT_REMEDIES, GyroFit, NoiseModel, fit_motion, nominal_levels
from gyrorig_solver.estimate.linear.gap_fill import gap_fill
from gyrorig_solver.estimate.linear.whitening import whiten_residual
from gyrorig_solver.estimate.motion_fit import solve_motion
from gyrorig_solver.estimate.noise.missing_samples import (
    expected_densities,
    incomplete_densities,
)
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.estimate.noise.residual_spectrum import Periodogram
from gyrorig_solver.estimate.uncertainty_widening import _whitened_power
from gyrorig_solver.model import FACTOR_NAMES, factorise

Simulate = Callable[..., Any]
WHITE = 2.5e-7
LEVELS = np.tile([WHITE, 40.0 * nominal_levels(WHITE)[1], 0.0, 0.0], (3, 1))
COUNT, DRAWS = 1200, 300
WANDERING = Levels(white=5.2e-4, flicker=1e-3, walk=5e-4, quantum_rad_s=1.527e-4)
SEEDS, LOWEST_P = 6, 0.001
# of the information; the weights of the filled rows come from their neighbours only
MAX_WEIGHT_ERROR = 0.2
MAX_WHITE_ERROR = 0.05  # of the root of the white density, 2 standard deviations of one fit


def draw_mask(count: int, share: float, burst: int, seed: int) -> BoolArray:
    """Return which samples are received; `share` of them is lost in bursts."""
    rng = np.random.default_rng([seed, 7])
    received = np.ones(count, dtype=np.bool_)
    for first in np.flatnonzero(rng.uniform(size=count) < share / burst / (1.0 - share)):
        received[first : first + burst] = False
    if burst == 1:
        received = rng.uniform(size=count) >= share
    received[[0, -1]] = True
    return received


def draw_noise(sampling: Sampling, count: int, seed: int) -> FloatArray:
    """Return independent noise of a model on each of many axes, (count, DRAWS)."""
    variance = NoiseModel(LEVELS, sampling).dct_variance(count)[:, :1]
    coefficients = np.random.default_rng(seed).normal(size=(count, DRAWS)) * np.sqrt(variance)
    return np.asarray(idct(coefficients, axis=0, norm="ortho"))


def receive(samples: GyroSamples, received: BoolArray) -> GyroSamples:
    """Return samples without those that were not received."""
    names = ("time_s", "host_s", "number", "segment", "rate_rad_s", "usable")
    return replace(samples, **{name: getattr(samples, name)[received] for name in names})


def fit_received(
    simulate: Simulate, seed: int, hz: float, bandwidth: float, losses: tuple[float, int]
) -> tuple[GyroFit, float]:
    """Return the fit of a rig with losses, and the chi-square of the factors of its gain."""
    rig = simulate(seed, hz=hz, bandwidth=bandwidth)
    samples = samples_of(rig.time_s, rig.rate_rad_s)
    samples = replace(samples, metadata={"bandwidth_hz": str(bandwidth)})
    received = draw_mask(rig.time_s.size, *losses, seed)
    fit = fit_motion(receive(samples, received), reference_of(rig), UNIT_REMEDIES)
    factors = factorise(rig.gain)
    true = [*factors.scale, *factors.nonorthogonality, *factors.misalignment_rad]
    places = [fit.order.index(name) for name in FACTOR_NAMES]
    error = np.array([fit.value(name) for name in FACTOR_NAMES]) - true
    covariance = fit.covariance[np.ix_(places, places)]
    return fit, float(error @ np.linalg.solve(covariance, error))


@pytest.mark.parametrize("samples_per_block", [1, 4])
@pytest.mark.parametrize("losses", [(0.3, 1), (0.3, 25)])
def test_the_expected_spectrum_is_the_mean_of_many(
    samples_per_block: int, losses: tuple[float, int]
) -> None:
    m, n = samples_per_block, COUNT // samples_per_block
    sampling = Sampling(400.0 / m, m, 60.0, 1e-9, differentiated=False)
    of_samples = replace(sampling, rate_hz=400.0, samples_per_block=1)
    noise = draw_noise(of_samples, COUNT, 1).reshape(n, m, DRAWS)
    used = draw_mask(COUNT, *losses, 3).reshape(n, m)
    means = (noise * used[:, :, None]).sum(axis=1) / np.maximum(used.sum(axis=1), 1)[:, None]
    power = dct(means, axis=0, norm="ortho")[1:] ** 2 * (2.0 / sampling.rate_hz)
    power /= used.any(axis=1).mean()
    expected = expected_densities(used, sampling)
    assert expected is not None
    total = LEVELS[0] @ expected[:4]
    ratios = (power.mean(axis=1) / total)[: 10 * (total.size // 10)].reshape(-1, 10).mean(axis=1)
    # Neighbouring coefficients are correlated, so that ten of them count as three.
    std = np.sqrt(2.0 / DRAWS / 3.0)
    assert np.all(np.abs(ratios[1:] - 1.0) < 5.0 * std)
    assert abs(ratios.mean() - 1.0) < 3.0 * std


def test_complete_samples_need_no_correction() -> None:
    sampling = Sampling(100.0, 8, 60.0, 1e-9, differentiated=False)
    used = np.ones((50, 8), dtype=np.bool_)
    assert expected_densities(used, sampling) is None
    assert not incomplete_densities(used, sampling).any()
    assert gap_fill(used[:, 0], NoiseModel(LEVELS, sampling)) is None


def test_blocks_of_fewer_samples_have_more_noise() -> None:
    sampling = Sampling(100.0, 8, None, 0.0, differentiated=False)
    used = np.random.default_rng(1).uniform(size=(4000, 8)) < 0.5
    # The mean of k of 8 independent samples has 8/k times the variance.
    counts = used.sum(axis=1)
    added = float(np.mean(8.0 / counts[counts > 0])) - 1.0
    assert incomplete_densities(used, sampling)[[0, 4]] == pytest.approx([added, added], rel=1e-6)


@pytest.mark.parametrize("losses", [(0.1, 1), (0.5, 1), (0.3, 20)])
def test_filled_rows_weight_the_others_as_their_covariance_does(losses: tuple[float, int]) -> None:
    sampling = Sampling(100.0, 1, 25.0, 1e-5, differentiated=False)
    noise = NoiseModel(LEVELS * np.array([1.0, 10.0, 1.0, 1.0]), sampling)
    n = 1500
    used = draw_mask(n, *losses, 2)
    basis = dct(np.eye(n), axis=0, norm="ortho")
    covariance = basis.T @ (noise.dct_variance(n)[:, :1] * basis)
    signals = np.sin(np.arange(n)[:, None] * np.array([0.01, 0.03, 0.1]) + 1.0)
    signals *= used[:, None]
    white = whiten_residual([signals], noise, used=[used])
    exact = np.sum(
        signals[used] * np.linalg.solve(covariance[np.ix_(used, used)], signals[used]), axis=0
    )
    assert np.sum(white**2, axis=0) == pytest.approx(exact, rel=MAX_WEIGHT_ERROR)
    # Zeros in their place would claim far more information.
    zeros = whiten_residual([signals], noise)
    assert np.sum(zeros**2, axis=0)[0] > 2.0 * exact[0]
    assert np.all(np.sum(zeros**2, axis=0) > 1.1 * exact)


def test_the_adjoint_belongs_to_the_filling() -> None:
    sampling = Sampling(100.0, 1, 25.0, 1e-5, differentiated=False)
    used = draw_mask(400, 0.3, 1, 5)
    fill = gap_fill(used, NoiseModel(LEVELS, sampling))
    assert fill is not None
    first, second = np.random.default_rng(6).normal(size=(2, 400))
    product = float(fill.fill(first * used) @ second)
    assert float(first @ fill.adjoint(second)) == pytest.approx(product)


def test_an_unused_part_has_nothing_to_predict_from() -> None:
    sampling = Sampling(100.0, 1, 25.0, 1e-5, differentiated=False)
    assert gap_fill(np.zeros(300, dtype=np.bool_), NoiseModel(LEVELS, sampling)) is None
    used = np.zeros(5000, dtype=np.bool_)
    used[:5] = used[-5:] = True
    fill = gap_fill(used, NoiseModel(LEVELS, sampling))
    assert fill is not None
    filled = fill.fill(used.astype(np.float64))
    assert filled[5] > 0.0
    assert not filled[2000:3000].any()


def test_rows_at_the_ends_are_no_gap() -> None:
    """Nearly every recording has some rows before the first position of the unit."""
    sampling = Sampling(100.0, 4, 25.0, 1e-5, differentiated=False)
    used = np.ones((300, 4), dtype=np.bool_)
    used[:3] = used[3, :2] = used[-2:] = False
    assert expected_densities(used, sampling) is None
    assert not incomplete_densities(used, sampling).any()
    assert gap_fill(np.asarray(used.any(axis=1)), NoiseModel(LEVELS, sampling)) is None
    used[150, 1] = False
    assert expected_densities(used, sampling) is not None


def test_the_share_of_each_part_scales_its_power() -> None:
    sampling = Sampling(100.0, 1, None, 0.0, differentiated=False)
    used = np.random.default_rng(8).uniform(size=(COUNT, 1)) < 0.5
    expected = expected_densities(used, sampling)
    assert expected is not None
    periodogram = Periodogram.of(
        np.zeros((COUNT, 3)), 100.0, float(used.mean()), unit_density=expected
    )
    assert periodogram.unit_density is not None
    np.testing.assert_allclose(periodogram.unit_density[0], 1.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("hz", "bandwidth", "losses"),
    [
        (100.0, 25.0, (0.1, 1)),
        (100.0, 40.0, (0.3, 1)),
        (100.0, 25.0, (0.5, 1)),
        (100.0, 25.0, (0.3, 20)),
        (800.0, 256.0, (0.1, 1)),
        (800.0, 256.0, (0.5, 1)),
        (800.0, 256.0, (0.3, 20)),
    ],
)
def test_the_noise_density_is_that_of_complete_samples(
    simulate: Simulate, hz: float, bandwidth: float, losses: tuple[float, int]
) -> None:
    fits = [fit_received(simulate, seed, hz, bandwidth, losses)[0] for seed in (0, 1)]
    for fit in fits:
        assert fit.noise is not None
        assert fit.noise.noise_floor is None
    stated = np.mean([fit.noise.angle_random_walk for fit in fits if fit.noise], axis=0)
    assert np.abs(stated / conftest.LEVELS.white - 1.0).max() < MAX_WHITE_ERROR


def test_lost_samples_do_not_hide_an_excess(simulate: Simulate) -> None:
    powers = []
    for seed in range(4):
        rig = simulate(seed)
        samples = samples_of(rig.time_s, rig.rate_rad_s)
        received = draw_mask(rig.time_s.size, 0.5, 1, seed)
        solution = solve_motion([(receive(samples, received), reference_of(rig))])
        (power,) = _whitened_power(solution)
        powers.append(float(np.mean(power.power[power.moving | power.at_rest])))
    # The mean of 4 times about 9000 values with variance 2 has a standard deviation of 0.008.
    assert np.mean(powers) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("losses", [(0.03, 1), (0.3, 1)])
def test_the_gain_is_as_uncertain_as_stated_if_samples_of_a_wandering_bias_are_lost(
    simulate: Simulate, monkeypatch: pytest.MonkeyPatch, losses: tuple[float, int]
) -> None:
    monkeypatch.setattr(conftest, "LEVELS", WANDERING)
    total = sum(fit_received(simulate, seed, 100.0, 25.0, losses)[1] for seed in range(SEEDS))
    assert stats.chi2.sf(total, 9 * SEEDS) > LOWEST_P, total
