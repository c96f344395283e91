"""The unit of the rates as the explanation of implausible scale factors."""

from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import BOARD, SimulatedGyro, record_turns

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration.calibration_document import Trust
from gyrorig_solver.calibration.plausibility import DataSheetConflict, add_conflicts
from gyrorig_solver.pipeline import fit_criticised, load_board


def reason_of(*scales: float) -> str:
    conflicts = [
        DataSheetConflict(f"scale.{axis}", scale, 1.0, 0.015, 1e-4)
        for axis, scale in zip("xyz", scales, strict=False)
    ]
    return add_conflicts(Trust(verdict="good", reasons=[]), conflicts, None).reasons[0]


@pytest.mark.parametrize(
    ("ratio", "unit"), [(np.degrees(1.0), "deg/s"), (np.radians(1.0), "rad/s")]
)
def test_scale_factors_of_a_wrong_unit_name_the_unit(ratio: float, unit: str) -> None:
    """Before: "The motion was too weak, or the reference is wrong"."""
    text = reason_of(1.02 * ratio, -0.97 * ratio, ratio)
    assert f"the rates seem to be in {unit}" in text
    assert "too weak" not in text


def test_other_scale_factors_name_no_unit() -> None:
    for scales in ((0.78, 0.80, 0.79), (57.0, 57.0, 0.9), (40.0, 57.0, 57.0)):
        assert "too weak" in reason_of(*scales)


@pytest.mark.parametrize(
    ("ratio", "unit"), [(np.degrees(1.0), "deg/s"), (np.radians(1.0), "rad/s")]
)
def test_turns_name_the_wrong_unit(ratio: float, unit: str, tmp_path: Path) -> None:
    """Before: scale factors of 0.0176 and a bias that is 57 times too small, `limited`."""
    true = SimulatedGyro()
    gyro = SimulatedGyro(
        gain=ratio * true.gain,
        bias_rad_s=(2e-3 * ratio, -2e-3 * ratio, 5e-4 * ratio),
        noise_rad_s=ratio * true.noise_rad_s,
    )
    with pytest.raises(InputError, match=f"as if its rates are in {unit}"):
        fit_turns_of(record_turns(tmp_path / "t.mcap", gyro))


def fit_turns_of(path: Path) -> None:
    fit_criticised(load_board([read_recording(path)], BOARD), ())
