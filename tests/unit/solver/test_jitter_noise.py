"""Jitter of the sample times is a part of the noise: found, and whitened."""

import numpy as np
import pytest
from scipy.fft import dct, idct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.jitter_noise import JitterNoise, estimate_jitter_noise
from gyrorig_solver.estimate.noise.jitter_std import JitterStd
from gyrorig_solver.estimate.noise.motion_noise import MotionResidual, estimate_motion_noise
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling

RATE_HZ = 100.0
COUNT = 8000
NOISE = NoiseModel(
    np.tile([1e-8, 3e-10, 2e-12, 0.0], (3, 1)), Sampling(RATE_HZ, 1, 12.5, 1e-4, False)
)
ALL_USED = np.ones(COUNT, np.bool_)


def stage_rate() -> FloatArray:
    """Return moves of pan and tilt in turn: rest, acceleration, constant speed, deceleration."""
    phase = np.arange(COUNT) % 400
    speed = 1.5 * np.clip(np.minimum(phase - 100, 400 - phase) / 60.0, 0.0, 1.0)
    is_tilt = (np.arange(COUNT) // 400) % 2 == 1
    return np.stack([speed * is_tilt, 0.6 * speed * ~is_tilt, 0.8 * speed * ~is_tilt], axis=1)


def sensor_noise(rng: np.random.Generator) -> FloatArray:
    spectrum = rng.normal(size=(COUNT, 3)) * np.sqrt(NOISE.dct_variance(COUNT))
    return np.asarray(idct(spectrum, axis=0, norm="ortho"))


def jitter_of(deviation_s: float, rng: np.random.Generator) -> FloatArray:
    slope_rad_s2 = np.gradient(stage_rate(), axis=0) * RATE_HZ
    return np.asarray(slope_rad_s2 * (deviation_s * rng.normal(size=COUNT))[:, None])


def series_of(residual: FloatArray) -> list[MotionResidual]:
    return [MotionResidual(residual, stage_rate(), ALL_USED, [slice(0, COUNT)])]


def estimate(residual: FloatArray) -> JitterNoise | None:
    series = series_of(residual)
    return estimate_jitter_noise(series, np.eye(3), NOISE, estimate_motion_noise(series, NOISE))


@pytest.mark.parametrize("deviation_s", [1e-4, 1e-3])
def test_the_size_of_jitter_is_estimated(deviation_s: float) -> None:
    rng = np.random.default_rng(1)
    jitter = estimate(sensor_noise(rng) + jitter_of(deviation_s, rng))
    assert jitter is not None
    assert jitter.deviation_s == pytest.approx(deviation_s, rel=0.06)


@pytest.mark.parametrize("seed", range(8))
def test_noise_of_the_sensor_is_no_jitter(seed: int) -> None:
    assert estimate(sensor_noise(np.random.default_rng(seed))) is None


def test_noise_in_motion_is_no_jitter() -> None:
    noise = sensor_noise(np.random.default_rng(2))
    moving = np.any(stage_rate() != 0.0, axis=1)
    assert estimate(np.where(moving[:, None], 2.0 * noise, noise)) is None


def test_transients_at_starts_and_stops_are_no_jitter() -> None:
    """A rig rings at 40 Hz after each change of the acceleration, and has a wrong gain."""
    time_s = (np.arange(COUNT) % 400 - 100) / RATE_HZ
    ring = np.zeros(COUNT)
    for start_s in (0.0, 0.6, 2.4):
        after_s = np.clip(time_s - start_s, 0.0, None)
        ring += 0.01 * np.exp(-after_s / 0.05) * np.sin(2.0 * np.pi * 40.0 * after_s)
    rng = np.random.default_rng(3)
    assert estimate(sensor_noise(rng) + ring[:, None] + 0.01 * stage_rate()) is None


def jitter_std() -> JitterStd:
    jitter = JitterNoise(1e-3, np.eye(3), NOISE)
    return jitter.relative_std(stage_rate(), ALL_USED, np.ones((COUNT, 3)), keeps_constant=False)


def whitened(residual: FloatArray) -> FloatArray:
    spectra = dct(residual, axis=0, norm="ortho") / np.sqrt(NOISE.dct_variance(COUNT))
    return np.asarray(idct(jitter_std().divide_spectra(spectra.T), axis=-1, norm="ortho").T)


def test_the_whitened_noise_has_a_variance_of_one_at_all_times() -> None:
    squares = np.zeros((COUNT, 3))
    for seed in range(20):
        rng = np.random.default_rng(seed)
        squares += whitened(sensor_noise(rng) + jitter_of(1e-3, rng)) ** 2 / 20
    group = jitter_std().group.T
    assert squares.max() < 4.0  # chi-square of 20 degrees of freedom, over them
    for axis in range(3):
        for k in (0, group[:, axis].max()):
            assert np.mean(squares[group[:, axis] == k, axis]) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("axis", range(3))
def test_the_score_of_an_effect_in_accelerations_has_the_variance_of_the_noise(axis: int) -> None:
    effect = np.zeros((COUNT, 3))
    effect[:, axis] = np.gradient(stage_rate()[:, axis])
    pulse = whitened(effect / np.abs(effect).max())
    scores = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        scores.append(np.sum(whitened(sensor_noise(rng) + jitter_of(1e-3, rng)) * pulse))
    assert np.var(scores) / np.sum(pulse**2) == pytest.approx(1.0, abs=0.25)


def test_the_inverse_and_the_adjoint_of_the_division() -> None:
    rng = np.random.default_rng(4)
    std = jitter_std()
    first, second = rng.normal(size=(2, 3, COUNT))
    divided = std.divide_spectra(first)
    assert np.sum(divided * second) == pytest.approx(np.sum(first * std.divide_adjoint(second)))
    assert np.allclose(std.divide_spectra(std.multiply_spectra(divided)), divided, atol=0.01)
    for axis in range(3):
        assert np.allclose(std.divide_spectra(first[axis : axis + 1], axis)[0], divided[axis])
        signals = idct(first[axis : axis + 1], norm="ortho")
        expected = idct(divided[axis], norm="ortho")
        assert np.allclose(std.divide_signals(signals, axis)[0], expected)
        local = np.stack([idct(first[k : k + 1], norm="ortho") for k in range(3)])
        assert np.allclose(std.divide_local(local)[axis, 0], expected)
