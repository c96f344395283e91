"""Each cause in the sensor changes the samples as its formula says, by hand for steady rates."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from tests.bench.rigs.rig import SimulatedRig
from tests.bench.rigs.trial import stated_truth

SETTLED_SAMPLES = 41  # about a sample in which a steady rate does not change


def pure_rate(plain: SimulatedRig) -> np.ndarray:
    """Return G omega of each sample, without bias."""
    truth = plain.stream_truth
    return np.asarray(truth.clean_rad_s - plain.gyroscope.bias_rad_s)


def change(plain: SimulatedRig, other: SimulatedRig) -> np.ndarray:
    return np.asarray(other.stream_truth.clean_rad_s - plain.stream_truth.clean_rad_s)


def steady(plain: SimulatedRig, axis: int) -> np.ndarray:
    """Return a mask of samples in motion whose rate is constant about them."""
    rate = pure_rate(plain)[:, axis]
    span = maximum_filter1d(rate, SETTLED_SAMPLES) - minimum_filter1d(rate, SETTLED_SAMPLES)
    is_steady = (span < 1e-5) & (np.abs(rate) > 0.1)
    assert is_steady.sum() > 10
    return np.asarray(is_steady)


def since_begin_s(plain: SimulatedRig) -> np.ndarray:
    return np.asarray(plain.stream_truth.sample_s - plain.stream_truth.sample_s[0])


@pytest.mark.parametrize(
    ("cause", "size", "effect"),
    [
        ("scale_quadratic", 0.02, lambda u: u**2),
        ("scale_cubic", -0.03, lambda u: u**3),
        ("scale_asymmetry", 0.01, np.abs),
    ],
)
def test_non_linearity_adds_its_function_of_the_rate(
    plain: SimulatedRig, record: Any, cause: str, size: float, effect: Callable[..., Any]
) -> None:
    seen = change(plain, record({cause: {"z": size}}))
    at, u = steady(plain, 2), pure_rate(plain)[:, 2]
    assert seen[at, 2] == pytest.approx(size * effect(u[at]), rel=1e-3)
    assert np.all(seen[:, 0] == 0.0)


def test_dead_band_removes_small_rates(plain: SimulatedRig, record: Any) -> None:
    width = 1.1 * float(np.max(np.abs(pure_rate(plain)[:, 1])))
    other = record({"dead_zone": {"y": width}})
    bias = other.gyroscope.bias_rad_s
    assert other.stream_truth.clean_rad_s[:, 1] == pytest.approx(bias[1], abs=1e-9)
    assert np.array_equal(change(plain, other)[:, 2], np.zeros_like(bias[2] + since_begin_s(plain)))


def test_saturation_limits_the_output(record: Any) -> None:
    other = record({"saturation": {"size": 0.9}})
    limit = 0.1 * np.radians(250.0)
    assert np.max(np.abs(other.stream_truth.clean_rad_s)) == pytest.approx(limit)
    assert np.max(np.abs(other.stream.gyro)) * other.gyroscope.quantum_rad_s < 1.01 * limit


def test_low_pass_error_delays_by_its_change_of_the_group_delay(
    plain: SimulatedRig, record: Any
) -> None:
    other = record({"low_pass_lag": {"size": -0.5}})
    nominal_s = np.sqrt(2.0) / (2.0 * np.pi * plain.gyroscope.bandwidth_hz)
    expected_s = nominal_s * (np.exp(0.5) - 1.0)
    time_s = since_begin_s(plain)
    # The centroid of the first move's rate moves by the delay.
    first = plain.stream_truth.sample_s < plain.session.moves[0].end_s + 0.5
    u0, u1 = (np.where(first, pure_rate(rig)[:, 2], 0.0) for rig in (plain, other))
    seen_s = (time_s @ u1) / u1.sum() - (time_s @ u0) / u0.sum()
    assert seen_s == pytest.approx(expected_s, rel=0.02)
    assert other.truth[12] - plain.truth[12] == pytest.approx(expected_s)


def test_g_sensitivity_follows_gravity_in_the_stage_frame(plain: SimulatedRig, record: Any) -> None:
    other = record({"g_sensitivity": {"xy": 1e-3, "zz": 2e-3}})
    seen, last = change(plain, other), -20
    tilt = np.radians(25.0)  # of the last rest; the base leans by less than a degree
    assert seen[last, 0] == pytest.approx(1e-3 * 9.80665 * np.sin(tilt), rel=0.05)
    assert seen[last, 2] == pytest.approx(2e-3 * 9.80665 * np.cos(tilt), rel=0.02)
    assert seen[5, 0] == pytest.approx(0.0, abs=3e-4)
    assert other.truth[:3] - plain.truth[:3] == pytest.approx(seen.mean(axis=0), abs=2e-5)


def test_motors_shift_the_bias_while_they_run(plain: SimulatedRig, record: Any) -> None:
    vibration = change(plain, record({"vibration_rectification": {"x": 0.01}}))[:, 0]
    coupling = change(plain, record({"motor_coupling": {"x": -0.002}}))[:, 0]
    at = steady(plain, 2)
    speed = np.linalg.norm(np.linalg.solve(plain.gyroscope.gain, pure_rate(plain)[at].T), axis=0)
    assert vibration[at] == pytest.approx(0.01 * speed**2, rel=0.01)
    assert coupling[at] == pytest.approx(-0.002)
    assert vibration[5] == pytest.approx(0.0, abs=1e-9)
    assert coupling[5] == pytest.approx(0.0, abs=1e-9)


def test_temperature_changes_bias_and_scale(plain: SimulatedRig, record: Any) -> None:
    since, warming = since_begin_s(plain), plain.gyroscope.warming
    end_s = plain.session.end_s - 0.8
    die = warming.die_degc(since, end_s)
    bias = change(plain, record({"thermal_bias": {"y": 0.01, "lag_s": 20.0}}))
    assert bias[:, 1] == pytest.approx(0.01 * (die - 25.0), abs=1e-9)
    scale = change(plain, record({"thermal_scale": {"z": 0.1}}))
    at, u = steady(plain, 2), pure_rate(plain)[:, 2]
    # The room warms by up to 4 K/s here, and the low-pass shows the rate of some time before.
    assert scale[at, 2] / u[at] == pytest.approx(0.1 * (die - die.mean())[at], abs=6e-3)


def test_stated_bias_is_without_the_causes_that_a_calibration_contains(
    plain: SimulatedRig, record: Any
) -> None:
    """y = G omega + b + causes: b is that of the rig without them, at the thermometer's mean."""
    causes = {
        "g_sensitivity": {"zz": 2e-3},
        "warm_up": {"x": 0.01, "time_s": 3.0},
        "bias_step": {"z": -0.01, "at": 0.25},
        "thermal_bias": {"y": 0.01, "lag_s": 20.0},
    }
    other = record(causes)
    parts = other.stream_truth.bias_parts_rad_s
    stated = np.array(stated_truth(other.truth.tolist(), parts, list(causes)))
    mean_degc = np.mean(other.stream.temperature) * 0.1 + 25.0
    expected = plain.truth[:3] + np.array([0.0, 0.01 * (mean_degc - 25.0), 0.0])
    assert stated[:3] == pytest.approx(expected, abs=0.01 * 0.05)  # rounded to 0.1 K
    assert stated[3:].tolist() == other.truth[3:].tolist()
    assert stated_truth(other.truth.tolist(), parts, ["ringing"]) == other.truth.tolist()


def test_slow_changes_of_the_bias(plain: SimulatedRig, record: Any) -> None:
    since = since_begin_s(plain)
    span_s = plain.session.end_s - 0.8
    warm = change(plain, record({"warm_up": {"x": 0.01, "time_s": 3.0}}))
    assert warm[:, 0] == pytest.approx(0.01 * np.exp(-since / 3.0))
    ramp = change(plain, record({"bias_ramp": {"x": 1e-3}}))
    assert ramp[:, 0] == pytest.approx(1e-3 * (since - span_s / 2.0))
    step = change(plain, record({"bias_step": {"z": -0.01, "at": 0.5}}))
    assert step[:, 2] == pytest.approx(np.where(since >= span_s / 2.0, -0.01, 0.0))
    walk = change(plain, record({"bias_random_walk": {"y": 1e-3}}))[:, 1]
    rate_hz = plain.gyroscope.odr_hz
    assert np.std(np.diff(walk)) == pytest.approx(1e-3 / np.sqrt(rate_hz), rel=0.1)


def test_hum_is_a_line_at_its_frequency(plain: SimulatedRig, record: Any) -> None:
    other = record({"supply_hum": {"x": 0.01, "line_hz": 50.03, "phase": 0.4}})
    time_s = plain.stream_truth.sample_s
    wave = change(plain, other)[:, 0]
    turns = np.exp(-1j * (2.0 * np.pi * 50.03 * time_s + 0.4))
    expected = 0.01 * np.sin(2.0 * np.pi * 50.03 * time_s + 0.4)
    assert wave == pytest.approx(expected, abs=1e-12)
    assert abs(np.mean(wave * turns)) > 0.004
