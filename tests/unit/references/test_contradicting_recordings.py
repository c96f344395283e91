"""Recordings of two boards with one name: with other references than a unit, or one file name."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.support.reference_recordings import (
    BOARD,
    HandMotion,
    SimulatedGyro,
    record_attitudes,
    record_turns,
)
from tests.support.simulated_samples import plain_samples

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording_names import distinct_names
from gyrorig_solver.calibration.calibration_document import BoardRecord, BoardSettings
from gyrorig_solver.cli import run
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.one_board import check_same_board, check_stored_board
from gyrorig_solver.pipeline.recording_agreement import find_disagreement
from gyrorig_solver.pipeline.recording_contexts import read_contexts

GYRO = SimulatedGyro()
Captured = pytest.CaptureFixture[str]


def other_gyro(scale_x: float) -> SimulatedGyro:
    """Return a gyro with another scale factor of x."""
    gain = GYRO.gain.copy()
    gain[0] *= scale_x
    return SimulatedGyro(gain=gain)


def attitudes(path: Path, gyro: SimulatedGyro, seed: int, **more: Any) -> Path:
    path.parent.mkdir(exist_ok=True)
    return record_attitudes(
        path, gyro, seed, motion=HandMotion(seed, span_s=40.0, rest_s=5.0), **more
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sessions of one board, and one of another board with the file name of the first."""
    made = tmp_path_factory.mktemp("boards")
    attitudes(made / "a" / "session.mcap", GYRO, 1)
    attitudes(made / "a" / "later.mcap", GYRO, 3)
    attitudes(made / "b" / "session.mcap", other_gyro(1.01), 2)
    return made


@pytest.mark.parametrize("command", ["solve", "explain"])
def test_two_boards_in_files_with_one_name_are_refused(
    folder: Path, command: str, tmp_path: Path, capsys: Captured
) -> None:
    words = [str(folder / name / "session.mcap") for name in "ab"]
    assert run([command, *words, "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "the recordings a/session.mcap and b/session.mcap contradict each other" in line
    assert "scale.x differs by 0.01" in line
    assert not list(tmp_path.rglob("*.yaml"))


def test_attitudes_of_two_boards_are_solved_together_only_on_request(
    folder: Path, tmp_path: Path, capsys: Captured
) -> None:
    words = [str(folder / "a" / "later.mcap"), str(folder / "b" / "session.mcap")]
    command = ["solve", *words, "--out", str(tmp_path), "--extend", "none", "--json"]
    assert run(command) == 2
    assert "contradict each other" in capsys.readouterr().err
    assert run([*command, "--allow-contradiction"]) == 0
    (board,) = json.loads(capsys.readouterr().out)["boards"]
    assert any("contradict" in text for text in board["calibration"]["quality"]["warnings"])


def test_attitudes_of_one_board_agree(folder: Path) -> None:
    recordings = [read_recording(folder / "a" / f"{name}.mcap") for name in ("session", "later")]
    assert find_disagreement(load_board(recordings, BOARD)) is None


def test_turns_of_two_boards_are_refused(tmp_path: Path) -> None:
    """A recording without a rest or a turn determines no gain alone, and is not compared."""
    paths = [
        record_turns(tmp_path / f"{k}.mcap", gyro, k, repeats=1)
        for k, gyro in enumerate((GYRO, GYRO, other_gyro(1.05)), 1)
    ]
    first, second, other = map(read_recording, paths)
    assert find_disagreement(load_board([first, second], BOARD)) is None
    disagreement = find_disagreement(load_board([first, other], BOARD))
    assert disagreement is not None
    assert disagreement.parameter == "scale.x"


def test_findings_name_each_of_two_files_with_one_name(tmp_path: Path) -> None:
    paths = [attitudes(tmp_path / name / "session.mcap", GYRO, k) for k, name in enumerate("ab", 1)]
    assert run(["explain", *map(str, paths), "--out", str(tmp_path / "out")]) == 0
    (path,) = (tmp_path / "out").rglob("findings.yaml")
    findings = yaml.safe_load(path.read_text(encoding="utf-8"))
    names = ["a/session.mcap", "b/session.mcap"]
    assert [row["name"] for row in findings["recording"]] == names
    assert {row["recording"] for row in findings["raw"]} == {*names, "all recordings"}


def test_equal_names_get_as_many_folders_as_they_need(folder: Path) -> None:
    recording = read_recording(folder / "a" / "session.mcap")
    paths = ["/x/a/s.mcap", "/y/a/s.mcap", "/b/s.mcap", "/b/t.mcap"]
    recordings = [replace(recording, path=Path(path)) for path in paths]
    assert distinct_names(recordings) == ("x/a/s.mcap", "y/a/s.mcap", "b/s.mcap", "t.mcap")
    assert distinct_names([recording, recording])[0].endswith("session.mcap")


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("uid", ("A", "B")),
        ("uid", ("A", "unknown", "", "B")),
        ("sensor", ("ICM-20948", "MPU-6050")),
        ("odr_hz", ("100", "200")),
        ("config_hash", ("3f", "", "40")),
        ("config_hash", ("1e4001", "2e4001")),
        ("bandwidth_hz", ("", "25")),
    ],
)
def test_what_differs_between_recordings_is_refused(key: str, values: tuple[str, ...]) -> None:
    names = [f"{k}.mcap" for k in range(len(values))]
    with pytest.raises(UsageError, match=rf"the (setting )?{key} of board T .*0\.mcap"):
        check_same_board("T", names, [{key: value} for value in values])


def test_what_is_not_known_is_no_difference() -> None:
    known = {"uid": "A", "sensor": "ICM-20948", "odr_hz": "100", "config_hash": "3f"}
    unknown = {"uid": "unknown", "sensor": "unknown", "odr_hz": ""}
    check_same_board("T", ["a", "b", "c"], [unknown, known, known | unknown])
    check_same_board("T", ["a", "b"], [{"odr_hz": "100"}, {"odr_hz": "100.0"}])


def test_recordings_with_two_uids_are_refused(tmp_path: Path, capsys: Captured) -> None:
    paths = [attitudes(tmp_path / f"{k}.mcap", GYRO, k, uid=f"U{k}") for k in (1, 2)]
    command = ["solve", *map(str, paths), "--out", str(tmp_path / "out"), "--allow-contradiction"]
    assert run(command) == 2
    assert (
        "the uid of board gyro-1 is U1 in the recording 1.mcap, and U2" in capsys.readouterr().err
    )


def test_causes_are_not_tested_on_a_recording_of_another_board(
    tmp_path: Path, capsys: Captured
) -> None:
    fitted, other = (attitudes(tmp_path / f"{k}.mcap", GYRO, k, uid=f"U{k}") for k in (1, 2))
    command = ["explain", str(fitted), "--held-out", str(other), "--out", str(tmp_path / "out")]
    assert run(command) == 2
    assert (
        "the uid of board gyro-1 is U1 in the recording 1.mcap, and U2" in capsys.readouterr().err
    )


def test_each_recording_is_compared_with_the_store(tmp_path: Path) -> None:
    """The batch compared only the first recording of a job."""
    paths = [
        attitudes(tmp_path / f"{k}.mcap", GYRO, k, uid=uid)
        for k, uid in ((1, "unknown"), (2, "NEW"))
    ]
    recordings = [read_recording(path) for path in paths]
    stored = BoardRecord(BOARD, "OLD", "ICM-20948", BoardSettings())
    check_stored_board(stored, recordings[:1])
    with pytest.raises(InputError, match=r"the uid 'NEW' in the recording 2\.mcap, but 'OLD'"):
        check_stored_board(stored, recordings)
    with pytest.raises(InputError, match="the sensor 'ICM-20948'"):
        check_stored_board(replace_sensor(stored, "MPU-6050"), recordings[:1])


def replace_sensor(stored: BoardRecord, sensor: str) -> BoardRecord:
    return BoardRecord(stored.id, stored.uid, sensor, stored.config)


def test_temperatures_without_an_offset_have_no_mean_with_others(tmp_path: Path) -> None:
    """Readings of 3 K above an unknown zero, and of 25 degC, were averaged to 14 degC."""
    recording = read_recording(attitudes(tmp_path / "1.mcap", GYRO, 1))
    time_s, rate = np.arange(100.0), np.zeros((100, 3))
    relative, absolute = (
        replace(
            plain_samples(time_s, rate),
            temperature_degc=np.full(100, degc),
            metadata=metadata,
        )
        for degc, metadata in ((3.0, {}), (25.0, {"temperature_offset_c": "21.0"}))
    )
    mixed = read_contexts([(recording, relative, None), (recording, absolute, None)])
    assert mixed[0].temperature is None
    assert mixed[1].temperature is not None
    assert mixed[1].temperature.mean_degc == 25.0
    same = read_contexts([(recording, relative, None), (recording, relative, None)])
    assert all(context.temperature is not None for context in same)


@pytest.mark.parametrize("uid", ["U1", "U2", "unknown"])
def test_a_new_version_of_another_board_has_a_remark(
    tmp_path: Path, capsys: Captured, uid: str
) -> None:
    paths = [
        attitudes(tmp_path / f"{k}.mcap", GYRO, k, uid=one_uid)
        for k, one_uid in enumerate(("U1", uid))
    ]
    for path in paths:
        capsys.readouterr()
        words = ["solve", str(path), "--out", str(tmp_path / "out"), "--extend", "none"]
        assert run([*words, "--json"]) == 0
    solved = json.loads(capsys.readouterr().out)
    remark = solved["boards"][0].get("other_board")
    assert (remark is not None) == (uid == "U2")
    assert remark is None or "U2, and U1 in version 1, so two boards have" in remark
