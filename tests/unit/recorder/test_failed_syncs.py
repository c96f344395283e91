"""A sync that fails while a part is ended: the next part takes what was not synced."""

import errno
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan, sync_tracker
from gyrorig_daemon.recorder.recovery import recover_folder
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.writer import RecordingWriter

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"
SAMPLE_NS = 10_000_000

Sequences = Callable[[Path], list[int]]


def sample(k: int) -> ImuRaw:
    return ImuRaw(k * SAMPLE_NS, k, k, 0, 0, (k, k, k))


class SlowFailure:
    """The decision of a disk: the next operation fails after 0.3 s, once `is_armed` is set."""

    def __init__(self) -> None:
        self.is_armed = threading.Event()
        self.has_started = threading.Event()

    def __call__(self, _: int) -> int:
        is_disk_thread = threading.current_thread().name == "disk"
        if not self.is_armed.is_set() or self.has_started.is_set() or not is_disk_thread:
            return 0
        self.has_started.set()
        time.sleep(0.3)
        return errno.EIO


def test_a_sync_that_fails_during_close(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    failure = SlowFailure()
    settings = RecorderSettings(survives_faults=True)
    recorder = Recorder(True, settings, disk=failing_disk(failure))
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    k, start_s = 0, time.monotonic()
    while not failure.has_started.is_set():
        recorder.put(TOPIC, sample(k), k * SAMPLE_NS)
        k += 1
        time.sleep(0.002)
        if time.monotonic() - start_s > 1.5:
            failure.is_armed.set()
    recorder.close()
    assert recorder.counts.disk_faults == 1
    assert recorder.counts.lost == 0
    recover_folder(tmp_path)
    assert sequences_in(tmp_path) == list(range(k))


def test_a_file_whose_sync_failed_is_never_finished(tmp_path: Path, failing_disk: Any) -> None:
    disk = failing_disk()
    path = tmp_path / "a.mcap"
    writer = RecordingWriter(path, METADATA, disk=disk, owner_syncs=True)
    writer.write(TOPIC, sample(0))
    writer.flush()
    disk.decide = lambda _: errno.EIO
    with pytest.raises(OSError, match="the test says so"):
        writer.sync()
    disk.decide = lambda _: 0
    with pytest.raises(MachineError, match="cannot be written"):
        writer.close()
    assert not path.exists()


def test_a_failed_last_sync_of_a_part_is_counted(
    tmp_path: Path, failing_disk: Any, sequences_in: Sequences
) -> None:
    disk = failing_disk()
    settings = RecorderSettings(sync_s=100.0, survives_faults=True, reserve_bytes=1000)
    recorder = Recorder(False, settings, disk=disk)
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    recorder.tick(0)
    for k in range(10):
        recorder.put(TOPIC, sample(k), k * SAMPLE_NS)
    disk.decide = lambda _: errno.EIO if disk.free < 1000 and is_last_sync() else 0

    def is_last_sync() -> bool:
        """Whether the file has its summary, which only its last sync follows."""
        return (tmp_path / "a.mcap.part").read_bytes().endswith(b"\x89MCAP0\r\n")

    disk.free = 1
    recorder.tick(5_000_000_000)  # the file is closed, because there is too little space
    recorder.tick(5_100_000_000)
    assert recorder.counts.close_failures == 1
    assert recorder.counts.dropped_unsynced == recorder.counts.lost == 10
    disk.decide, disk.free = (lambda _: 0), 1 << 40
    recorder.close()
    recover_folder(tmp_path)
    assert sequences_in(tmp_path) == []


@pytest.mark.parametrize("synced_count", [0, 4])
def test_unsynced_messages_that_are_not_in_memory_are_counted(
    tmp_path: Path,
    failing_disk: Any,
    sequences_in: Sequences,
    monkeypatch: pytest.MonkeyPatch,
    synced_count: int,
) -> None:
    monkeypatch.setattr(sync_tracker, "MAX_UNSYNCED_RECORDS", 5)
    disk = failing_disk()
    settings = RecorderSettings(survives_faults=True, sync_s=1.0)
    recorder = Recorder(False, settings, disk=disk)
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    recorder.tick(1_000_000_000)
    for k in range(synced_count):
        recorder.put(TOPIC, sample(k), k * SAMPLE_NS)
    recorder.tick(3_000_000_000)
    for k in range(synced_count, synced_count + 10):
        recorder.put(TOPIC, sample(k), k * SAMPLE_NS)
    disk.decide = lambda _: errno.EIO
    recorder.tick(5_000_000_000)
    disk.decide = lambda _: 0
    recorder.close()
    assert recorder.counts.dropped_unsynced == recorder.counts.lost == 5
    recover_folder(tmp_path)
    numbers = [*range(synced_count), *range(synced_count + 5, synced_count + 10)]
    assert sequences_in(tmp_path) == numbers
