"""A file is written whole or not at all."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from gyrorig_protocol.atomic_files import (
    lock_temporary,
    remove_leftovers,
    sync_directory,
    write_atomically,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_new_file_has_all_bytes_and_the_mode(tmp_path: Path) -> None:
    path = tmp_path / "state.yaml"
    assert write_atomically(path, b"a: 1\n", mode=0o600)
    assert path.read_bytes() == b"a: 1\n"
    assert path.stat().st_mode & 0o777 == 0o600
    assert names(tmp_path) == ["state.yaml"]


def test_the_mode_does_not_depend_on_the_umask(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        write_atomically(tmp_path / "x", b"")
    finally:
        os.umask(before)
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o644


def test_an_existing_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")
    assert write_atomically(path, b"new")
    assert path.read_bytes() == b"new"


def test_an_existing_file_is_kept_if_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")
    assert not write_atomically(path, b"new", replace=False)
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["x"]


def test_a_free_name_is_taken_without_replacing(tmp_path: Path) -> None:
    path = tmp_path / "x"
    assert write_atomically(path, b"new", replace=False, mode=0o640)
    assert path.read_bytes() == b"new"
    assert path.stat().st_nlink == 1
    assert path.stat().st_mode & 0o777 == 0o640
    assert names(tmp_path) == ["x"]


@pytest.mark.parametrize("step", ["fsync", "fchmod"])
def test_after_an_error_the_old_file_is_there_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "x"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, step, refuse)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["x"]


def test_file_and_folder_are_synced_before_it_returns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[str] = []
    real_fsync = os.fsync

    def fsync(descriptor: int) -> None:
        kind = "folder" if Path(f"/proc/self/fd/{descriptor}").resolve().is_dir() else "file"
        synced.append(kind)
        real_fsync(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    write_atomically(tmp_path / "x", b"1")
    assert synced == ["file", "folder"]
    synced.clear()
    write_atomically(tmp_path / "y", b"1", durable=False)
    assert synced == []


def test_a_missing_folder_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "missing" / "x", b"1")
    with pytest.raises(FileNotFoundError):
        sync_directory(tmp_path / "missing")


def test_the_folder_is_closed_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[int] = []
    real_open = os.open

    def open_folder(path: Path, flags: int) -> int:
        opened.append(real_open(path, flags))
        return opened[-1]

    monkeypatch.setattr(os, "open", open_folder)
    sync_directory(tmp_path)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(opened[0])


KILLED = """
import os, pathlib, signal, sys
from gyrorig_protocol.atomic_files import write_atomically
os.fchmod = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
write_atomically(pathlib.Path(sys.argv[1]), b"new")
"""


def make_old(path: Path) -> Path:
    path.touch()
    os.utime(path, (1e9, 1e9))
    return path


def test_a_file_that_a_killed_process_has_left_is_removed(tmp_path: Path) -> None:
    killed = subprocess.run([sys.executable, "-c", KILLED, tmp_path / "a.json"], check=False)
    assert killed.returncode == -signal.SIGKILL
    (leftover,) = tmp_path.iterdir()
    assert remove_leftovers(tmp_path, ".json") == 0  # too new
    make_old(leftover)
    assert remove_leftovers(tmp_path, ".yaml") == 0
    assert remove_leftovers(tmp_path, "a.json") == 1
    assert names(tmp_path) == []


def test_a_file_that_is_being_written_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    removed: list[int] = []
    fchmod = os.fchmod

    def remove_meanwhile(descriptor: int, mode: int) -> None:
        (temporary,) = tmp_path.iterdir()
        make_old(temporary)
        removed.append(remove_leftovers(tmp_path, ".json"))
        fchmod(descriptor, mode)

    monkeypatch.setattr(os, "fchmod", remove_meanwhile)
    write_atomically(tmp_path / "a.json", b"new")
    assert removed == [0]
    assert (tmp_path / "a.json").read_bytes() == b"new"


def test_other_files_are_no_leftovers(tmp_path: Path) -> None:
    others = [
        ".a.json",
        "a.json",
        ".a.json.abc",
        ".a.json.ABCDEFGH",
        "b.json.abcdefgh",
        ".abcdefgh",
    ]
    for name in others:
        make_old(tmp_path / name)
    (tmp_path / ".l.json.abcdefgh").symlink_to(tmp_path / "a.json")
    (tmp_path / ".d.json.abcdefgh").mkdir()
    os.mkfifo(tmp_path / ".p.json.abcdefgh")
    before = names(tmp_path)
    assert remove_leftovers(tmp_path, ".json") == 0
    assert names(tmp_path) == before
    assert remove_leftovers(tmp_path / "none", ".json") == 0


def test_a_lock_that_the_file_system_lacks_is_no_fault() -> None:
    read_fd, write_fd = os.pipe()
    os.close(read_fd)
    lock_temporary(write_fd)
    os.close(write_fd)
