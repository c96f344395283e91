"""Bags written by the library rosbags: imported by one command, solved, compared with the truth."""

import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.support.foreign_files import START_NS, write_ros1_bag, write_ros2_bag
from tests.support.simulated_attitudes import (
    HandMotion,
    SimulatedAttitudes,
    StampSettings,
    simulate_attitudes,
)
from tests.support.solved_truth import check_solved

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver import cli
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.importers import ImportOptions, find_format, import_files
from gyrorig_solver.importers.measured_streams import GyroStream
from gyrorig_solver.importers.plausible_rates import rate_warnings
from gyrorig_solver.importers.stamp_kinds import count_rows


@pytest.fixture(scope="module")
def session() -> SimulatedAttitudes:
    return simulate_attitudes(1, span_s=40.0)


@pytest.fixture(scope="module")
def short() -> SimulatedAttitudes:
    return simulate_attitudes(2, span_s=5.0)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_ros2_bag_is_imported_by_one_command_and_solved(
    storage: str,
    session: SimulatedAttitudes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    write_ros2_bag(tmp_path / "drive", session, storage=storage)
    monkeypatch.chdir(tmp_path)
    assert cli.run(["import", "drive"]) == 0
    recording = read_recording(tmp_path / "drive.mcap")
    assert recording.start_ns == START_NS
    samples = load_samples(recording, "imu-data-raw")
    assert samples.rate_rad_s == pytest.approx(session.gyro_rad_s, abs=1e-7)
    assert samples.temperature_degc is not None
    assert np.nanmean(samples.temperature_degc) == pytest.approx(31.5)
    check_solved(tmp_path / "drive.mcap", session, tmp_path / "calibrations")


def test_a_ros1_bag_is_imported_by_one_command_and_solved(
    session: SimulatedAttitudes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_ros1_bag(tmp_path / "drive.bag", session, compression="lz4")
    monkeypatch.chdir(tmp_path)
    assert cli.run(["import", "drive.bag"]) == 0
    check_solved(tmp_path / "drive.mcap", session, tmp_path / "calibrations")


@pytest.mark.parametrize("pose_type", ["TransformStamped", "Odometry", "TFMessage"])
def test_poses_of_each_type_are_read(
    pose_type: str, short: SimulatedAttitudes, tmp_path: Path
) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short, pose_type=pose_type)
    summary = import_files([bag], tmp_path / "out.mcap")
    assert summary.attitudes == short.stamp_s.size
    assert any("the orientation maps the body to the world" in note for note in summary.notes)


def test_a_file_of_a_bag_is_enough_and_its_name_does_not_matter(
    short: SimulatedAttitudes, tmp_path: Path
) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short)
    (source,) = bag.glob("*.mcap")
    shutil.copy(source, tmp_path / "measurement.dat")
    chosen, match = find_format(tmp_path / "measurement.dat")
    assert (chosen.name, match.description) == ("ros2", "a ROS 2 bag")
    assert import_files([tmp_path / "measurement.dat"], tmp_path / "out.mcap").samples == 1000


def test_stamps_of_the_log_are_times_of_arrival(short: SimulatedAttitudes, tmp_path: Path) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short, link_ns=0)
    summary = import_files([bag], tmp_path / "out.mcap")
    assert sum("times of arrival" in note for note in summary.notes) == 2
    recording = read_recording(summary.path)
    assert recording.metadata["gyrorig.reference"] == {"stamp": "arrival"}
    board = recording.metadata["gyrorig.board.imu-data-raw"]
    assert float(board["tick_hz"]) == pytest.approx(200.0)
    as_sampled = import_files([bag], tmp_path / "s.mcap", ImportOptions(stamp="sampled"))
    assert "gyrorig.reference" not in read_recording(as_sampled.path).metadata


def test_jittered_arrivals_of_samples_and_poses_are_solved(tmp_path: Path) -> None:
    """All messages have the time of the log: samples 2 ms late and more, poses 1 ms and more."""
    session = simulate_attitudes(1, StampSettings(jitter_s=1e-3, kind="arrival"), span_s=40.0)
    rng = np.random.default_rng(3)
    delay_s = 2e-3 + np.abs(3e-4 * rng.normal(size=session.gyro_time_s.size))
    arrival_s = np.maximum.accumulate(session.gyro_time_s + delay_s)
    bag = write_ros2_bag(tmp_path / "bag", replace(session, gyro_time_s=arrival_s), link_ns=0)
    summary = import_files([bag], tmp_path / "out.mcap")
    late = replace(session, lag_s=session.lag_s + 2e-3)
    check_solved(summary.path, late, tmp_path / "calibrations")


def test_several_topics_are_listed_with_counts_and_rates(
    short: SimulatedAttitudes, tmp_path: Path
) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short, imu_topics=("/left/imu", "/right/imu"))
    with pytest.raises(InputError, match=r"/left/imu \(1000 messages, 200 Hz\), /right/imu"):
        import_files([bag], tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()
    chosen = import_files([bag], tmp_path / "one.mcap", ImportOptions(topics=("/left/imu",)))
    assert (chosen.board, chosen.other_boards) == ("left-imu", {})
    both = ImportOptions(topics=("/left/imu", "/right/imu"))
    summary = import_files([bag], tmp_path / "two.mcap", both)
    assert (summary.board, summary.other_boards) == ("left-imu", {"right-imu": 1000})
    with pytest.raises(UsageError, match="no topic '/middle/imu'"):
        import_files([bag], tmp_path / "no.mcap", ImportOptions(topics=("/middle/imu",)))


def test_damaged_bags_are_refused_in_one_line(short: SimulatedAttitudes, tmp_path: Path) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short)
    (source,) = bag.glob("*.mcap")
    whole = source.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"ends inside a record.*Repair it with `mcap recover`"):
        import_files([cut], tmp_path / "out.mcap")
    ros1 = write_ros1_bag(tmp_path / "a.bag", short)
    ros1.write_bytes(ros1.read_bytes()[:-1000])
    with pytest.raises(InputError, match=r"ends inside a record.*Repair it with `rosbag reindex`"):
        import_files([ros1], tmp_path / "out.mcap")
    database = write_ros2_bag(tmp_path / "db", short, storage="sqlite3")
    (source,) = database.glob("*.db3")
    with sqlite3.connect(source) as connection:
        connection.execute("UPDATE messages SET data = x'0001' WHERE id = 5")
    connection.close()
    with pytest.raises(InputError, match="cannot be read") as caught:
        import_files([database], tmp_path / "out.mcap")
    assert "\n" not in str(caught.value)
    with sqlite3.connect(source) as connection:
        connection.execute("DROP TABLE schema")
        connection.execute(
            "CREATE VIEW schema AS WITH RECURSIVE n(schema_version) AS "
            "(SELECT 1 UNION ALL SELECT schema_version FROM n) SELECT * FROM n"
        )
    connection.close()
    with pytest.raises(InputError, match="contains views"):
        import_files([database], tmp_path / "out.mcap")


def test_a_bag_without_an_imu_states_what_it_contains(tmp_path: Path) -> None:
    empty = simulate_attitudes(2, span_s=5.0)
    bag = write_ros2_bag(tmp_path / "bag", empty, imu_topics=())
    with pytest.raises(InputError, match="contain no rates of a gyroscope"):
        import_files([bag], tmp_path / "out.mcap")


def test_a_recording_of_this_project_needs_no_import(
    short: SimulatedAttitudes, tmp_path: Path
) -> None:
    bag = write_ros2_bag(tmp_path / "bag", short)
    recording = import_files([bag], tmp_path / "own.mcap").path
    with pytest.raises(InputError, match="is already a recording"):
        find_format(recording)


def test_rates_in_degrees_are_noticed(tmp_path: Path) -> None:
    """The definition of the message requires rad/s; a driver that writes deg/s is 57 times off."""
    short = simulate_attitudes(2, span_s=5.0, motion=HandMotion(2, speed=0.3))
    wrong = replace(short, gyro_rad_s=np.degrees(short.gyro_rad_s))
    summary = import_files([write_ros2_bag(tmp_path / "bag", wrong)], tmp_path / "out.mcap")
    (warning,) = [note for note in summary.notes if "times as fast as the reference" in note]
    assert "probably writes deg/s although rad/s is stated" in warning
    fast = GyroStream(short.gyro_time_s, np.full((1000, 3), 100.0))
    assert "more than gyros measure" in rate_warnings(fast, None, "B1")[0]
    right = import_files([write_ros2_bag(tmp_path / "ok", short)], tmp_path / "ok.mcap")
    assert not any("probably" in note for note in right.notes)


def test_lost_samples_are_counted_by_arrival_times() -> None:
    """Delays of up to three periods are no losses; lost samples keep all later ones late."""
    rng = np.random.default_rng(5)
    lost = {400, 401, 900}
    number = np.array([k for k in range(1500) if k not in lost])
    arrival_s = 0.005 * number + np.abs(0.001 * rng.normal(size=number.size))
    arrival_s[200:203] += 0.012
    assert np.array_equal(count_rows(np.maximum.accumulate(arrival_s)), number)
