"""Allan deviation, angle error and clock traces of the report, against closed forms."""

import numpy as np
import pytest

from gyrorig_solver.data.clocks.clock_trace import trace_clock
from gyrorig_solver.report import integration_error

RNG = np.random.default_rng(20260601)


def plainly(rate: np.ndarray, m: int) -> float:
    """The overlapping Allan deviation by its definition, IEEE Std 952 Annex C, in a loop."""
    means = [rate[k : k + m].mean() for k in range(len(rate) - m + 1)]
    steps = [means[k + m] - means[k] for k in range(len(means) - m)]
    return float(np.sqrt(0.5 * np.mean(np.square(steps))))


def test_allan_deviation_matches_its_definition() -> None:
    rate = np.cumsum(RNG.normal(size=(300, 3)), axis=0)
    tau_s, deviation = integration_error.allan_deviation(rate, 0.5)
    for tau, row in zip(tau_s, deviation, strict=True):
        for axis in range(3):
            assert row[axis] == pytest.approx(plainly(rate[:, axis], round(tau / 0.5)), rel=1e-9)


def test_allan_deviation_of_white_noise() -> None:
    step_s, density = 0.01, 5e-4  # one-sided: variance of a sample is density^2 / (2 step)
    rate = RNG.normal(scale=density / np.sqrt(2.0 * step_s), size=(40_000, 3))
    tau_s, deviation = integration_error.allan_deviation(rate, step_s)
    early = tau_s < 2.0
    modelled = integration_error.modelled_allan_deviation(tau_s, density, None, None)
    np.testing.assert_allclose(deviation[early].mean(axis=1), modelled[early], rtol=0.06)


def test_allan_deviation_of_a_random_walk() -> None:
    step_s, walk = 0.1, 1e-4
    rate = np.cumsum(RNG.normal(scale=walk * np.sqrt(step_s), size=(40_000, 3)), axis=0)
    tau_s, deviation = integration_error.allan_deviation(rate, step_s)
    middle = (tau_s > 2.0) & (tau_s < 40.0)
    modelled = integration_error.modelled_allan_deviation(tau_s, None, None, walk)
    assert middle.sum() > 5
    np.testing.assert_allclose(deviation[middle].mean(axis=1), modelled[middle], rtol=0.12)


def test_gaps_are_ignored() -> None:
    rate = RNG.normal(size=(5000, 3))
    whole = integration_error.allan_deviation(rate, 1.0)[1]
    rate[1000:1200] = np.nan
    holed = integration_error.allan_deviation(rate, 1.0)[1]
    assert np.isfinite(holed).all()
    np.testing.assert_allclose(holed[:20], whole[:20], rtol=0.1)


def test_angle_error_of_a_constant_rate_error() -> None:
    error = np.tile([0.0, 0.003, 0.004], (1000, 1))
    length_s, angle = integration_error.angle_error(error, 0.01)
    np.testing.assert_allclose(angle, 0.005 * length_s, rtol=1e-9)
    assert length_s[-1] == pytest.approx(2.0)


def test_uniform_grid_of_segments_with_gaps() -> None:
    time_s = np.concatenate([np.arange(10) * 0.1, 2.0 + np.arange(10) * 0.1])
    step_s, values = integration_error.to_uniform_grid(time_s, np.arange(60.0).reshape(20, 3))
    assert step_s == pytest.approx(0.1)
    assert values.shape == (30, 3)
    assert np.isnan(values[10:20]).all()
    assert values[20, 0] == 30.0
    far = np.concatenate([np.arange(10) * 0.1, 1e6 + np.arange(10) * 0.1])
    assert integration_error.to_uniform_grid(far, np.ones((20, 3)))[1].shape == (20, 3)


def test_clock_trace_has_latency_and_wander() -> None:
    number = np.arange(7000)
    wander = 1e-5 * np.sin(number / 1000.0)
    time_s = 0.01 * number + wander
    late = np.full(7000, 1e-3)
    late[3500] = 0.2
    trace = trace_clock(time_s, time_s + late, number, np.zeros(7000, dtype=np.int64))
    assert trace is not None
    assert trace.max_latency_s.max() == pytest.approx(0.2)
    assert trace.min_latency_s.max() == pytest.approx(1e-3)
    line = np.polyval(np.polyfit(number, time_s, 1), number)
    wanted = (time_s - line).reshape(350, 20).mean(axis=1)
    np.testing.assert_allclose(trace.wander_s, wanted, atol=2e-7)


def test_clock_trace_after_a_reset_uses_the_longest_run() -> None:
    number = np.concatenate([np.arange(1000), np.arange(3000)])
    segment = np.repeat([0, 1], [1000, 3000])
    time_s = np.arange(4000, dtype=np.float64) * 0.01
    trace = trace_clock(time_s, time_s, number, segment)
    assert trace is not None
    assert np.isnan(trace.wander_s[:80]).all()
    assert np.nanmax(np.abs(trace.wander_s)) < 1e-9
    assert trace_clock(time_s[:3], time_s[:3], number[:3], segment[:3]) is None
