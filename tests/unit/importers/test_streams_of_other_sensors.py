"""Temperatures and attitudes belong to the device that measured them."""

import shutil
from pathlib import Path

import pytest
from tests.support.foreign_files import write_ros2_bag
from tests.support.handheld_session import simulate_session, write_ximu3
from tests.support.simulated_attitudes import SimulatedAttitudes, simulate_attitudes

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.importers import ImportOptions, ImportSummary, import_files


@pytest.fixture(scope="module")
def short() -> SimulatedAttitudes:
    return simulate_attitudes(2, span_s=5.0)


def boards_with_temperature(summary: ImportSummary) -> list[str]:
    recording = read_recording(summary.path)
    return [
        str(board)
        for board in recording.board_ids
        if load_samples(recording, board).temperature_degc is not None
    ]


def imported(
    folder: Path, session: SimulatedAttitudes, imus: tuple[str, ...], chosen: tuple[str, ...]
) -> ImportSummary:
    bag = write_ros2_bag(folder / "bag", session, imu_topics=imus)
    return import_files([bag], folder / "out.mcap", ImportOptions(topics=chosen))


def test_a_temperature_is_that_of_the_imu_with_its_namespace(
    tmp_path: Path, short: SimulatedAttitudes
) -> None:
    """Before, both boards got the temperature of one."""
    imus = ("/imu/data_raw", "/other_imu/data_raw")
    summary = imported(tmp_path, short, imus, imus)
    assert boards_with_temperature(summary) == ["imu-data-raw"]


@pytest.mark.parametrize("chosen", [("/left/imu", "/right/imu"), ("/left/imu",)])
def test_a_temperature_of_no_known_imu_is_left_out(
    tmp_path: Path, short: SimulatedAttitudes, chosen: tuple[str, ...]
) -> None:
    summary = imported(tmp_path, short, ("/left/imu", "/right/imu"), chosen)
    assert boards_with_temperature(summary) == []
    (note,) = [note for note in summary.notes if "temperatures are left out" in note]
    assert "/imu/temperature (5 messages" in note


def test_a_person_can_choose_the_temperature_of_one_imu(
    tmp_path: Path, short: SimulatedAttitudes
) -> None:
    chosen = ("/left/imu", "/imu/temperature")
    summary = imported(tmp_path, short, ("/left/imu", "/right/imu"), chosen)
    assert boards_with_temperature(summary) == ["left-imu"]
    assert any("/imu/temperature is taken as that of the IMU" in note for note in summary.notes)


def test_the_temperature_of_the_only_imu_needs_no_name(
    tmp_path: Path, short: SimulatedAttitudes
) -> None:
    summary = imported(tmp_path, short, ("/other/imu",), ())
    assert boards_with_temperature(summary) == ["other-imu"]


def test_attitudes_of_several_ximu3_are_no_reference(tmp_path: Path) -> None:
    """Before, all boards were solved with the attitude of the first device."""
    source = tmp_path / "log"
    source.mkdir()
    first = write_ximu3(source, simulate_session(7, moves=2))
    shutil.copytree(first, source / "second")
    (source / "second" / "Command.json").unlink()
    with pytest.raises(InputError, match="2 devices, each with an attitude"):
        import_files([source], tmp_path / "o.mcap", ImportOptions(topics=("Quaternion",)))
    assert import_files([source], tmp_path / "p.mcap").attitudes == 0
