"""The drift between two clocks, from errors of the time offset in windows: the models compared."""

import numpy as np
import pytest

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.attitude.lag_drift import LagDrift, fit_drift

WINDOWS, NOISE_S = 90, 2e-4


def drift_of(error_s: FloatArray, seed: int) -> LagDrift:
    """Return the drift that is fitted to errors with noise, of windows of 1 s, (90,)."""
    noise_s = NOISE_S * np.random.default_rng(seed).normal(size=WINDOWS)
    return fit_drift(times_s(), error_s + noise_s, np.full(WINDOWS, NOISE_S**-2.0))


def times_s() -> FloatArray:
    return 0.5 + np.arange(WINDOWS, dtype=np.float64)


def sawtooth_s(step_s: float, period_s: float, first_s: float) -> FloatArray:
    """Return the means of the error of a clock that gains a step per period, and is set back."""
    fine_s = times_s()[:, None] + (np.arange(50) + 0.5) / 50.0 - 0.5
    turns = (fine_s - first_s) / period_s
    return np.asarray(step_s * np.mean(turns - np.floor(turns) - 0.5, axis=1), dtype=np.float64)


@pytest.mark.parametrize(("step_s", "period_s"), [(0.01, 20.0), (-0.004, 9.3), (0.002, 31.0)])
def test_equal_steps_at_regular_intervals_are_a_saw_tooth(step_s: float, period_s: float) -> None:
    drift = drift_of(sawtooth_s(step_s, period_s, 7.3), 1)
    assert drift.sawtooth is not None
    assert drift.step_time_s == ()
    assert drift.sawtooth.period_s == pytest.approx(period_s, rel=0.01)
    assert drift.sawtooth_rate == pytest.approx(step_s / period_s, rel=0.05)
    distance_s = (drift.sawtooth.correction_s - 7.3) / drift.sawtooth.period_s
    assert abs(distance_s - round(distance_s)) < 0.03
    assert drift.step_std_s == pytest.approx(abs(step_s) / 2.0, rel=0.05)


def test_a_saw_tooth_and_a_line_and_a_step_are_told_apart() -> None:
    other_s = 5e-5 * times_s() + 0.03 * (times_s() > 41.0)
    drift = drift_of(sawtooth_s(0.01, 15.0, 4.0) + other_s, 2)
    assert drift.sawtooth is not None
    assert drift.sawtooth.period_s == pytest.approx(15.0, rel=0.01)
    assert drift.skew == pytest.approx(5e-5, abs=1e-5)
    assert [round(at_s) for at_s in drift.step_time_s] == [41]
    assert drift.step_s[0] == pytest.approx(0.03, rel=0.02)


@pytest.mark.parametrize(
    "error_s",
    [
        np.zeros(WINDOWS),
        1e-4 * np.arange(WINDOWS),
        0.01 * (np.arange(WINDOWS) > 30),
        1e-4 * np.arange(WINDOWS) - 0.01 * (np.arange(WINDOWS) > 50),
        # Steps of different sizes at irregular times.
        0.01 * (np.arange(WINDOWS) > 20) + 0.004 * (np.arange(WINDOWS) > 64),
    ],
    ids=["none", "line", "step", "line and step", "two steps"],
)
def test_lines_and_single_steps_are_no_saw_tooth(error_s: FloatArray) -> None:
    assert not any(drift_of(error_s, seed).sawtooth for seed in range(20))


def test_the_correction_removes_the_error() -> None:
    error_s = sawtooth_s(0.01, 20.0, 7.3) + 1e-4 * times_s()
    drift = drift_of(error_s, 3)
    rest_s = error_s - drift.at(times_s())
    inside = np.abs((times_s() - 7.3) / 20.0 % 1.0 - 0.5) < 0.45  # not at a correction
    assert np.std(rest_s[inside]) < 0.5 * NOISE_S
    assert drift.cuts(times_s()).sum() == 5
