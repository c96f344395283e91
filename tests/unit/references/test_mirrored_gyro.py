"""A gyro with an axis of the wrong sign, on the attitudes of a reference."""

from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import SimulatedGyro, record_attitudes

from gyrorig_solver import cli
from gyrorig_solver.calibration.calibration_document import parse_calibration


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_remark_is_in_the_text_and_in_the_report(
    sign: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gyro = SimulatedGyro(gain=np.diag([1.0, sign, 1.0]) @ SimulatedGyro().gain)
    recording = record_attitudes(tmp_path / "attitudes.mcap", gyro)
    words = ["solve", str(recording), "--out", str(tmp_path), "--extend", "none"]
    assert cli.run(words) == 0
    folder = tmp_path / "gyro-1"
    calibration = parse_calibration((folder / "v0001.yaml").read_bytes(), "v0001.yaml")
    assert calibration.trust.verdict == "good"
    remark = "axis y has the wrong sign: the gain is mirrored"
    for text in (
        capsys.readouterr().out,
        " ".join(calibration.quality.warnings),
        (folder / "v0001.report.html").read_text(),
    ):
        assert (remark in text) == (sign < 0.0)
