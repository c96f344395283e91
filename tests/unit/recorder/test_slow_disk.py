"""A slow disk in real time: nobody waits for it."""

import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan, part_schedule
from gyrorig_daemon.recorder.recovery import recover_folder
from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.reader import read_recording

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"
PATIENCE_S = 60.0

Sequences = Callable[[Path], list[int]]


def wait_for(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not what():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)


class StuckDisk(Disk):
    """Syncs wait for `flows`, and so does everything that syncs."""

    def __init__(self) -> None:
        self.flows = threading.Event()
        self.flows.set()
        self.code = 0

    def _pass(self) -> None:
        assert self.flows.wait(PATIENCE_S)
        if self.code:
            raise OSError(self.code, "the test says so")

    def create(self, path: Path) -> DiskFile:
        self._pass()
        file = super().create(path)
        write = file.write

        def checked(data: bytes) -> int:
            if self.code:
                raise OSError(self.code, "the test says so")
            return write(data)

        file.sync = self._pass  # type: ignore[method-assign]
        file.write = checked  # type: ignore[method-assign]
        return file

    def sync_directory(self, folder: Path) -> None:
        self._pass()


class Feed:
    """Samples into a threaded recorder, as fast as it takes them."""

    def __init__(self, folder: Path, settings: RecorderSettings, disk: Disk) -> None:
        self.recorder = Recorder(True, settings, disk=disk)
        self.recorder.open(RecordingPlan(folder / "a.mcap", METADATA, ()))
        self.k = 0

    def give(self, count: int) -> None:
        for _ in range(count):
            self.recorder.put(TOPIC, ImuRaw(self.k, self.k, self.k, 0, 0, (0, 0, 0)), self.k)
            self.k += 1

    def give_until(self, what: Callable[[], bool]) -> None:
        def more() -> bool:
            self.give(10)
            return what()

        wait_for(more)


def test_a_sync_that_hangs_delays_nobody(tmp_path: Path, sequences_in: Sequences) -> None:
    disk = StuckDisk()
    feed = Feed(tmp_path, RecorderSettings(sync_s=0.05), disk)
    counts = feed.recorder.counts
    disk.flows.clear()
    feed.give_until(lambda: counts.disk_busy_ms > 300)  # a sync is under way, and hangs
    before = feed.k
    feed.give(20_000)
    wait_for(lambda: counts.written == before + 20_000)
    assert counts.disk_busy_ms > 300
    assert counts.lost == 0
    beat_ns = feed.recorder.progress_ns
    wait_for(lambda: feed.recorder.progress_ns > beat_ns)
    disk.flows.set()
    wait_for(lambda: counts.syncs > 1)
    assert counts.sync_max_ms > 300
    feed.recorder.close()
    assert sequences_in(tmp_path) == list(range(feed.k))


def samples_in(path: Path) -> int:
    recording = read_recording(path)
    return len(recording.array(TOPIC)) if TOPIC in recording.topics else 0


class StuckFromTheStart(StuckDisk):
    """Files are created at once, and the first sync hangs."""

    def create(self, path: Path) -> DiskFile:
        file = super().create(path)
        self.flows.clear()
        return file


def test_a_kill_before_the_first_sync_is_done(tmp_path: Path, sequences_in: Sequences) -> None:
    disk = StuckFromTheStart()
    feed = Feed(tmp_path, RecorderSettings(), disk)  # was waited for: up to 4 s were lost so
    feed.give(1_000)
    part = tmp_path / "a.mcap.part"
    wait_for(lambda: samples_in(part) == 1_000)
    wait_for(lambda: feed.recorder.counts.disk_busy_ms > 0)  # the first sync hangs still
    killed = tmp_path / "killed"
    killed.mkdir()
    shutil.copy(part, killed)
    disk.flows.set()
    feed.recorder.close()
    assert sequences_in(tmp_path) == list(range(1_000))
    recover_folder(killed)
    assert sequences_in(killed) == list(range(1_000))


def test_the_next_part_is_open_before_the_last_is_closed(
    tmp_path: Path, sequences_in: Sequences
) -> None:
    disk = StuckDisk()
    feed = Feed(tmp_path, RecorderSettings(part_s=0.2, sync_s=1e9), disk)
    counts = feed.recorder.counts
    disk.flows.clear()
    feed.give_until(lambda: counts.disk_busy_ms > 300)  # the next part is being opened: hangs
    before = feed.k
    feed.give(5_000)
    wait_for(lambda: counts.written == before + 5_000)  # and the first one goes on
    assert counts.parts_opened == 1
    disk.flows.set()
    feed.give_until(lambda: counts.rotations >= 3)
    feed.recorder.close()
    assert counts.lost == 0
    assert len(feed.recorder.paths) == counts.parts_closed == counts.parts_opened
    assert sequences_in(tmp_path) == list(range(feed.k))


def test_a_disk_that_fails_and_comes_back(
    tmp_path: Path, sequences_in: Sequences, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part_schedule, "RETRY_NS", 50_000_000)
    disk = StuckDisk()
    feed = Feed(tmp_path, RecorderSettings(survives_faults=True), disk)
    recorder, counts = feed.recorder, feed.recorder.counts
    feed.give(1_000)
    disk.code = 30  # EROFS
    feed.give_until(lambda: bool(recorder.degraded_reason))
    feed.give(20_000)
    wait_for(lambda: counts.memory_messages >= 20_000)
    disk.code = 0
    feed.give_until(lambda: not recorder.degraded_reason and counts.memory_messages == 0)
    recorder.close()
    assert counts.resumes == 1
    assert counts.lost == 0
    recover_folder(tmp_path)
    assert sequences_in(tmp_path) == list(range(feed.k))
