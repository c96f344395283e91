"""Twins of recordings without a unit: what is known of the board, and plain words."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.support import reference_recordings
from tests.support.reference_recordings import (
    BOARD,
    SimulatedGyro,
    record_attitudes,
    record_gravity,
    record_rest,
    record_turns,
)
from tests.unit.twin.conftest import run_gyrorig

from gyrorig_daemon.config import parse_rig
from gyrorig_protocol.twin import Twin, parse_twin

NO_UNIT = "the recordings have no motion unit"
NOT_IDENTIFIABLE = 4


def _twin(recording: Path, folder: Path, status: int = 0) -> tuple[Twin, str]:
    process = run_gyrorig("twin", recording, "--out", folder)
    assert process.returncode == status, process.stderr + process.stdout
    content = (folder / "twin.yaml").read_bytes()
    document = yaml.safe_load(content)
    document.pop("twin")
    assert parse_rig(yaml.safe_dump(document), "twin.yaml").is_emulated
    return parse_twin(content, "twin.yaml"), process.stdout


@pytest.mark.long
def test_attitudes_determine_the_whole_board(tmp_path: Path) -> None:
    gyro = SimulatedGyro()
    twin, text = _twin(record_attitudes(tmp_path / "r.mcap", gyro), tmp_path / "t")
    assert twin.unit is None
    assert NO_UNIT in text
    board = twin.boards[BOARD]
    std = np.array(board.gain.std)
    assert np.abs((np.array(board.gain.value) - gyro.gain) / std).max() < 4.0
    assert twin.posterior is not None
    assert f"boards.{BOARD}.gain.0.0" in twin.posterior.names
    assert board.unexplained == ()


@pytest.mark.long
def test_a_check_without_a_unit_is_refused(tmp_path: Path) -> None:
    recording = record_attitudes(tmp_path / "r.mcap", SimulatedGyro())
    _twin(recording, tmp_path / "t")
    process = run_gyrorig("twin-check", recording, tmp_path / "t")
    assert process.returncode == 3
    assert process.stderr == (
        "gyrorig: the recording r.mcap has no pan-tilt unit, so no simulation can replay its "
        "orders. Check a recording of a pan-tilt unit.\n"
    )


@pytest.mark.long
def test_the_line_of_the_twin_is_fast_enough_for_the_emulated_rate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The emulated sensor has 400 Hz where the board has 286 Hz: `_twin` reads the rig file."""
    monkeypatch.setattr(reference_recordings, "GYRO_HZ", 286)
    recording = record_attitudes(tmp_path / "r.mcap", SimulatedGyro())
    _twin(recording, tmp_path / "t")
    rig = yaml.safe_load((tmp_path / "t" / "twin.yaml").read_text("utf-8"))
    assert rig["emulator"]["odr_hz"] == 400


@pytest.mark.parametrize("record", [record_turns, record_gravity])
def test_poses_leave_the_time_offset_at_its_default(
    record: Callable[[Path, SimulatedGyro], Path], tmp_path: Path
) -> None:
    gyro = SimulatedGyro()
    twin, text = _twin(record(tmp_path / "r.mcap", gyro), tmp_path / "t", NOT_IDENTIFIABLE)
    board = twin.boards[BOARD]
    assert board.gain.source == "recording"
    assert board.time_offset.source == "default"
    assert "time offset" in text
    assert NO_UNIT in text


def test_rest_determines_bias_and_noise_only(tmp_path: Path) -> None:
    gyro = SimulatedGyro()
    twin, text = _twin(record_rest(tmp_path / "r.mcap", gyro), tmp_path / "t", NOT_IDENTIFIABLE)
    board = twin.boards[BOARD]
    assert board.gain.source == "default"
    assert np.array(board.gain.value) == pytest.approx(np.eye(3))
    assert board.bias.std is not None
    off = (np.array(board.bias.value) - gyro.bias_rad_s) / np.array(board.bias.std)
    assert np.abs(off).max() < 4.0
    assert board.noise_density is not None
    assert "sensor matrix" in text.partition("at the defaults")[2]
