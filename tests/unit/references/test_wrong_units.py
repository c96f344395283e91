"""The unit of the rates as the explanation of implausible scale factors."""

import numpy as np
import pytest

from gyrorig_solver.calibration.calibration_document import Trust
from gyrorig_solver.calibration.plausibility import DataSheetConflict, add_conflicts


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
