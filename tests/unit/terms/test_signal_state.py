"""The scene's chain against a continuous-time simulation, and its grids against each other."""

from typing import Any

import numpy as np
import pytest

from gyrorig_solver.model import BoardTemperature, SignalState


def test_block_means_match_a_simulated_sensor(rig: Any) -> None:
    scene = rig.scene
    ours, theirs = scene.measure_stage_rate(scene.rate_rad_s), rig.measured(rig.base())
    # The digital filter is the bilinear one: 1 % of the edges, at 1 kHz for 50 Hz.
    assert np.sqrt(np.mean((ours - theirs) ** 2)) < 2e-3 * np.sqrt(np.mean(theirs**2))


def test_part_with_a_lead_equals_the_whole_series(rig: Any) -> None:
    whole = rig.scene
    begin, lead = 500, 60  # blocks, instants
    first = (begin * whole.instants_per_block - lead) * whole.intervals_per_instant
    part = SignalState.build(
        whole.edges_s[first:],
        whole.angle_rad[:, first:],
        whole.used_instants[begin * whole.instants_per_block :],
        instants_per_block=whole.instants_per_block,
        intervals_per_instant=whole.intervals_per_instant,
        bandwidth_hz=whole.low_pass.bandwidth_hz,
        gain=whole.gain,
        context=whole.context,
    )
    assert part.lead_instants == lead
    whole_rate = whole.measure_stage_rate(whole.rate_rad_s)[begin:]
    assert np.allclose(part.measure_stage_rate(part.rate_rad_s), whole_rate, atol=1e-12)


def test_block_is_the_mean_of_used_instants(rig: Any) -> None:
    scene = rig.scene
    use = scene.used_instants.copy()
    use[0], use[2:4] = False, False
    partial = SignalState.build(
        scene.edges_s,
        scene.angle_rad,
        use,
        instants_per_block=2,
        intervals_per_instant=5,
        bandwidth_hz=None,
        gain=scene.gain,
    )
    values = np.random.default_rng(0).normal(size=(4, scene.interval_count, 3))
    block_rate = partial.measure_sensor_rate(values)
    assert block_rate.shape == (4, scene.block_count, 3)
    assert np.allclose(block_rate[:, 0], values[:, 7])
    assert np.all(block_rate[:, 1] == 0.0)
    assert np.allclose(block_rate[:, 2], (values[:, 22] + values[:, 27]) / 2.0)


def test_coarse_grid_gives_the_same_signal(rig: Any) -> None:
    scene = rig.scene
    per = 5  # intervals to a block of 10 fine ones
    coarse = SignalState.build(
        scene.edges_s[::2],
        scene.angle_rad[:, ::2],
        np.ones(scene.block_count * per, dtype=np.bool_),
        instants_per_block=per,
        intervals_per_instant=1,
        bandwidth_hz=50.0,
        gain=scene.gain,
    )
    fine_seen, seen = (s.measure_stage_rate(s.rate_rad_s) for s in (scene, coarse))
    assert np.sqrt(np.mean((seen - fine_seen) ** 2)) < 5e-3 * np.sqrt(np.mean(fine_seen**2))


def test_stage_rate_derivative_matches_finite_differences(rig: Any) -> None:
    scene = rig.scene
    wave = np.sin(3.0 * scene.edges_s)
    for axis in (0, 1):
        change = np.zeros_like(scene.angle_rad)
        change[axis] = 1e-5 * wave
        exact = (scene.stage_rate_change(change) - scene.stage_rate_change(-change)) / 2e-5
        assert np.allclose(scene.stage_rate_derivative(axis, wave), exact, atol=1e-6)


def test_temperature_readings_are_smoothed() -> None:
    time_s = np.arange(0.0, 1800.0, 0.01)
    true = 30.0 + 12.0 * np.exp(-(((time_s - 700.0) / 350.0) ** 2))
    readings = np.where(np.arange(time_s.size) % 100 == 0, np.round(true), np.nan)
    temperature = BoardTemperature.of(time_s, readings)
    assert temperature is not None
    inside = temperature.die_temperature_rise(np.arange(60.0, 1740.0, 1.0)) + temperature.mean_degc
    left = inside - np.interp(np.arange(60.0, 1740.0, 1.0), time_s, true)
    assert np.sqrt(np.mean(left**2)) < 0.2  # of a whole kelvin's steps, 0.29 before
    assert np.max(np.abs(np.diff(inside))) < 0.08  # no edges of 1 K


def test_too_few_readings_give_no_temperature() -> None:
    assert BoardTemperature.of(np.arange(9.0), np.full(9, np.nan)) is None


@pytest.mark.parametrize("tau_s", [5.0, 40.0])
def test_late_die_follows_the_heat_equation(tau_s: float) -> None:
    time_s = np.arange(0.0, 600.0, 1.0)
    heard = 20.0 + 5.0 * np.sin(2 * np.pi * time_s / 200.0)
    rise = BoardTemperature(time_s, heard, 20.0).die_temperature_rise(time_s, -tau_s)
    step, x, path = 0.01, 0.0, []
    for k, t in enumerate(np.arange(0.0, 600.0, step)):
        if k % 100 == 0:
            path.append(x)
        x += step * (5.0 * np.sin(2 * np.pi * t / 200.0) - x) / tau_s
    begun = round(8 * tau_s)
    assert rise[begun:] == pytest.approx(np.array(path)[begun:], abs=0.02)


def test_early_die_leads_the_thermometer() -> None:
    time_s = np.arange(0.0, 600.0, 1.0)
    true = np.sin(2 * np.pi * time_s / 300.0)
    late = BoardTemperature(time_s, true, 0.0).die_temperature_rise(time_s, -12.0)
    back = BoardTemperature(time_s, late, 0.0).die_temperature_rise(time_s, 12.0)
    assert back[100:500] == pytest.approx(true[100:500], abs=5e-3)
