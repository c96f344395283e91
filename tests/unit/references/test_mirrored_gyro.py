"""A gyro with an axis of the wrong sign, on the attitudes of a reference."""

from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import HandMotion, SimulatedGyro, record_attitudes

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.calibration.calibration_document import parse_calibration
from gyrorig_solver.check.attitude_health import examine_attitudes
from gyrorig_solver.data import FloatArray
from gyrorig_solver.pipeline import load_board


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


@pytest.mark.parametrize(
    ("axes", "text"),
    [
        (np.diag([1.0, -1.0, 1.0]), "axis y has the wrong sign"),
        (np.eye(3)[[1, 0, 2]], "axes x and y are exchanged"),
        (-np.eye(3), "axis x and y and z has the wrong sign"),
        (np.eye(3)[[1, 2, 0]], ""),
    ],
)
def test_the_check_names_mirrored_axes(
    axes: FloatArray, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before: "sound", for each of them."""
    gyro = SimulatedGyro(gain=axes @ SimulatedGyro().gain)
    cli.run(["check", str(record_attitudes(tmp_path / "attitudes.mcap", gyro))])
    out = capsys.readouterr().out
    assert ("usable, with remarks" if text else "sound;") in out
    assert text in out
    assert ("mirrored" in out) == bool(text)


def test_the_check_does_not_guess_from_little_motion(tmp_path: Path) -> None:
    gyro = SimulatedGyro(gain=np.diag([1.0, -1.0, 1.0]) @ SimulatedGyro().gain)
    motion = HandMotion(4, size=1e-3)
    recording = read_recording(record_attitudes(tmp_path / "a.mcap", gyro, motion=motion))
    samples = load_board([recording], "gyro-1").samples[0]
    health = examine_attitudes(recording, samples)
    assert health is not None
    assert health.mirror == ""
