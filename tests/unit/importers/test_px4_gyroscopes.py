"""Which gyroscope of a PX4 log has the rates of sensor_combined and vehicle_imu."""

from pathlib import Path

import pytest
from tests.support.flight_log_writers import write_ulog
from tests.support.handheld_session import HandheldSession, simulate_session

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.importers import ImportSummary, import_files

TWO_SLOW = ("sensor_gyro#0", "sensor_gyro#1", "sensor_combined", "sensor_selection")
IDS = (11, 22)


@pytest.fixture(scope="module")
def session() -> HandheldSession:
    return simulate_session(7, moves=2)


def imported(
    folder: Path, session: HandheldSession, names: tuple[str, ...], selected: tuple[int, ...]
) -> tuple[ImportSummary, Recording]:
    log = write_ulog(folder, session, names, ["sensor_gyro"], IDS, selected)
    summary = import_files([log], folder / "o.mcap")
    return summary, read_recording(summary.path)


def test_sensor_combined_is_that_of_the_selected_gyroscope(
    tmp_path: Path, session: HandheldSession
) -> None:
    """Before, it was always that of gyroscope 0, with its uid and temperature."""
    summary, recording = imported(tmp_path, session, TWO_SLOW, (22,))
    assert summary.other_boards == {"GYRO-1": session.time_s.size}
    assert recording.metadata["gyrorig.board.GYRO-1"]["uid"] == "22"
    (note,) = [note for note in summary.notes if "body frame" in note]
    assert note.startswith("gyroscope 1: PX4 has already corrected the rates of sensor_combined")


@pytest.mark.parametrize(
    ("names", "selected"), [(TWO_SLOW[:3], ()), (TWO_SLOW, (11, 22)), (TWO_SLOW, (33,))]
)
def test_sensor_combined_of_an_unknown_gyroscope_is_a_separate_board(
    tmp_path: Path, session: HandheldSession, names: tuple[str, ...], selected: tuple[int, ...]
) -> None:
    summary, recording = imported(tmp_path, session, names, selected)
    assert (summary.board, summary.other_boards) == ("GYRO-combined", {})
    metadata = recording.metadata["gyrorig.board.GYRO-combined"]
    assert metadata["uid"] == ("33" if selected == (33,) else "unknown")
    assert "temperature_scale_c" not in metadata
    assert any("does not show which gyroscope" in note for note in summary.notes)
    assert sum("was logged with only 1 Hz" in note for note in summary.notes) == 2


def test_fast_gyroscopes_need_no_sensor_combined(tmp_path: Path, session: HandheldSession) -> None:
    log = write_ulog(tmp_path, session, TWO_SLOW[:3], (), IDS)
    summary = import_files([log], tmp_path / "o.mcap")
    assert (summary.board, list(summary.other_boards)) == ("GYRO-0", ["GYRO-1"])
    assert not any("body frame" in note for note in summary.notes)


def test_vehicle_imu_has_its_device_id(tmp_path: Path, session: HandheldSession) -> None:
    log = write_ulog(tmp_path, session, ["vehicle_imu"])
    summary = import_files([log], tmp_path / "o.mcap")
    metadata = read_recording(summary.path).metadata
    assert metadata["gyrorig.board.GYRO-0"]["uid"] == "2"
    assert any("corrected the rates of vehicle_imu" in note for note in summary.notes)
