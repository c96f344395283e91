"""A noise floor behind the low-pass is found where there is one, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import idct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.noise_floor import DIFFERENCE_ORDER, add_noise_floor
from gyrorig_solver.estimate.noise.noise_levels import fit_noise_levels, nominal_levels
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Sampling,
    aliased_low_pass,
    dct_frequencies_hz,
)
from gyrorig_solver.estimate.noise.residual_spectrum import Periodogram, bin_spectrum
from gyrorig_solver.estimate.noise.rest_noise import RestDifferences, limit_to_rest

COUNT, WHITE = 4000, 2.5e-7
SAMPLING = Sampling(100.0, 1, 25.0, 1e-6, differentiated=False)
PLAIN = NoiseModel(np.tile(nominal_levels(WHITE), (3, 1)), SAMPLING)
SHARES = np.array([0.05, 0.1, 0.2])  # of the white noise in the pass band
HIGH_HZ = np.array([45.0])
AT_REST = np.arange(COUNT) % 500 < 250


def draw_noise(model: NoiseModel, seed: int) -> FloatArray:
    """Return noise of a model, (n, 3): independent coefficients of the cosine transform."""
    coefficients = np.random.default_rng(seed).normal(size=(COUNT, 3))
    return np.asarray(idct(coefficients * np.sqrt(model.dct_variance(COUNT)), axis=0, norm="ortho"))


def fit(residual: FloatArray) -> tuple[NoiseModel, NoiseModel]:
    """Return the noise without and with a floor."""
    spectrum = bin_spectrum([Periodogram.of(residual, SAMPLING.rate_hz)])
    noise = fit_noise_levels(spectrum, SAMPLING)
    differences = RestDifferences.of([residual], [AT_REST], DIFFERENCE_ORDER)
    return noise, add_noise_floor(noise, spectrum, differences)


def log_stds(true: NoiseModel) -> FloatArray:
    """Return the standard deviation of the logarithms of white noise and floor, (3, 2).

    From the information of Whittle's likelihood; flicker and walk are known.
    """
    frequency_hz = dct_frequencies_hz(COUNT, SAMPLING.rate_hz)[1:]
    white = aliased_low_pass(frequency_hz, SAMPLING)[:, None] * true.levels[:, 0]
    shares = np.stack([white, np.broadcast_to(true.floor, white.shape)]) / true.density(
        frequency_hz
    )
    information = 0.5 * np.einsum("ika,jka->aij", shares, shares)
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(information), axis1=1, axis2=2)))


@pytest.mark.parametrize("seed", range(4))
def test_the_floor_and_the_white_noise_are_those_of_the_truth(seed: int) -> None:
    true = replace(PLAIN, floor=SHARES * WHITE)
    without, fitted = fit(draw_noise(true, seed))
    stds = log_stds(true)
    assert np.all(np.abs(np.log(fitted.levels[:, 0] / WHITE)) < 4.0 * stds[:, 0])
    assert np.all(np.abs(np.log(fitted.floor / true.floor)) < 4.0 * stds[:, 1])
    # Without a floor in the model, the density above the cut-off is far too small.
    assert np.all(without.density(HIGH_HZ)[:, 2] < 0.85 * true.density(HIGH_HZ)[:, 2])


def test_noise_without_a_floor_has_none() -> None:
    for seed in range(40):
        noise, fitted = fit(draw_noise(PLAIN, seed))
        assert fitted is noise, f"seed {seed}"


def test_noise_that_appears_in_motion_only_is_no_floor() -> None:
    residual = draw_noise(PLAIN, 1)
    flat = np.random.default_rng(2).normal(size=residual.shape)
    scale = np.sqrt(2.0 * SHARES.max() * WHITE * SAMPLING.rate_hz / 2.0)
    residual += np.where(AT_REST[:, None], 0.0, scale * flat)
    noise, fitted = fit(residual)
    assert fitted is noise


def test_a_floor_belongs_to_the_noise_at_rest() -> None:
    # Behind a narrow low-pass, most of the difference of two samples is the floor.
    sampling = replace(SAMPLING, bandwidth_hz=12.5)
    true = NoiseModel(PLAIN.levels, sampling, floor=np.full(3, 0.3 * WHITE))
    residual = draw_noise(true, 1)
    spectrum = bin_spectrum([Periodogram.of(residual, sampling.rate_hz)])
    noise = fit_noise_levels(spectrum, sampling)
    high = RestDifferences.of([residual], [AT_REST], DIFFERENCE_ORDER)
    fitted = add_noise_floor(noise, spectrum, high)
    differences = RestDifferences.of([residual], [AT_REST])
    assert limit_to_rest(fitted, differences) is fitted
    without = replace(fitted, floor=np.zeros(3))
    assert limit_to_rest(without, differences) is not without


def test_a_sensor_without_a_low_pass_has_no_separate_floor() -> None:
    sampling = replace(SAMPLING, bandwidth_hz=None)
    model = NoiseModel(PLAIN.levels, sampling)
    residual = draw_noise(model, 1)
    spectrum = bin_spectrum([Periodogram.of(residual, sampling.rate_hz)])
    noise = fit_noise_levels(spectrum, sampling)
    differences = RestDifferences.of([residual], [AT_REST], DIFFERENCE_ORDER)
    assert add_noise_floor(noise, spectrum, differences) is noise
