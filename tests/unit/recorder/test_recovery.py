"""Recovery next to a running recorder, next to another recovery, and of damaged files."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan, recovery
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, RecoveryReport, recover_folder
from gyrorig_protocol.recording.mcap.disk_file import Disk, hold_lock
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.salvage import read_strictly
from gyrorig_protocol.recording.writer import RecordingWriter

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"


def leave_unfinished(folder: Path, name: str = "a.mcap", count: int = 500) -> Path:
    """A file as a killed process leaves it."""
    writer = RecordingWriter(folder / name, METADATA)
    for k in range(count):
        writer.write(TOPIC, ImuRaw(k, k, k, 0, 0, (k, k, k)))
        if k % 100 == 99:
            writer.flush()
    writer.truncate_and_close()  # lets go of the lock, as the system does of a killed process's
    return writer.path


def count(path: Path) -> int:
    return len(read_recording(path).array(TOPIC))


def test_a_file_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    recorder = Recorder(False, RecorderSettings())
    recorder.open(RecordingPlan(tmp_path / "live.mcap", METADATA, ()))
    leave_unfinished(tmp_path)
    assert [report.outcome for report in recover_folder(tmp_path)] == [RecoveryOutcome.RECOVERED]
    for k in range(10):
        recorder.put(TOPIC, ImuRaw(k, k, k, 0, 0, (0, 0, 0)), k)
    assert count(recorder.close()) == 10
    assert sorted(path.name for path in tmp_path.glob("*.mcap")) == ["a.mcap", "live.mcap"]


def test_a_file_that_another_process_recovers_is_left_alone(tmp_path: Path) -> None:
    part = leave_unfinished(tmp_path)
    with hold_lock(part) as free:
        assert free
        assert recover_folder(tmp_path) == []
    assert len(recover_folder(tmp_path)) == 1


RECOVER = """
import sys
from pathlib import Path
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
reports = recover_folder(Path(sys.argv[1]))
print(sum(report.outcome is RecoveryOutcome.RECOVERED for report in reports))
"""


def test_recoveries_at_once(tmp_path: Path) -> None:
    for number in range(12):
        leave_unfinished(tmp_path, f"r{number}.mcap", 300)
    command = [sys.executable, "-c", RECOVER, str(tmp_path)]
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    counts = [int(process.communicate(timeout=100)[0]) for process in running]
    assert [process.returncode for process in running] == [0, 0, 0]
    recover_folder(tmp_path)
    assert sum(counts) <= 12
    assert sorted(count(path) for path in tmp_path.glob("*.mcap")) == [300] * 12
    assert len(list(tmp_path.glob("unclean/*.part"))) == 12
    assert not list(tmp_path.glob("*.recovering"))


def test_a_recovery_while_another_verifies_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_unfinished(tmp_path)
    other_reports: list[RecoveryReport] = []

    def verify_slowly(path: Path) -> dict[str, int]:
        other_reports.extend(recover_folder(tmp_path))
        return read_strictly(path)

    monkeypatch.setattr(recovery, "read_strictly", verify_slowly)
    (report,) = recover_folder(tmp_path)
    assert report.outcome is RecoveryOutcome.RECOVERED
    assert other_reports == []
    assert count(tmp_path / "a.mcap") == 500


@pytest.mark.parametrize("has_original", [True, False])
def test_an_abandoned_file_in_progress_is_deleted(tmp_path: Path, has_original: bool) -> None:
    if has_original:
        leave_unfinished(tmp_path)
    abandoned = tmp_path / "a.mcap.recovering"
    abandoned.write_bytes(b"incomplete")
    os.utime(abandoned, (0, 0))
    assert len(recover_folder(tmp_path)) == has_original
    assert not abandoned.exists()


def test_a_file_without_messages_is_set_aside(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap.part").touch()
    (tmp_path / "noise.mcap.part").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (tmp_path / "half.mcap.recovering").write_bytes(b"half")
    reports = recover_folder(tmp_path)
    assert [report.outcome for report in reports] == [RecoveryOutcome.EMPTY, RecoveryOutcome.EMPTY]
    names = sorted(path.name for path in (tmp_path / "unclean").iterdir())
    assert [name for name in names if name.endswith(".part")] == [
        "empty.mcap.part",
        "noise.mcap.part",
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["unclean"]


def test_a_recording_of_that_name_is_not_replaced(tmp_path: Path) -> None:
    part = leave_unfinished(tmp_path)
    (tmp_path / "a.mcap").write_bytes(b"precious")
    (report,) = recover_folder(tmp_path)
    assert report.recording == tmp_path / "a_recovered.mcap"
    assert count(report.recording) == 500
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    assert not part.exists()


class Full(Disk):
    def free_bytes(self, folder: Path) -> int:
        return 1000


def test_recovery_waits_for_free_space(tmp_path: Path) -> None:
    part = leave_unfinished(tmp_path)
    (report,) = recover_folder(tmp_path, disk=Full())
    assert report.outcome is RecoveryOutcome.FAILED
    assert "Free some disk space" in report.text
    assert part.exists()
    assert recover_folder(tmp_path)[0].outcome is RecoveryOutcome.RECOVERED


@pytest.mark.parametrize("name", ["nowhere", "file"])
def test_a_missing_folder_is_not_an_error(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    assert recover_folder(tmp_path / name) == []
