"""Disk errors of every kind at every moment: the recording continues, and nothing is lost.

Rows 12 and 13 of the fault table in docs/faults.md.
"""

import errno
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecorderState, RecordingPlan
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.messages import EventKind, ImuRaw, SessionEvent
from gyrorig_protocol.recording.reader import read_recording

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"
SECOND = 1_000_000_000
PER_SECOND = 8

Sequences = Callable[[Path], list[int]]


def sample(k: int) -> ImuRaw:
    return ImuRaw(k * SECOND // PER_SECOND, k, k & 0xFFFFFFFF, 0, 0, (k, k, k))


class Session:
    """A recorder under simulated time, given `PER_SECOND` samples a second."""

    def __init__(self, folder: Path, settings: RecorderSettings, disk: Any) -> None:
        self.disk = disk
        self.recorder = Recorder(False, settings, disk=disk)
        self.recorder.open(RecordingPlan(folder / "a.mcap", METADATA, ()))
        self.k = 0

    def run(self, seconds: float) -> None:
        for _ in range(int(seconds * PER_SECOND)):
            self.recorder.put(TOPIC, sample(self.k), self.k * SECOND // PER_SECOND)
            self.k += 1
            if self.k % 4 == 0:
                self.recorder.tick(self.k * SECOND // PER_SECOND)


def state(recorder: Recorder) -> str:
    return recorder.state.value


def once(numbers: list[int]) -> list[int]:
    """Each sample once: where cutting back is refused, those of one sync may be there twice."""
    assert len(numbers) - len(set(numbers)) <= 2 * PER_SECOND
    return sorted(set(numbers))


SURVIVE = RecorderSettings(part_s=6.0, survives_faults=True)


CODES = (errno.ENOSPC, errno.EROFS, errno.EIO)


def fail_at(
    folder: Path, disk_type: Any, sequences_in: Sequences, first: int, lasting: int, code: int
) -> int:
    """One session whose disk refuses `lasting` operations; returns samples that are there twice."""
    folder.mkdir()
    disk = disk_type(lambda n: code if first <= n < first + lasting else 0)
    try:
        session = Session(folder, SURVIVE, disk)
    except MachineError:
        return 0  # the first part could not be opened: said at once
    session.run(28)
    session.recorder.close()
    assert session.recorder.state is RecorderState.CLOSED
    reports = recover_folder(folder)
    assert all(report.outcome is not RecoveryOutcome.FAILED for report in reports)
    numbers = sequences_in(folder)
    assert sorted(set(numbers)) == list(range(session.k))
    assert session.recorder.counts.lost == 0
    return len(numbers) - len(set(numbers))


def operations_of_a_session(folder: Path, disk_type: Any, sequences_in: Sequences) -> int:
    disk = disk_type()
    folder.mkdir()
    session = Session(folder, SURVIVE, disk)
    session.run(14)
    session.recorder.close()
    assert sequences_in(folder) == list(range(session.k))
    count: int = disk.operations
    assert count > 60
    return count - 20  # the last ones belong to the end, after which nobody tries again


@pytest.mark.parametrize("lasting", [1, 4])
def test_every_operation_fails_once(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences, lasting: int
) -> None:
    """A fault at each operation in turn, alone or with the next ones: all is kept."""
    operations = operations_of_a_session(tmp_path / "whole", failing_disk, sequences_in)
    for first in range(1, operations):
        code = CODES[first % len(CODES)]
        folder = tmp_path / str(first)
        doubled = fail_at(folder, failing_disk, sequences_in, first, lasting, code)
        # Where cutting back is refused too, a chunk that was whole already is there twice.
        assert doubled == 0 or lasting > 1, first


@pytest.mark.bench
@pytest.mark.timeout(1800)
def test_every_operation_fails_in_every_way(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    operations = operations_of_a_session(tmp_path / "whole", failing_disk, sequences_in)
    runs = doubled = 0
    for code in CODES:
        for lasting in (1, 2, 3, 4, 5):
            for first in range(1, operations):
                folder = tmp_path / f"{code}-{lasting}-{first}"
                doubled += fail_at(folder, failing_disk, sequences_in, first, lasting, code)
                runs += 1
    sys.stdout.write(f"{runs} sessions with a failing disk: lost 0, twice in files {doubled}\n")


def test_the_last_minutes_are_kept(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences, events_in: Any
) -> None:
    disk = failing_disk()
    session = Session(tmp_path, RecorderSettings(survives_faults=True, ram_s=60.0), disk)
    session.run(10)
    disk.decide = lambda _: errno.EROFS
    session.run(40)
    recorder = session.recorder
    assert state(recorder) == "degraded"
    assert "cannot" in recorder.degraded_reason
    assert recorder.counts.memory_messages > 39 * PER_SECOND
    assert recorder.counts.open_failures >= 5
    disk.decide = lambda _: 0
    session.run(20)
    assert state(recorder) == "recording"
    assert recorder.degraded_reason == ""
    recorder.close()
    recover_folder(tmp_path)
    assert once(sequences_in(tmp_path)) == list(range(session.k))
    assert any("continues in memory" in text for text in events_in(tmp_path))
    assert any("continues in a_p001.mcap" in text for text in events_in(tmp_path))
    parts = [read_recording(path).metadata["gyrorig"] for path in sorted(tmp_path.glob("*.mcap"))]
    assert [(part["part"], part["previous"]) for part in parts] == [("0", ""), ("1", "a.mcap")]


def test_memory_is_bounded_and_dropped_messages_are_a_gap(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    disk = failing_disk()
    settings = RecorderSettings(survives_faults=True, ram_bytes=100_000, ram_s=1e9)
    session = Session(tmp_path, settings, disk)
    session.run(10)
    disk.decide = lambda _: errno.ENOSPC
    session.run(1000)
    counts = session.recorder.counts
    assert counts.memory_high_water_bytes < 450_000  # a block more than told
    assert counts.dropped_from_memory > 0
    assert counts.lost == counts.dropped_from_memory
    disk.decide = lambda _: 0
    session.run(30)
    session.recorder.close()
    recover_folder(tmp_path)
    numbers = once(sequences_in(tmp_path))
    lost = [k for k in range(session.k) if k not in set(numbers)]
    assert len(lost) in (counts.lost, counts.lost - 1)  # the word of the fault went too
    assert lost == list(range(lost[0], lost[-1] + 1))  # one gap, the oldest of the outage


def test_the_reserve_is_kept_free(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    disk = failing_disk()
    settings = RecorderSettings(survives_faults=True, reserve_bytes=1 << 30)
    session = Session(tmp_path, settings, disk)
    session.run(10)
    disk.free = (1 << 30) - 1
    session.run(10)
    recorder = session.recorder
    assert state(recorder) == "degraded"
    assert "MiB of free space" in recorder.degraded_reason
    assert recorder.counts.room_stops == 1
    # Closed cleanly while there was room, not torn by ENOSPC.
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert recorder.counts.disk_faults == 0
    disk.free = (1 << 30) + 1000  # not enough to begin again: no flutter at the edge
    session.run(10)
    assert state(recorder) == "degraded"
    disk.free = 2 << 30
    session.run(10)
    assert state(recorder) == "recording"
    recorder.close()
    assert sequences_in(tmp_path) == list(range(session.k))


def test_space_is_freed_before_recording_stops(tmp_path: Path, failing_disk: Any) -> None:
    disk = failing_disk()
    asked: list[int] = []

    def make_room() -> None:
        asked.append(1)
        disk.free = 3 << 30

    settings = RecorderSettings(survives_faults=True, reserve_bytes=1 << 30)
    recorder = Recorder(False, settings, make_room, disk)
    disk.free = 1
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    disk.free = 1
    recorder.tick(5 * SECOND)
    assert len(asked) == 2
    assert state(recorder) == "recording"
    recorder.close()


def test_missing_space_at_the_start_is_an_error(tmp_path: Path, failing_disk: Any) -> None:
    disk = failing_disk()
    disk.free = 1
    recorder = Recorder(
        False, RecorderSettings(survives_faults=True, reserve_bytes=1 << 30), disk=disk
    )
    with pytest.raises(MachineError, match="MiB of free space"):
        recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    assert recorder.state is RecorderState.IDLE
    assert not list(tmp_path.iterdir())


def test_a_disk_that_never_comes_back_is_counted_at_the_end(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    disk = failing_disk()
    session = Session(tmp_path, SURVIVE, disk)
    session.run(5)
    disk.decide = lambda _: errno.EROFS
    session.run(5)
    with pytest.raises(MachineError, match="messages in memory are lost"):
        session.recorder.close()
    assert session.recorder.counts.dropped_at_close >= 5 * PER_SECOND
    recover_folder(tmp_path)
    numbers = sequences_in(tmp_path)
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 4 * PER_SECOND


def test_one_bad_message_does_not_end_a_long_recording(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    session = Session(tmp_path, SURVIVE, failing_disk())
    session.run(1)
    recorder = session.recorder
    recorder.put(TOPIC, sample(2), sample(2).host_time_ns)  # goes back in time
    recorder.put(TOPIC, ImuRaw(1 << 70, 0, 0, 0, 0, (0, 0, 0)), 1 << 70)
    recorder.put("/session/event", SessionEvent(0, EventKind.NOTE, "", "in time"), 0)
    assert recorder.counts.refused == 2
    session.run(1)
    recorder.close()
    with pytest.raises(AssertionError):  # both left a gap: they are in no file
        sequences_in(tmp_path)
    numbers = read_recording(tmp_path / "a.mcap").array(TOPIC)["message_sequence"]
    assert len(numbers) == 2 * PER_SECOND
    assert numbers[-1] == 2 * PER_SECOND + 1
