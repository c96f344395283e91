"""Inputs that make no twin get one line, and nothing is written."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.unit.twin.conftest import ROOT, record, run_gyrorig

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.twin import check_one_rig

OTHER_UNIT = """
schema: gyrorig/rig/1
rig: two-axis
ptu: {port: emulated, baud: 115200}
boards: [{id: GY80-1, port: emulated, baud: 460800}]
emulator: {dialect: d46, seed: 3}
"""


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording of an emulated rig."""
    recording, _ = record(tmp_path_factory.mktemp("quick"), "--seed", "2", program="quick")
    return recording


def _refused(status: int, *words: str | Path) -> str:
    process = run_gyrorig("twin", *words)
    assert process.returncode == status, process.stderr
    assert "Traceback" not in process.stderr
    lines = process.stderr.strip().splitlines()
    assert len(lines) == 1, process.stderr
    return lines[0]


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("t,x\n0,1\n", encoding="utf-8")
    _refused(3, table, "--out", tmp_path / "t")
    assert not (tmp_path / "t").exists()


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    assert "none.mcap" in _refused(3, tmp_path / "none.mcap", "--out", tmp_path / "t")


@pytest.mark.long
def test_a_damaged_recording_is_refused(quick: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(quick.read_bytes()[:600])
    _refused(3, damaged, "--out", tmp_path / "t")


def test_a_board_that_is_not_there_is_refused(quick: Path, tmp_path: Path) -> None:
    message = _refused(3, quick, "--board", "GY80-2", "--out", tmp_path / "t")
    assert "GY80-1" in message


def test_one_recording_twice_is_refused(quick: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(quick.read_bytes())
    assert "same recording" in _refused(2, quick, copy, "--out", tmp_path / "t")


def test_a_folder_that_cannot_be_written_is_refused(quick: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert "--out" in _refused(1, quick, "--out", tmp_path / "file" / "t")


@pytest.mark.long
def test_an_earlier_twin_is_kept(quick: Path, tmp_path: Path) -> None:
    first = run_gyrorig("twin", quick, "--out", tmp_path)
    before = (tmp_path / "twin.yaml").read_bytes()
    second = run_gyrorig("twin", quick, "--out", tmp_path)
    assert first.returncode == second.returncode == 0, first.stderr + second.stderr
    assert (tmp_path / "twin-0001.yaml").read_bytes() == before
    assert (tmp_path / "twin.yaml").exists()


@pytest.mark.long
def test_recordings_of_two_units_are_refused(quick: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(OTHER_UNIT, encoding="utf-8")
    other, _ = record(tmp_path / "other", "--seed", "3", program="quick", config=rig)
    message = _refused(2, quick, other, "--out", tmp_path / "t")
    assert "one rig" in message


@pytest.mark.long
def test_recordings_of_two_rigs_are_refused(quick: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    text = (ROOT / "config" / "rig.yaml").read_text(encoding="utf-8")
    rig.write_text(text.replace("rig: emulated-1", "rig: workshop-2"), encoding="utf-8")
    other, _ = record(tmp_path / "other", "--seed", "2", program="quick", config=rig)
    message = _refused(2, quick, other, "--out", tmp_path / "t")
    assert "the name of the rig is emulated-1" in message
    assert "workshop-2" in message


def test_two_recordings_with_one_file_name_are_refused(quick: Path) -> None:
    """Before, the twin had the events of the last one only."""
    recording = read_recording(quick)
    other = replace(recording, path=Path("elsewhere") / recording.path.name)
    with pytest.raises(UsageError, match=r"2 recordings have the file name"):
        check_one_rig([recording, other])


def test_recordings_with_and_without_a_unit_are_refused(quick: Path) -> None:
    with_unit = read_recording(quick)
    topics = {name: topic for name, topic in with_unit.topics.items() if name != "/ptu/position"}
    without = replace(with_unit, topics=topics, path=Path("bench.mcap"))
    with pytest.raises(UsageError, match=r"has a motion unit and bench\.mcap has none"):
        check_one_rig([with_unit, without])


@pytest.mark.long
def test_a_truncated_recording_gets_a_remark(quick: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    whole = quick.read_bytes()
    cut.write_bytes(whole[: len(whole) * 9 // 10])
    process = run_gyrorig("twin", cut, "--out", tmp_path / "t")
    assert process.returncode == 0, process.stderr
    remarks = [line for line in process.stdout.splitlines() if line.startswith("  ! cut.mcap: ")]
    assert len(remarks) == 1
    assert remarks[0].endswith("The twin is that of the data that can be read.")
