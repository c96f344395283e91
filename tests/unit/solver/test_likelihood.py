"""The fit against simulated truth: errors in units of what the fit itself claims."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.quick_cases import quick_cases
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.estimate import UNIT_REMEDIES, GyroFit, fit_motion
from gyrorig_solver.model import factorise

LOW_PASS_DELAY_S = np.sqrt(2.0) / (2.0 * np.pi * 25.0)  # Butterworth, second order, 25 Hz

Simulate = Callable[..., Any]


def fit(rig: Any, rate: np.ndarray | None = None) -> GyroFit:
    samples = samples_of(rig.time_s, rig.rate_rad_s if rate is None else rate)
    return fit_motion(samples, reference_of(rig), UNIT_REMEDIES)


def truth(rig: Any) -> dict[str, float]:
    factors = factorise(rig.gain)
    named = {}
    for group, parts, values in (
        ("bias", "x y z", rig.bias_rad_s),
        ("scale", "x y z", factors.scale),
        ("nonorthogonality", "xy zx zy", factors.nonorthogonality),
        ("misalignment", "x y z", factors.misalignment_rad),
    ):
        named.update({f"{group}.{p}": float(v) for p, v in zip(parts.split(), values, strict=True)})
    return {**named, "time_offset": rig.lag_s + LOW_PASS_DELAY_S}


@pytest.mark.parametrize("off_count", quick_cases([0.0, 0.5], [0.5]))
def test_errors_match_the_stated_uncertainty(simulate: Simulate, off_count: float) -> None:
    """Eight boards: joint chi-squared inside its 99.8 % span; no parameter beyond 4 sigma.

    Once the unit rests exactly on its counts, once anywhere within them.
    """
    total = 0.0
    for seed in range(8):
        rig = simulate(seed, off_count=off_count)
        result = fit(rig)
        true = truth(rig)
        error = np.array([result.value(n) - true[n] for n in result.order])
        assert len(result.order) == 13
        assert result.identified
        z = error / np.sqrt(np.diag(result.covariance))
        assert np.abs(z).max() < 4.0
        total += float(error @ np.linalg.solve(result.covariance, error))
        assert (reference_of(rig).move_fit.rest_variance > 0.05 / 12.0) == (off_count > 0.0)
    # 8 x 13 degrees of freedom; scipy.stats.chi2.ppf([0.001, 0.999], 104) = 65.1, 154.3. A
    # little lower, because the constant of the polls is the same in all eight and is uniform.
    assert 55.0 < total < 154.3


def test_noise_free_data_recover_the_truth(simulate: Simulate) -> None:
    rig = simulate(3, noise=0.0)
    result = fit(rig)
    assert np.allclose(result.gain, rig.gain, atol=3e-4)
    assert np.allclose(result.bias_rad_s, rig.bias_rad_s, atol=1e-5)
    assert result.rms_after_rad_s < 0.05 * result.rms_before_rad_s


def test_pan_at_one_tilt_leaves_roll_unobservable(simulate: Simulate) -> None:
    rig = simulate(1, tilts=(0, 400, 0, 400, 0))
    rate = rig.rate_rad_s
    result = fit(simulate(1, tilts=(0,)), None)
    assert rate.shape[1] == 3
    assert {"scale.y", "scale.x"} <= set(result.observability.unobservable)
    assert np.isnan(result.gain[:, 1]).all()
    assert np.isfinite(result.gain[:, 2]).all()
    assert any("at only one tilt angle" in reason for reason in result.observability.reasons)
    assert all(np.isfinite(result.value(f"bias.{a}")) for a in "xyz")
    assert result.observability.rank == 6


def test_outliers_do_not_bias_the_fit(simulate: Simulate) -> None:
    rig = simulate(2)
    rng = np.random.default_rng(0)
    spiked = rig.rate_rad_s.copy()
    hit = rng.choice(spiked.shape[0], spiked.shape[0] // 100, replace=False)
    spiked[hit, rng.integers(0, 3, hit.size)] += rng.choice([-1.0, 1.0], hit.size) * 256 * 1.5e-4
    clean, with_outliers = fit(rig), fit(rig, spiked)
    assert with_outliers.outliers > 0.9 * hit.size
    for name in clean.order:
        shift = abs(with_outliers.value(name) - clean.value(name))
        assert shift < 0.5 * clean.std[name]
        assert with_outliers.std[name] < 1.05 * clean.std[name]


def test_noise_levels_are_found(simulate: Simulate) -> None:
    """The simulated density is 5.2e-4 rad/s/sqrt(Hz) white."""
    noise = fit(simulate(4)).noise
    assert noise is not None
    assert np.allclose(noise.angle_random_walk, 5.2e-4, rtol=0.06)
