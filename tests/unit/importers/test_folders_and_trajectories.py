"""EuRoC folders and TUM trajectories: imported by one command, solved, compared with the truth."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.support.foreign_files import (
    START_NS,
    write_euroc_folder,
    write_gyro_table,
    write_ros2_bag,
    write_tum_trajectory,
)
from tests.support.simulated_attitudes import SimulatedAttitudes, simulate_attitudes
from tests.support.solved_truth import check_solved

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.importers import ImportMap, ImportOptions, find_format, import_files

MAP = """
schema: gyrorig/import/1
board: IMU-7
sensor: MPU-6050
time: {key: t, unit: s}
gyro: {keys: [gx, gy, gz], unit: deg/s}
"""


@pytest.fixture(scope="module")
def session() -> SimulatedAttitudes:
    return simulate_attitudes(3, span_s=40.0)


@pytest.fixture(scope="module")
def short() -> SimulatedAttitudes:
    return simulate_attitudes(2, span_s=5.0)


def test_a_euroc_folder_is_imported_by_one_command_and_solved(
    session: SimulatedAttitudes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both extrinsics are used: the attitudes are those of the IMU, not of the markers."""
    write_euroc_folder(tmp_path / "V1_01_easy", session)
    monkeypatch.chdir(tmp_path)
    assert cli.run(["import", "V1_01_easy"]) == 0
    recording = read_recording(tmp_path / "V1_01_easy.mcap")
    assert recording.start_ns == START_NS  # to the nanosecond
    assert recording.metadata["gyrorig.board.imu0"]["odr_hz"] == "200.0"
    check_solved(tmp_path / "V1_01_easy.mcap", session, tmp_path / "calibrations")


def test_a_euroc_folder_states_what_its_references_are(
    short: SimulatedAttitudes, tmp_path: Path
) -> None:
    folder = write_euroc_folder(tmp_path / "a", short, "state_groundtruth_estimate0")
    notes = import_files([folder], tmp_path / "a.mcap").notes
    assert any("not independent of the gyro" in note for note in notes)
    assert any("leica0 contains positions without orientations" in note for note in notes)
    with pytest.raises(UsageError, match=r"name 'vicon9'\. Choose one of imu0, state_"):
        import_files([folder], tmp_path / "b.mcap", ImportOptions(topics=("vicon9",)))
    for path in (folder / "mav0", folder / "mav0" / "imu0", folder / "mav0" / "imu0" / "data.csv"):
        assert find_format(path)[0].name == "euroc"
        summary = import_files([path], tmp_path / f"{path.stem}.mcap")
        assert summary.samples == 1000


def test_a_trajectory_joins_the_gyro_of_another_file(
    session: SimulatedAttitudes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_gyro_table(tmp_path / "log.csv", session)
    write_tum_trajectory(tmp_path / "truth.txt", session)
    (tmp_path / "map.yaml").write_text(MAP)
    monkeypatch.chdir(tmp_path)
    assert cli.run(["import", "log.csv", "truth.txt", "--map", "map.yaml"]) == 0
    check_solved(tmp_path / "log.mcap", session, tmp_path / "calibrations")
    joined = ["import", "log.csv", "--reference", "truth.txt", "--map", "map.yaml", "-o", "b.mcap"]
    assert cli.run(joined) == 0
    assert "/reference/attitude" in read_recording(tmp_path / "b.mcap").topics


def test_a_rest_has_the_times_of_the_board_of_its_own_file(
    short: SimulatedAttitudes, tmp_path: Path
) -> None:
    """The log has half the rate of the first board, so its row numbers give other times there."""
    folder = write_euroc_folder(tmp_path / "eu", short)
    half = replace(
        short,
        gyro_time_s=short.gyro_time_s[::2] + START_NS * 1e-9,
        gyro_rad_s=short.gyro_rad_s[::2],
    )
    write_gyro_table(tmp_path / "log.csv", half)
    text = MAP + "static: [{start: 100, end: 300}]\n"
    mapping = convert_document(parse_yaml(text, "map"), ImportMap, "map")
    summary = import_files(
        [folder, tmp_path / "log.csv"], tmp_path / "out.mcap", ImportOptions(mapping)
    )
    assert (summary.board, summary.other_boards) == ("imu0", {"IMU-7": 500})
    events = read_recording(summary.path).events()
    times_s = [(e.host_time_ns - START_NS) * 1e-9 for e in events if e.phase == "static"]
    assert times_s == pytest.approx([1.0, 2.99], abs=0.01)


def test_files_without_a_common_time_are_refused(short: SimulatedAttitudes, tmp_path: Path) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short, imu_topics=("/imu",))
    trajectory = write_tum_trajectory(tmp_path / "truth.txt", short)
    with pytest.raises(InputError, match="have no common time"):
        import_files([bag, trajectory], tmp_path / "out.mcap")
    folder = write_euroc_folder(tmp_path / "e", short)
    with pytest.raises(InputError, match=r"have no common time: they are 1\.76e"):
        import_files([folder / "mav0" / "imu0", trajectory], tmp_path / "out.mcap")


def test_a_trajectory_alone_has_no_gyro(short: SimulatedAttitudes, tmp_path: Path) -> None:
    trajectory = write_tum_trajectory(tmp_path / "truth.txt", short)
    with pytest.raises(InputError, match="contain no rates of a gyroscope"):
        import_files([trajectory], tmp_path / "out.mcap")


def test_an_option_that_no_input_uses_is_refused(short: SimulatedAttitudes, tmp_path: Path) -> None:
    trajectory = write_tum_trajectory(tmp_path / "truth.txt", short)
    with pytest.raises(UsageError, match="option --topic has no meaning for this input"):
        import_files([trajectory], tmp_path / "out.mcap", ImportOptions(topics=("/imu",)))
