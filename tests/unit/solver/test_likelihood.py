"""The fit against simulated truth: errors in units of what the fit itself claims."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.clocks import map_clock
from gyrorig_solver.estimate.motion import fit_motion
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.model.gain import factorise
from gyrorig_solver.reference.moves import Exchange, MotionReader
from gyrorig_solver.reference.polls import Polls, fit_starts
from gyrorig_solver.reference.ptu import PtuReference
from gyrorig_solver.samples import GyroSamples
from gyrorig_solver.solve import PTU_WORDS

RAD_PER_STEP = float(np.radians(185.142857 / 3600.0))
LOW_PASS_DELAY_S = np.sqrt(2.0) / (2.0 * np.pi * 25.0)  # Butterworth, second order, 25 Hz

Simulate = Callable[..., Any]


def reference_of(rig: Any) -> PtuReference:
    settings = {
        f"{a}_{k}": v
        for a in ("pan", "tilt")
        for k, v in (("base_speed", 0.0), ("acceleration", 4000.0))
    }
    exchanges = [Exchange(a, b, True, c) for a, b, c in rig.exchanges]
    first = (int(rig.poll_steps[0][0]), int(rig.poll_steps[0][1]))
    motion = MotionReader(settings, first).read(exchanges)
    valid = np.ones((rig.poll_lo_s.size, 2), dtype=np.bool_)
    polls = Polls(rig.poll_lo_s, rig.poll_hi_s, rig.poll_steps, valid)
    span = (float(rig.poll_lo_s[0]), float(rig.poll_hi_s[-1]))
    return PtuReference.of(motion, fit_starts(motion, polls), (RAD_PER_STEP, RAD_PER_STEP), span)


def samples_of(rig: Any, rate: np.ndarray | None = None) -> GyroSamples:
    n = rig.time_s.size
    ticks = np.rint(rig.time_s * 1e6).astype(np.int64)
    clock = map_clock(ticks, rig.time_s, 1e6, 64)
    return GyroSamples(
        board="B",
        metadata={"bandwidth_hz": "25"},
        origin_ns=0,
        time_s=clock.time_s,
        host_s=rig.time_s,
        number=np.arange(n),
        segment=clock.segment,
        rate_rad_s=rig.rate_rad_s if rate is None else rate,
        good=np.ones(n, np.bool_),
        accel_m_s2=None,
        temperature_degc=None,
        quantum_rad_s=1.527e-4,
        clock=clock,
        floor=None,
        lost=0,
        repeated=0,
        late=0,
    )


def fit(rig: Any, rate: np.ndarray | None = None) -> GyroFit:
    return fit_motion(samples_of(rig, rate), reference_of(rig), PTU_WORDS)


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


@pytest.mark.parametrize("off_count", [0.0, 0.5])
def test_errors_are_as_large_as_claimed(simulate: Simulate, off_count: float) -> None:
    """Eight boards: joint chi-squared inside its 99.8 % span; no parameter beyond 4 sigma.

    Once the unit rests exactly on its counts, once anywhere within them.
    """
    total = 0.0
    for seed in range(8):
        rig = simulate(seed, off_count=off_count)
        found = fit(rig)
        true = truth(rig)
        error = np.array([found.value(n) - true[n] for n in found.order])
        assert len(found.order) == 13
        assert found.identified
        z = error / np.sqrt(np.diag(found.covariance))
        assert np.abs(z).max() < 4.0
        total += float(error @ np.linalg.solve(found.covariance, error))
        assert (reference_of(rig).starts.rest_variance > 0.05 / 12.0) == (off_count > 0.0)
    # 8 x 13 degrees of freedom; scipy.stats.chi2.ppf([0.001, 0.999], 104) = 65.1, 154.3. A
    # little lower, because the constant of the polls is the same in all eight and is uniform.
    assert 55.0 < total < 154.3


def test_without_noise_the_truth_comes_back(simulate: Simulate) -> None:
    rig = simulate(3, noise=0.0)
    found = fit(rig)
    assert np.allclose(found.gain, rig.gain, atol=3e-4)
    assert np.allclose(found.bias_rad_s, rig.bias_rad_s, atol=1e-5)
    assert found.rms_after_rad_s < 0.05 * found.rms_before_rad_s


def test_pan_at_one_tilt_hides_the_roll_column(simulate: Simulate) -> None:
    rig = simulate(1, tilts=(0, 400, 0, 400, 0))
    rate = rig.rate_rad_s
    found = fit(simulate(1, tilts=(0,)), None)
    assert rate.shape[1] == 3
    assert {"scale.y", "scale.x"} <= set(found.observability.unobservable)
    assert np.isnan(found.gain[:, 1]).all()
    assert np.isfinite(found.gain[:, 2]).all()
    assert any("one tilt only" in reason for reason in found.observability.reasons)
    assert all(np.isfinite(found.value(f"bias.{a}")) for a in "xyz")
    assert found.observability.rank == 6


def test_spikes_cost_nothing(simulate: Simulate) -> None:
    rig = simulate(2)
    rng = np.random.default_rng(0)
    spiked = rig.rate_rad_s.copy()
    hit = rng.choice(spiked.shape[0], spiked.shape[0] // 100, replace=False)
    spiked[hit, rng.integers(0, 3, hit.size)] += rng.choice([-1.0, 1.0], hit.size) * 256 * 1.5e-4
    clean, found = fit(rig), fit(rig, spiked)
    assert found.outliers > 0.9 * hit.size
    for name in clean.order:
        shift = abs(found.value(name) - clean.value(name))
        assert shift < 0.5 * clean.std[name]
        assert found.std[name] < 1.05 * clean.std[name]


def test_noise_levels_are_found(simulate: Simulate) -> None:
    """The simulated density is 5.2e-4 rad/s/sqrt(Hz) white."""
    noise = fit(simulate(4)).noise
    assert noise is not None
    assert np.allclose(noise.angle_random_walk, 5.2e-4, rtol=0.06)
