"""Noise densities against their definition and against Monte Carlo."""

import numpy as np
import pytest
from scipy.fft import dct, idct

from gyrorig_solver.estimate import NoiseModel, Periodogram, bin_spectrum
from gyrorig_solver.estimate.noise.noise_levels import fit_noise_levels
from gyrorig_solver.estimate.noise.noise_model import Sampling, aliased_low_pass, dct_frequencies_hz

PLAIN = Sampling(100.0, 1, None, 0.0, False)


def test_white_noise_has_its_variance() -> None:
    """One-sided density N^2 over half the rate: variance N^2 r/2 in every coefficient."""
    model = NoiseModel(np.tile([4.0, 0.0, 0.0, 0.0], (3, 1)), PLAIN)
    assert np.allclose(model.dct_variance(512), 4.0 * 50.0)


def test_random_walk_variance_matches_monte_carlo() -> None:
    rng = np.random.default_rng(0)
    n, walk = 256, 0.3
    steps = rng.normal(scale=walk / np.sqrt(100.0), size=(4000, n))  # K^2 t
    spectrum = dct(np.cumsum(steps, axis=1), axis=1, norm="ortho")
    expected = NoiseModel(np.tile([0.0, 0.0, walk**2, 0.0], (3, 1)), PLAIN).dct_variance(n)[:, 0]
    density = np.mean(spectrum**2, axis=0)
    assert np.allclose(density[1:20] / expected[1:20], 1.0, atol=0.12)
    # The bias is the mean over the recording: a walk about it has no part in the constant.
    assert expected[0] < 1e-12 * expected[1]


def test_low_pass_is_aliased_like_samples() -> None:
    """Block means of filtered white noise, made at 32 kHz, against W(f)."""
    rng = np.random.default_rng(1)
    sampling = Sampling(100.0, 8, 110.0, 0.0, False)
    fast, n = 32_000.0, 2048
    f = np.fft.rfftfreq(n * 320, 1.0 / fast)
    shape = 1.0 / np.sqrt(1.0 + (f / 110.0) ** 4)
    power = np.zeros(n)
    for _ in range(12):
        white = np.fft.rfft(rng.normal(scale=np.sqrt(fast / 2.0), size=n * 320))
        raw = np.fft.irfft(white * shape)[::40]
        power += dct(raw.reshape(-1, 8).mean(axis=1), norm="ortho") ** 2 / 12.0
    bands = (power * 2.0 / 100.0).reshape(16, -1).mean(axis=1)
    expected = aliased_low_pass(dct_frequencies_hz(n, 100.0), sampling).reshape(16, -1).mean(axis=1)
    assert np.allclose(bands / expected, 1.0, atol=0.12)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_levels_are_recovered(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = NoiseModel(np.array([[2.5e-7, 4e-9, 1e-11, 0.0]] * 3), PLAIN)
    spectrum = rng.normal(size=(200_000, 3)) * np.sqrt(true.dct_variance(200_000))
    residual = np.asarray(idct(spectrum, axis=0, norm="ortho"))
    noise = fit_noise_levels(bin_spectrum([Periodogram.of(residual, 100.0)]), PLAIN)
    assert np.allclose(noise.levels[:, 0], 2.5e-7, rtol=0.05)
    density = noise.density(np.array([0.01, 0.1, 1.0]))
    assert np.allclose(density / true.density(np.array([0.01, 0.1, 1.0])), 1.0, atol=0.35)
