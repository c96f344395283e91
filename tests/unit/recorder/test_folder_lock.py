"""Who may only read the folder of the recordings cannot keep the recorder from creating a file."""

import fcntl
import os
import time
from pathlib import Path

import pytest

from gyrorig_protocol.recording.mcap import disk_file
from gyrorig_protocol.recording.mcap.disk_file import DiskFile, list_abandoned_files


def test_a_lock_on_the_folder_delays_a_file_for_a_bounded_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk_file, "FOLDER_LOCK_S", 0.2)
    reader = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(reader, fcntl.LOCK_EX)
    begun_s = time.monotonic()
    file = DiskFile(tmp_path / "a.mcap.part")
    assert time.monotonic() - begun_s < 5.0
    file.write(b"samples")
    file.close()
    os.close(reader)
    assert (tmp_path / "a.mcap.part").read_bytes() == b"samples"


def test_a_lock_on_the_folder_delays_the_recovery_for_a_bounded_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk_file, "FOLDER_LOCK_S", 0.2)
    for name, age_s in (("old", 60.0), ("new", -60.0)):
        (tmp_path / f"{name}.mcap.part").write_bytes(b"samples")
        os.utime(tmp_path / f"{name}.mcap.part", (time.time() - age_s,) * 2)
    reader = os.open(tmp_path, os.O_RDONLY)
    fcntl.flock(reader, fcntl.LOCK_EX)
    begun_s = time.monotonic()
    listed = list_abandoned_files(tmp_path, "*.part")
    assert time.monotonic() - begun_s < 5.0
    assert [path.name for path in listed] == ["old.mcap.part"]  # the new one may lack its lock yet
    os.close(reader)
    assert len(list_abandoned_files(tmp_path, "*.part")) == 2
