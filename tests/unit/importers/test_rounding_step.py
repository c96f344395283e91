"""The step to which a source rounded its rates, and the bias of a board with little noise."""

from pathlib import Path

import numpy as np
import pytest
from tests.unit.importers.test_import_measurements import BASE, archive, mapped

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.estimate.rest_mean import measure_rest
from gyrorig_solver.importers import import_measurements
from gyrorig_solver.importers.sample_encoding import find_rounding_step
from gyrorig_solver.reference.known_turns import TimeInterval

STEP_RAD_S = float(np.radians(1.0 / 131.0))  # MPU-6050, full scale 250 deg/s
BIAS_RAD_S = np.radians([0.8, -1.2, 0.5])


def at_rest(noise_steps: float, rows: int = 4000) -> np.ndarray:
    noise = np.random.default_rng(3).normal(size=(rows, 3)) * noise_steps * STEP_RAD_S
    return BIAS_RAD_S + noise


def rounded(rate_rad_s: np.ndarray) -> np.ndarray:
    return np.rint(rate_rad_s / STEP_RAD_S) * STEP_RAD_S


@pytest.mark.parametrize("digits", [6, 9, 15])
def test_the_step_of_the_sensor_is_seen_through_the_digits_of_a_table(digits: int) -> None:
    texts = np.round(np.degrees(rounded(at_rest(0.3))), digits)
    step_rad_s = find_rounding_step(np.radians(texts) - 0.0123)  # a zero that the logger subtracts
    assert step_rad_s == pytest.approx(STEP_RAD_S, rel=1e-3)


def test_a_source_that_rounds_twice_has_the_mean_of_its_steps() -> None:
    """Steps of 0.0175 deg/s with two digits are 0.01 and 0.02 deg/s."""
    rate_dps = np.round(0.0175 * np.rint(np.degrees(at_rest(2.0)) / 0.0175), 2)
    step_rad_s = find_rounding_step(np.radians(rate_dps))
    assert step_rad_s == pytest.approx(np.radians(0.0175), rel=0.2)


def test_rates_without_equal_values_have_no_step() -> None:
    assert find_rounding_step(at_rest(0.3)) is None
    motion = np.sin(np.arange(4000)[:, None] / [70.0, 80.0, 90.0])
    assert find_rounding_step(rounded(motion + at_rest(0.3))) is None


def test_a_knock_and_a_stuck_axis_do_not_enlarge_the_step() -> None:
    rate = rounded(at_rest(0.3))
    rate[:, 1] = 0.0
    rate[100] += 3.0
    assert find_rounding_step(rate) == pytest.approx(STEP_RAD_S, rel=1e-6)


def test_the_bias_of_a_rounded_table_has_the_uncertainty_of_a_step(tmp_path: Path) -> None:
    """Before, the bias differed by 1000 standard uncertainties from the true one."""
    rate = np.radians(np.round(np.degrees(rounded(at_rest(0.2))), 6))
    source = archive(tmp_path / "in.npz", t=1.0 + np.arange(len(rate)) / 100.0, g=rate)
    recording = import_measurements(source, mapped(BASE), tmp_path / "out.mcap").path
    samples = load_samples(read_recording(recording), "B1")
    assert samples.quantum_rad_s == pytest.approx(STEP_RAD_S, rel=1e-3)
    assert samples.rate_rad_s == pytest.approx(rate, abs=1e-7)
    rest = measure_rest(samples, TimeInterval(0.0, 60.0))
    assert np.all(np.abs(rest.rate_rad_s - BIAS_RAD_S) < 2.0 * rest.std_rad_s)
    assert rest.std_rad_s == pytest.approx(STEP_RAD_S / np.sqrt(12.0), rel=0.1)


def test_an_axis_without_any_change_of_its_counts_is_solved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before, a division by zero printed a warning of NumPy."""
    counts = np.rint(at_rest(0.065, rows=20_000) / STEP_RAD_S)
    assert np.ptp(counts, axis=0).tolist() == [0.0, 0.0, 1.0]
    text = BASE.replace("unit: rad/s", f"unit: counts, scale_rad_s: {STEP_RAD_S!r}")
    source = archive(tmp_path / "in.npz", t=1.0 + np.arange(len(counts)) / 100.0, g=counts)
    mapping = mapped(text + "static: [{}]\n")
    recording = import_measurements(source, mapping, tmp_path / "out.mcap").path
    out = tmp_path / "calibrations"
    assert cli.run(["solve", str(recording), "--out", str(out)]) == 4
    assert capsys.readouterr().err == ""


def test_the_ends_of_a_clipped_motion_are_no_step() -> None:
    """Before, the step was the whole range of the sensor, 1.6 rad/s."""
    motion = np.sin(np.arange(4000)[:, None] / [70.0, 80.0, 90.0]) + at_rest(0.3)
    clipped = np.clip(motion, -0.5, 0.5)
    assert np.mean(np.abs(clipped) == 0.5) > 0.5
    assert find_rounding_step(clipped) is None
