"""Names of boards: each board of a recording has another one, and none is left out."""

import shutil
from pathlib import Path

import pytest
from tests.support.foreign_files import write_euroc_folder, write_ros2_bag, write_tum_trajectory
from tests.support.handheld_session import HandheldSession, simulate_session, write_ximu3
from tests.support.simulated_attitudes import SimulatedAttitudes, simulate_attitudes

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.importers import ImportOptions, import_files
from gyrorig_solver.importers.board_names import unique_names


@pytest.fixture(scope="module")
def attitudes() -> SimulatedAttitudes:
    return simulate_attitudes(2, span_s=5.0)


@pytest.fixture(scope="module")
def handheld() -> HandheldSession:
    return simulate_session(7)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a", "b"], ["a", "b"]),
        (["a", "a", "a"], ["a", "a-2", "a-3"]),
        (["a", "a", "a-2"], ["a", "a-3", "a-2"]),
        (["a" * 32, "a" * 32], ["a" * 32, "a" * 30 + "-2"]),
        (["a" * 29 + "-bc", "a" * 29 + "-bc"], ["a" * 29 + "-bc", "a" * 29 + "-2"]),
    ],
)
def test_a_name_that_occurs_again_gets_a_number(names: list[str], expected: list[str]) -> None:
    assert unique_names(names) == expected


def test_two_boards_with_one_name_are_refused(
    attitudes: SimulatedAttitudes, tmp_path: Path
) -> None:
    folder = write_euroc_folder(tmp_path / "e", attitudes)
    shutil.copytree(folder / "mav0" / "imu0", folder / "mav0" / "imu1")
    options = ImportOptions(board="X", topics=("imu0", "imu1"))
    with pytest.raises(UsageError, match=r"2 boards with the name X.*Remove --board"):
        import_files([folder], tmp_path / "out.mcap", options)
    trajectory = write_tum_trajectory(tmp_path / "truth.txt", attitudes)
    with pytest.raises(UsageError, match=r"layout of EuRoC contain 2 boards with the name X"):
        import_files([folder, trajectory], tmp_path / "out.mcap", options)
    assert not (tmp_path / "out.mcap").exists()
    both = ImportOptions(topics=("imu0", "imu1"))
    summary = import_files([folder], tmp_path / "out.mcap", both)
    assert (summary.board, summary.other_boards) == ("imu0", {"imu1": 1000})


def test_topics_with_one_beginning_are_two_boards(
    attitudes: SimulatedAttitudes, tmp_path: Path
) -> None:
    topics = tuple(f"/robot/front/sensors/microstrain/imu/{end}" for end in ("data", "data_raw"))
    bag = write_ros2_bag(tmp_path / "bag", attitudes, imu_topics=topics)
    summary = import_files([bag], tmp_path / "out.mcap", ImportOptions(topics=topics))
    metadata = read_recording(summary.path).metadata
    assert (summary.board, summary.other_boards) == (
        "robot-front-sensors-microstrain",
        {"robot-front-sensors-microstrai-2": 1000},
    )
    assert metadata["gyrorig.board.robot-front-sensors-microstrai-2"]["model"] == topics[1]


def test_devices_without_a_serial_number_are_two_boards(
    handheld: HandheldSession, tmp_path: Path
) -> None:
    folder = tmp_path / "devices"
    folder.mkdir()
    first = write_ximu3(folder, handheld)
    second = folder / "z"
    shutil.copytree(first, second)
    with pytest.raises(UsageError, match="2 boards with the name F7E4-5410-EC7B-D7E7"):
        import_files([folder], tmp_path / "same.mcap")
    for path in (first, second):
        (path / "Command.json").unlink()
    summary = import_files([folder], tmp_path / "out.mcap")
    assert summary.board == "X-IMU3"
    assert summary.other_boards == {"X-IMU3-2": handheld.time_s.size}
    assert "z contains no serial number; its device has the name X-IMU3-2" in summary.notes
