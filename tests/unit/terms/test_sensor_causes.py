"""Causes inside the sensor, each against the sensor's chain simulated in fine steps."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.model import find_term, why_not_computable

Rate = Callable[[np.ndarray], np.ndarray]


def close(ours: np.ndarray, theirs: np.ndarray, share: float) -> None:
    assert np.linalg.norm(theirs) > 0.0
    assert np.linalg.norm(ours - theirs) < share * np.linalg.norm(theirs)


def added(rig: Any, more: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """What is measured more if `more(time, rate)` is added to the rate at the sensor."""

    def rate(time_s: np.ndarray) -> np.ndarray:
        without = rig.base()(time_s)
        return np.asarray(without + more(time_s, without))

    return np.asarray(rig.difference(rate))


SIZES = np.array([0.01, -0.02, 0.005])


def test_quadratic(rig: Any) -> None:
    ours = find_term("scale_quadratic").effect(rig.scene, SIZES)
    close(ours, added(rig, lambda t, w: SIZES * w**2), 5e-3)


def test_cubic(rig: Any) -> None:
    ours = find_term("scale_cubic").effect(rig.scene, SIZES)
    close(ours, added(rig, lambda t, w: SIZES * w**3), 5e-3)


def test_asymmetry_is_two_scales(rig: Any) -> None:
    ours = find_term("scale_asymmetry").effect(rig.scene, SIZES)
    close(ours, added(rig, lambda t, w: np.where(w > 0.0, SIZES * w, -SIZES * w)), 5e-3)


def test_dead_zone(rig: Any) -> None:
    width = np.array([0.3, 0.1, 0.5])
    ours = find_term("dead_zone").effect(rig.scene, width)

    def lost(time_s: np.ndarray, rate: np.ndarray) -> np.ndarray:
        return np.where((rate > -width) & (rate < width), -rate, 0.0)

    close(ours, added(rig, lost), 0.01)


@pytest.mark.parametrize("limit", [0.9, 0.5])
def test_saturation(rig: Any, limit: float) -> None:
    scene = rig.scene
    ours = find_term("saturation").effect(
        scene, np.array([1.0 - limit / scene.context.full_scale_rad_s])
    )
    bias = scene.bias_rad_s

    def cut(rate: np.ndarray) -> np.ndarray:
        return np.asarray(np.minimum(np.maximum(rate + bias, -limit), limit) - bias)

    close(ours, rig.measured(rig.base(), output=cut) - rig.measured_base, 0.02)


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.3])
def test_another_low_pass(rig: Any, factor: float) -> None:
    ours = find_term("low_pass_lag").effect(rig.scene, np.array([np.log(factor)]))
    # What it is slower by, sqrt(2)/omega, is the time offset's.
    slower_s = np.sqrt(2.0) / (2.0 * np.pi * 50.0) * (1.0 / factor - 1.0)
    later = rig.measured(
        rig.base(), bandwidth_hz=50.0 * factor, taken_s=lambda time_s: time_s + slower_s
    )
    close(ours, later - rig.measured_base, 0.02)


def test_a_low_pass_that_is_not_known(rig: Any) -> None:
    assert why_not_computable(find_term("low_pass_lag"), [rig.scene]) is None


def test_vibration(rig: Any) -> None:
    def shaken(time_s: np.ndarray, rate: np.ndarray) -> np.ndarray:
        speed = (
            np.gradient(rig.pan(time_s), time_s) ** 2 + np.gradient(rig.tilt(time_s), time_s) ** 2
        )
        return np.asarray(np.multiply.outer(speed, SIZES))

    close(find_term("vibration_rectification").effect(rig.scene, SIZES), added(rig, shaken), 5e-3)


def test_motors(rig: Any) -> None:
    pan, tilt = SIZES, SIZES[::-1]

    def run(time_s: np.ndarray, rate: np.ndarray) -> np.ndarray:
        runs = [np.abs(np.gradient(f(time_s), time_s)) > 1e-9 for f in (rig.pan, rig.tilt)]
        return np.asarray(np.multiply.outer(runs[0], pan) + np.multiply.outer(runs[1], tilt))

    ours = find_term("motor_coupling").effect(rig.scene, np.concatenate([pan, tilt]))
    close(ours, added(rig, run), 0.02)


def test_warm_up(rig: Any) -> None:
    ours = find_term("warm_up").effect(rig.scene, np.array([*SIZES, 12.0]))
    close(ours, added(rig, lambda t, w: np.multiply.outer(np.exp(-t / 12.0), SIZES)), 1e-3)


def test_ramp(rig: Any) -> None:
    ours = find_term("bias_ramp").effect(rig.scene, SIZES)
    theirs = added(rig, lambda t, w: np.multiply.outer(t - 15.0, SIZES))
    close(ours, theirs, 1e-3)


@pytest.mark.parametrize("at_s", [7.0, 12.3456])
def test_step(rig: Any, at_s: float) -> None:
    ours = find_term("bias_step").effect(rig.scene, np.array([*SIZES, at_s]))
    close(ours, added(rig, lambda t, w: np.multiply.outer(t >= at_s, SIZES)), 5e-3)


@pytest.mark.parametrize("frequency_hz", [3.0, 50.0, 117.0])
def test_hum_is_aliased_by_sampling(rig: Any, frequency_hz: float) -> None:
    scene = rig.scene
    values = np.array([*SIZES, *SIZES[::-1], frequency_hz])
    phase = 2 * np.pi * frequency_hz * rig.sample_times_s
    wave = np.multiply.outer(np.cos(phase), SIZES) + np.multiply.outer(np.sin(phase), SIZES[::-1])
    theirs = wave.reshape(-1, 2, 3).mean(axis=1)
    close(find_term("supply_hum").effect(scene, values), theirs, 1e-9)


def test_hum_templates_match_the_resolution(rig: Any) -> None:
    bank = find_term("supply_hum").template_bank(rig.scene)
    lines = np.sort(bank[:, -1])
    near = lines[(lines > 49.0) & (lines < 51.0)]
    assert np.max(np.diff(near)) <= 0.5 / 30.0 + 1e-9


def test_jitter_variance_matches_simulation(rig: Any) -> None:
    """Samples really taken at scattered times, many times over."""
    deviation, rng = 2e-3, np.random.default_rng(4)
    rate, edges = rig.scene.filtered_rad_s, rig.scene.time_s
    runs = []
    for _ in range(60):
        at = rig.sample_times_s + rng.normal(0.0, deviation, rig.sample_times_s.size)
        taken = np.stack([np.interp(at, edges, axis) for axis in rate.T], axis=1)
        runs.append(taken.reshape(-1, 2, 3).mean(axis=1))
    theirs = np.var(runs, axis=0)
    ours = find_term("sample_jitter").added_variance(rig.scene, np.array([deviation]))  # type: ignore[attr-defined]
    assert np.sum(theirs) == pytest.approx(np.sum(ours), rel=0.1)
    # Away from any edge there is none.
    quiet = np.convolve(np.sum(ours, axis=1) > 1e-14, np.ones(5), "same") < 0.5
    assert quiet.any()
    assert np.all(theirs[quiet] < 1e-9)


def test_random_walk_density_matches_simulation() -> None:
    rng = np.random.default_rng(5)
    level, rate_hz, n = 0.02, 50.0, 4096
    window = np.hanning(n)
    power = np.zeros(n // 2 + 1)
    for _ in range(200):
        walk = np.cumsum(rng.normal(0.0, level / np.sqrt(rate_hz), n))
        walk -= np.polyval(np.polyfit(np.arange(n), walk, 1), np.arange(n))
        power += np.abs(np.fft.rfft(walk * window)) ** 2
    density = 2.0 * power / 200 / rate_hz / np.sum(window**2)
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    band = (f > 0.2) & (f < 2.0)
    ours = find_term("bias_random_walk").density(f[band], np.full(3, level))[:, 0]  # type: ignore[attr-defined]
    assert np.mean(density[band] / ours) == pytest.approx(1.0, abs=0.1)
