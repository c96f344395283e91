"""Attitudes that were computed from the gyro itself are no reference for it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.support.reference_recordings import (
    HandMotion,
    PoseError,
    SimulatedGyro,
    record_attitudes,
)
from tests.unit.references.test_unusable_data import record

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.estimate import fit_attitude
from gyrorig_solver.pipeline import load_board
from gyrorig_solver.pipeline.references.attitudes import load_attitude_recordings

REASON = "the reference attitudes repeat the noise of the gyroscope"


def refused_reasons(path: Path) -> tuple[str, ...]:
    recording = read_recording(path)
    data = load_board([recording], recording.board_ids[0])
    pairs = [(each.samples, each.reference) for each in load_attitude_recordings(data)]
    return fit_attitude(pairs).refused_reasons


@pytest.mark.parametrize(("rate_hz", "step"), [(200.0, 1), (200.0, 2), (100.0, 1), (400.0, 4)])
def test_the_integral_of_the_gyro_is_recognised(rate_hz: float, step: int, tmp_path: Path) -> None:
    """Before: a bias of 0.00 ± 0.05 deg/s for a gyro with 0.57, and a gain of 1 ± 3e-6."""
    assert REASON in refused_reasons(record_integral(tmp_path, rate_hz, step))[0]


def record_integral(folder: Path, rate_hz: float, step: int) -> Path:
    t = np.arange(int(60 * rate_hz)) / rate_hz
    rate = HandMotion(4).rate_rad_s(t)
    reading = SimulatedGyro().measure(t, rate, np.zeros_like(rate), 4)
    attitude, quaternions = Rotation.identity(), []
    for turn in Rotation.from_rotvec(reading / rate_hz):
        attitude = attitude * turn
        quaternions.append(attitude.as_quat())
    q = np.array(quaternions)
    data = {"t": t, "g": np.degrees(reading), "qt": t[::step], "q": q[::step]}
    return record(folder, data)[0]


def test_a_vibration_above_the_attitudes_rate_is_no_noise(tmp_path: Path) -> None:
    """A vibration that the attitudes are too slow to show increases the samples' scatter only."""
    t, qt = np.arange(12_000) / 200.0, np.arange(1200) / 20.0
    motion = HandMotion(4, size=2.0)
    shake = 0.5 * np.sin(2.0 * np.pi * 83.0 * t)[:, None]
    reading = SimulatedGyro(noise_rad_s=5e-5).measure(t, motion.rate_rad_s(t) + shake, t, 4)
    data = {"t": t, "g": np.degrees(reading), "qt": qt, "q": motion.attitude(qt).as_quat()}
    assert refused_reasons(record(tmp_path, data)[0]) == ()


def test_solve_refuses_the_calibration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record_integral(tmp_path, 100.0, 1)
    cli.run(["solve", str(path), "--out", str(tmp_path / "out"), "--extend", "none"])
    out = capsys.readouterr().out
    assert "version 1: refused" in out
    assert f"! {REASON}" in out


@pytest.mark.parametrize("noise_rad_s", [5e-3, 5e-4, 5e-6])
@pytest.mark.parametrize("pose_noise_rad", [3e-4, 1e-6, 0.0])
def test_an_exact_reference_is_not_suspected(
    noise_rad_s: float, pose_noise_rad: float, tmp_path: Path
) -> None:
    gyro = SimulatedGyro(noise_rad_s=noise_rad_s)
    path = record_attitudes(tmp_path / "r.mcap", gyro, 1, PoseError(noise_rad=pose_noise_rad))
    assert not any(REASON in text for text in refused_reasons(path))
