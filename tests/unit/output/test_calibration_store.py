"""The store: versions chain by digest, nothing is lost to races, crashes or full disks."""

import errno
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.pipeline import solve_board
from gyrorig_solver.storage import write_file

BOARD = BoardId("GY80-0007")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_versions_count_up_and_name_the_digest_before(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    first = store.add_version(BOARD, lambda n, before: f"{n} {before}\n")
    second = store.add_version(BOARD, lambda n, before: f"{n} {before}\n")
    assert first.path.name == "v0001.yaml"
    assert first.path.read_text() == "1 None\n"
    digest = hashlib.sha256(first.path.read_bytes()).hexdigest()
    assert second.path.read_text() == f"2 sha256:{digest}\n"
    assert [v.number for v in store.versions(BOARD)] == [1, 2]
    assert names(tmp_path / BOARD) == ["v0001.yaml", "v0002.yaml"]


def test_a_lost_race_takes_the_next_number_and_the_new_digest(tmp_path: Path) -> None:
    store = CalibrationStore(tmp_path)
    rival = CalibrationStore(tmp_path)
    calls = []

    def text(number: int, before: str | None) -> str:
        calls.append(number)
        if number == 1:  # another solver is faster
            rival.add_version(BOARD, lambda n, _: f"rival {n}\n")
        return f"mine {number} {before}\n"

    mine = store.add_version(BOARD, text)
    assert calls == [1, 2]
    assert (tmp_path / BOARD / "v0001.yaml").read_text() == "rival 1\n"
    digest = hashlib.sha256(b"rival 1\n").hexdigest()
    assert mine.path.read_text() == f"mine 2 sha256:{digest}\n"


def test_a_version_that_appears_after_the_check_is_checked(tmp_path: Path) -> None:
    """The check of a board compares it with all versions before the written one."""
    store = CalibrationStore(tmp_path)
    checked: list[list[int]] = []

    def check() -> None:
        checked.append([version.number for version in store.versions(BOARD)])
        if len(checked) == 1:  # another solver adds its version right after the check
            store.add_version(BOARD, lambda _n, _b: "rival\n")

    added = store.add_version(BOARD, lambda _n, _b: "mine\n", check)
    assert added.number == 2
    assert checked == [[], [1]]


RIVAL = """
import sys
from pathlib import Path
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.calibration_store import CalibrationStore
store = CalibrationStore(Path(sys.argv[1]))
for k in range(15):
    store.add_version(BoardId("B"), lambda n, before: f"{sys.argv[2]}-{k} {before}\\n")
"""


def test_two_processes_write_without_loss(tmp_path: Path) -> None:
    rivals = [subprocess.Popen([sys.executable, "-c", RIVAL, str(tmp_path), name]) for name in "ab"]
    assert [rival.wait() for rival in rivals] == [0, 0]
    versions = CalibrationStore(tmp_path).versions(BoardId("B"))
    assert [v.number for v in versions] == list(range(1, 31))
    texts = [v.path.read_text().split() for v in versions]
    assert {t[0] for t in texts} == {f"{name}-{k}" for name in "ab" for k in range(15)}
    assert [t[1] for t in texts[1:]] == [v.digest() for v in versions[:-1]]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EPERM, errno.EIO])
def test_failed_write_leaves_no_file(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = CalibrationStore(tmp_path)
    store.add_version(BOARD, lambda _n, _b: "first\n")

    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(MachineError) as refused:
        store.add_version(BOARD, lambda _n, _b: "second\n")
    assert refused.value.remedy
    assert "\n" not in str(refused.value)
    assert names(tmp_path / BOARD) == ["v0001.yaml"]


def test_other_files_are_not_versions(tmp_path: Path) -> None:
    (tmp_path / BOARD).mkdir()
    for name in ("v1.yaml", "v0007.report.html", ".v0009.yaml.abc", "notes.txt"):
        (tmp_path / BOARD / name).write_text("x")
    assert CalibrationStore(tmp_path).add_version(BOARD, lambda n, _: str(n)).number == 1


def test_file_in_the_place_of_the_folder_is_reported_first(tmp_path: Path) -> None:
    (tmp_path / BOARD).write_text("in the way")
    with pytest.raises(MachineError, match="--out"):
        CalibrationStore(tmp_path).prepare_folder(BOARD)
    with pytest.raises(MachineError, match="is a file"):
        CalibrationStore(tmp_path).check_folder(BOARD)


def test_a_check_of_the_folder_creates_nothing(tmp_path: Path) -> None:
    CalibrationStore(tmp_path / "new").check_folder(BOARD)
    assert names(tmp_path) == []


def test_write_file_replaces_only_if_asked(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    assert write_file(path, b"one", replace=False)
    assert not write_file(path, b"two", replace=False)
    assert path.read_bytes() == b"one"
    assert write_file(path, b"three", replace=True)
    assert path.read_bytes() == b"three"
    assert names(tmp_path) == ["report.html"]


def test_a_refused_solve_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, the empty folder of the board stayed."""

    def refuse(*_: object) -> None:
        raise InputError("the recording has no motion", "record again")

    monkeypatch.setattr(solve_board, "load_board", refuse)
    with pytest.raises(InputError):
        solve_board.solve_and_store(CalibrationStore(tmp_path / "new"), [], BOARD)
    assert names(tmp_path) == []
