"""Solves with reference attitudes contain what the search names, and several recordings."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.reference_recordings import BOARD, SimulatedGyro, record_attitudes

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import CalibrationDocument, CalibrationStore
from gyrorig_solver.model import factorise
from gyrorig_solver.pipeline import solve_and_store
from gyrorig_solver.pipeline.explain_board import build_document, explain_board

pytestmark = pytest.mark.long

CUBIC = 0.002  # s^2/rad^2
GYRO = SimulatedGyro()
CUBIC_GYRO = SimulatedGyro(error=lambda _time, rate, _force: CUBIC * rate**3)
FACTORS = ("scale", "nonorthogonality", "misalignment")


@pytest.fixture(scope="module")
def cubic(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A recording of a gyro whose error grows with the cube of the rate."""
    path = tmp_path_factory.mktemp("cubic") / "cubic.mcap"
    return read_recording(record_attitudes(path, CUBIC_GYRO, 3))


def solve(recordings: list[Recording], out: Path, *extend: str) -> CalibrationDocument:
    return solve_and_store(
        CalibrationStore(out), recordings, BoardId(BOARD), extend=extend
    ).calibration


def largest_sigma(calibration: CalibrationDocument) -> float:
    """Return the largest error of a factor of the gain, in standard uncertainties."""
    truth = np.split(factorise(GYRO.gain).as_vector(), 3)
    errors = []
    for name, true_values in zip(FACTORS, truth, strict=True):
        parameter: Any = calibration.parameters[name]
        errors.append(np.abs(np.array(parameter.value) - true_values) / np.array(parameter.std))
    return float(np.max(errors))


def test_auto_fits_the_cause_that_it_names(cubic: Recording, tmp_path: Path) -> None:
    plain = solve([cubic], tmp_path / "plain")
    auto = solve([cubic], tmp_path / "auto", "auto")
    assert auto.findings is not None
    assert auto.findings.causes == ["scale_cubic"]
    assert "scale_cubic" in auto.solver.terms
    assert plain.trust.verdict != "good"
    assert largest_sigma(auto) < 4.0
    scale = np.array(auto.parameters["scale"].std) / np.array(plain.parameters["scale"].std)
    assert scale.max() < 0.2  # the cause is not in the noise
    coefficient: Any = auto.parameters["scale_cubic"]
    error = np.array(coefficient.value) - CUBIC
    assert np.abs(error / np.array(coefficient.std)).max() < 4.0


def test_a_requested_cause_is_fitted(cubic: Recording, tmp_path: Path) -> None:
    calibration = solve([cubic], tmp_path, "scale_cubic")
    assert "scale_cubic" in calibration.solver.terms
    assert largest_sigma(calibration) < 4.0


def test_explain_states_both_calibrations(cubic: Recording, tmp_path: Path) -> None:
    """Before is the solve without the cause, after is the solve with it."""
    findings = build_document(explain_board([cubic], BoardId(BOARD)))
    for extend, column in (((), "before"), (("auto",), "after")):
        calibration = solve([cubic], tmp_path / column, *extend)
        for change in findings.effect_on_calibration:
            name, _, axis = change.parameter.partition(".")
            if name == "scale":
                value: Any = calibration.parameters[name].value
                stated = getattr(change, column)
                assert stated == pytest.approx(
                    value["xyz".index(axis)], abs=0.01 * (change.std or 0.0)
                )


def test_each_recording_has_its_bias_and_delay(tmp_path: Path) -> None:
    other = replace(GYRO, bias_rad_s=(-0.03, 0.04, 0.02))
    paths = [
        record_attitudes(tmp_path / "one.mcap", GYRO, 1),
        record_attitudes(tmp_path / "two.mcap", other, 2),
    ]
    calibration = solve([read_recording(path) for path in paths], tmp_path / "out", "auto")
    assert largest_sigma(calibration) < 4.0
    recordings = calibration.quality.recordings
    assert recordings is not None
    for recording, gyro in zip(recordings, (GYRO, other), strict=True):
        error = np.array(recording.bias) - np.array(gyro.bias_rad_s)
        assert np.abs(error / np.array(recording.bias_std)).max() < 4.0
    assert calibration.parameters["bias"].value == recordings[-1].bias
