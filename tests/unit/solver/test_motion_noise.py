"""Noise that is larger in motion: found in white noise, not in what the rig does."""

import numpy as np
import pytest
from scipy.fft import idct
from tests.bench.accuracy.motor_noise import MotorNoise
from tests.bench.accuracy.trial import Case, solve_case

from gyrorig_solver.estimate import ConvergedFit, NoiseModel, NuisanceProjector, SessionFit, series
from gyrorig_solver.estimate.linear.whitening import whiten_residual
from gyrorig_solver.estimate.noise.motion_noise import (
    MotionNoise,
    MotionResidual,
    estimate_motion_noise,
)
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.estimate.noise.relative_std import RelativeStd

RATE_HZ = 100.0
WHITE = 5e-4  # rad/s/sqrt(Hz)
SAMPLING = Sampling(RATE_HZ, 1, None, 0.0, differentiated=False)
NOISE = NoiseModel(np.tile([WHITE**2, 0.0, 0.0, 0.0], (3, 1)), SAMPLING)
PERIOD = 800  # samples: half of them at rest


def stage_rate(n: int) -> np.ndarray:
    """Pan and tilt in turn, each at two constant speeds."""
    phase = np.arange(n) // (PERIOD // 2)
    speed = np.where(phase % 2 == 0, 0.0, np.where((phase // 4) % 2 == 0, 0.5, 1.0))
    is_tilt = (phase // 2) % 2 == 1
    return np.stack(
        [np.where(is_tilt, speed, 0.0), np.zeros(n), np.where(is_tilt, 0.0, speed)], axis=1
    )


def residual_of(relative_std: np.ndarray, seed: int = 0) -> np.ndarray:
    """White noise of that relative deviation, shape (n, 3)."""
    rng = np.random.default_rng(seed)
    n = relative_std.shape[0]
    return relative_std[:, None] * rng.normal(scale=WHITE * np.sqrt(RATE_HZ / 2.0), size=(n, 3))


def estimate(residual: np.ndarray, rate: np.ndarray) -> MotionNoise | None:
    n = rate.shape[0]
    whole = MotionResidual(residual, rate, np.ones(n, np.bool_), [slice(0, n)])
    return estimate_motion_noise([whole], NOISE)


def test_more_noise_in_motion_is_found() -> None:
    rate = stage_rate(40 * PERIOD)
    moving = np.any(rate != 0.0, axis=1)
    motion_noise = estimate(residual_of(np.where(moving, np.sqrt(2.0), 1.0)), rate)
    assert motion_noise is not None
    variance = motion_noise.relative_variance(rate)
    assert np.all(variance[~moving] == 1.0)
    assert np.allclose(variance[moving], 2.0, rtol=0.08)


def test_noise_of_one_motor_that_grows_with_its_speed_is_found() -> None:
    rate = stage_rate(40 * PERIOD)
    motion_noise = estimate(residual_of(np.sqrt(1.0 + 4.0 * rate[:, 0] ** 2)), rate)
    assert motion_noise is not None
    ratios = motion_noise.mean_ratios(rate)
    fast, slow = rate[:, 0] == 1.0, rate[:, 0] == 0.5
    variance = motion_noise.relative_variance(rate)
    assert np.allclose(variance[fast], 5.0, rtol=0.1)
    assert np.allclose(variance[slow], 2.0, rtol=0.2)
    assert np.allclose(ratios["pan_motion"], 1.0, atol=0.05)


@pytest.mark.parametrize("seed", range(8))
def test_equal_noise_is_left_exactly_as_it_is(seed: int) -> None:
    rate = stage_rate(8 * PERIOD)
    assert estimate(residual_of(np.ones(rate.shape[0]), seed), rate) is None


def test_transients_and_slow_errors_are_no_noise() -> None:
    """A rig's errors: rings of 10 Hz after each start and stop, and 1 % of the rate."""
    rate = stage_rate(40 * PERIOD)
    n = rate.shape[0]
    after_s = (np.arange(n) % (PERIOD // 2)) / RATE_HZ
    ring = 0.05 * np.exp(-after_s / 0.05) * np.sin(2.0 * np.pi * 10.0 * after_s)
    residual = residual_of(np.ones(n)) + ring[:, None] + 0.01 * rate
    moving = np.any(rate != 0.0, axis=1)
    assert np.mean(residual[moving] ** 2) > 2.0 * np.mean(residual_of(np.ones(n)) ** 2)
    assert estimate(residual, rate) is None


def test_white_noise_is_weighted_exactly() -> None:
    """Of white noise the whitened residual is the residual over its standard deviation."""
    rng = np.random.default_rng(1)
    std = rng.uniform(1.0, 3.0, size=(400, 3))
    residual = std * rng.normal(size=(400, 3))
    white = whiten_residual([residual], NOISE, [RelativeStd(std.T, keeps_constant=False)])
    assert np.allclose(white, residual / std / (WHITE * np.sqrt(RATE_HZ / 2.0)))


@pytest.mark.parametrize("keeps_constant", [False, True])
def test_division_and_multiplication_are_inverse(keeps_constant: bool) -> None:
    rng = np.random.default_rng(2)
    relative_std = RelativeStd(rng.uniform(1.0, 2.0, size=(3, 64)), keeps_constant)
    spectra = rng.normal(size=(2, 3, 64))
    divided = relative_std.divide_spectra(spectra)
    for axis in range(3):
        quotient = relative_std.divide_spectra(spectra[:, axis], axis)
        assert np.allclose(quotient, divided[:, axis])
        signals = idct(spectra[:, axis], norm="ortho")
        assert np.allclose(relative_std.divide_signals(signals, axis), idct(quotient, norm="ortho"))
    if keeps_constant:
        assert np.array_equal(divided[..., 0], spectra[..., 0])
    else:
        assert np.allclose(relative_std.multiply_spectra(divided), spectra)


@pytest.fixture(scope="module")
def noisy_fit() -> ConvergedFit:
    """A fit of a recording whose noise is sqrt(5) times as large in motion."""
    case = Case("motor noise", "planned-75.yaml", number=1, motor_noise=MotorNoise(2.0))
    return solve_case(case, 0)


def test_a_fit_finds_and_uses_the_noise_in_motion(noisy_fit: ConvergedFit) -> None:
    session = noisy_fit.sessions[0]
    assert noisy_fit.converged
    assert np.allclose(session.noise_ratios()["in_motion"], np.sqrt(5.0), rtol=0.12)
    white = np.concatenate(noisy_fit.whitened_residuals())
    moving, used = np.concatenate(session.moving), np.concatenate(session.used)
    for mask in (moving & used, ~moving & used):
        assert np.mean(white[mask] ** 2) == pytest.approx(1.0, abs=0.1)


def test_score_tests_use_the_same_weights(noisy_fit: ConvergedFit) -> None:
    """The projector's residual is that of the fit, and its score vanishes at the optimum."""
    projector = NuisanceProjector.at_fit(noisy_fit)
    white = np.concatenate(noisy_fit.whitened_residuals())
    assert np.allclose(projector.residual, white.T.ravel(), atol=1e-9)
    rates = projector.unwhiten(projector.residual)
    residual = noisy_fit.sessions[0].residuals(noisy_fit.gain)[0]
    assert np.allclose(rates[0], residual, atol=1e-12)
    ones = [[np.ones((1, *residual.shape))]]
    score = float(projector.whiten(ones).dense()[0] @ projector.residual)
    weighted = projector.weighted_residual()[0]
    assert score == pytest.approx(float(weighted.sum()), rel=1e-6, abs=1e-6)


def test_equal_noise_gives_the_same_fit_as_without_the_estimate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case = Case("no motor noise", "planned-75.yaml", number=1)
    fit = solve_case(case, 1)
    assert not fit.sessions[0].noise_ratios()
    assert fit.sessions[0].jitter_noise is None
    monkeypatch.setattr(SessionFit, "update_motion_noise", lambda *_: False)
    without = solve_case(case, 1)
    assert np.array_equal(fit.estimate, without.estimate)
    assert np.array_equal(fit.observability.covariance, without.observability.covariance)


def test_a_series_in_parts_gives_nearly_the_same(
    noisy_fit: ConvergedFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The parts of a long series share their constants, which keep the mean noise."""
    monkeypatch.setattr(series, "PART_BLOCKS", 2048)
    fit = solve_case(Case("in parts", "planned-75.yaml", number=1, motor_noise=MotorNoise(2.0)), 0)
    assert len(fit.sessions[0].series[0].part_slices()) == 4
    std, theirs = (np.sqrt(np.diag(result.observability.covariance)) for result in (fit, noisy_fit))
    assert np.all(np.abs(fit.estimate - noisy_fit.estimate)[:9] < 0.5 * theirs[:9])
    assert np.allclose(std[:9], theirs[:9], rtol=0.05)
    assert np.all(std[9:12] >= theirs[9:12])


def test_noise_at_the_limit_of_contradiction_converges() -> None:
    """In this run, the levels of one axis alternated between limited and not limited."""
    case = Case("twice", "planned-75.yaml", number=1, motor_noise=MotorNoise(2.0))
    assert solve_case(case, 40).converged
