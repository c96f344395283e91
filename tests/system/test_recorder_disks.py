"""Real file systems: one that is full, one that turns read-only. Needs root; else skipped."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecorderState, RecordingPlan
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
from gyrorig_daemon.service.jobs import enqueue_job
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.reader import read_recording

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"
SECOND = 1_000_000_000
PER_SECOND = 100


GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 90.0
    while not condition():
        assert time.monotonic() < end_s, "it did not come true"
        time.sleep(0.05)


def run(*command: str) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """512 KiB of tmpfs."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if os.geteuid() != 0 or not run("mount", "-t", "tmpfs", "-o", "size=512k", "no", str(folder)):
        pytest.skip("mounting a file system needs root, and a container that allows it")
    yield folder
    run("umount", "-l", str(folder))


class Card:
    """An ext4 file system in a file, which can be made to fail as a dying card does."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "card"
        self._image = folder / "card.img"
        self.folder.mkdir()
        self._image.write_bytes(bytes(8 << 20))
        self.works = run("mkfs.ext4", "-q", "-F", str(self._image)) and self.insert()
        self.works = self.works and self._switch().exists()

    def insert(self) -> bool:
        options = "loop,errors=remount-ro"
        return run("mount", "-o", options, str(self._image), str(self.folder))

    def _switch(self) -> Path:
        process = subprocess.run(
            ["losetup", "-j", str(self._image)], capture_output=True, text=True, check=False
        )
        device = Path(process.stdout.split(":")[0]).name
        return Path("/sys/fs/ext4", device or "none", "trigger_fs_error")

    def fail(self) -> None:
        """The kernel finds an error, and from now on every write is EROFS."""
        self._switch().write_text("as a dying card does")

    def repair(self) -> None:
        """Take it out, check it, and put it in again; what was not synced is gone."""
        assert run("umount", str(self.folder)), "a file on it is still open"
        run("e2fsck", "-p", "-f", str(self._image))
        assert self.insert()


@pytest.fixture
def card(tmp_path: Path) -> Iterator[Card]:
    if os.geteuid() != 0:
        pytest.skip("mounting a file system needs root")
    made = Card(tmp_path)
    if not made.works:
        run("umount", "-l", str(made.folder))
        pytest.skip("needs loop devices, ext4, and its switch in /sys to fail")
    yield made
    run("umount", "-l", str(made.folder))


class Session:
    def __init__(self, folder: Path, settings: RecorderSettings) -> None:
        self.recorder = Recorder(False, settings)
        self.recorder.open(RecordingPlan(folder / "a.mcap", METADATA, ()))
        self.k = 0

    def run(self, seconds: float) -> None:
        for _ in range(int(seconds * PER_SECOND)):
            at_ns = self.k * SECOND // PER_SECOND
            noise = (hash(str(self.k)) >> 33, hash(str(-self.k)) >> 33, self.k)
            self.recorder.put(TOPIC, ImuRaw(at_ns, self.k, self.k, 0, 0, noise), at_ns)
            self.k += 1
            if self.k % 20 == 0:
                self.recorder.tick(at_ns)

    def state(self) -> RecorderState:
        return self.recorder.state


def samples(folder: Path) -> list[int]:
    numbers: list[int] = []
    for path in sorted(folder.glob("*.mcap")):
        recording = read_recording(path)
        if TOPIC in recording.topics:
            numbers += recording.array(TOPIC)["sequence"].tolist()
    return numbers


def test_a_full_disk_without_a_reserve(small_disk: Path) -> None:
    session = Session(small_disk, RecorderSettings(survives_faults=True))
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(450_000))
    session.run(30)
    assert session.state() is RecorderState.DEGRADED
    assert "No space left" in session.recorder.degraded_reason
    ballast.unlink()
    session.run(10)
    assert session.state() is RecorderState.RECORDING
    session.recorder.close()
    assert session.recorder.counts.lost == 0
    assert {r.outcome for r in recover_folder(small_disk)} == {RecoveryOutcome.RECOVERED}
    assert samples(small_disk) == list(range(session.k))


def test_a_full_disk_with_a_reserve(small_disk: Path) -> None:
    session = Session(small_disk, RecorderSettings(survives_faults=True, reserve_bytes=60_000))
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(350_000))
    session.run(40)
    assert session.state() is RecorderState.DEGRADED
    assert session.recorder.counts.disk_faults == 0  # stopped before the system refused
    assert [path.name for path in small_disk.glob("a*")] == ["a.mcap"]
    ballast.unlink()
    session.run(10)
    assert session.state() is RecorderState.RECORDING
    session.recorder.close()
    assert session.recorder.counts.lost == 0
    assert samples(small_disk) == list(range(session.k))


def test_a_card_that_dies(card: Card) -> None:
    """What the system had not written yet is lost with the card, and kept in memory."""
    session = Session(card.folder, RecorderSettings(survives_faults=True))
    session.run(5.5)
    card.fail()
    session.run(20)
    assert session.state() is RecorderState.DEGRADED
    assert "Read-only" in session.recorder.degraded_reason
    card.repair()
    session.run(10)
    assert session.state() is RecorderState.RECORDING
    session.recorder.close()
    recover_folder(card.folder)
    numbers = samples(card.folder)
    assert sorted(set(numbers)) == list(range(session.k))
    # What had reached the card all the same is there twice: at most what one sync covers.
    assert len(numbers) - session.k <= 2 * PER_SECOND


RIG = "rig: card\nptu: {port: emulated}\nboards: [{id: B-1, port: emulated}]\n"
REST = b"name: rest\nsteps:\n  - rest: {seconds: 3600.0}\n"


def degraded(metrics: Path) -> str:
    """What the metrics say of the disk, "" where they say nothing yet."""
    metrics_file = metrics / "gyrorig.prom"
    lines = metrics_file.read_text().splitlines() if metrics_file.exists() else []
    return next((line for line in lines if line.startswith("gyrorig_recorder_degraded ")), "")


def test_a_service_reports_a_dead_card_in_its_metrics(tmp_path: Path, card: Card) -> None:
    (tmp_path / "rig.yaml").write_text(RIG + "service: {reserve_mb: 0}\n")
    state, runtime = card.folder / "state", tmp_path / "run"
    with subprocess.Popen(
        [*GYRORIGD, "run", "--config", "rig.yaml", "--state", state, "--socket", "sock"],
        env=os.environ | {"RUNTIME_DIRECTORY": str(runtime)},
        cwd=tmp_path,
    ) as daemon:
        try:
            wait_for((state / "queue" / "done").is_dir)
            enqueue_job(state / "queue", REST, "rest.yaml")
            wait_for(lambda: any((state / "recordings").glob("*.part")))
            wait_for(lambda: degraded(runtime / "metrics") == "gyrorig_recorder_degraded 0")
            card.fail()
            wait_for(lambda: degraded(runtime / "metrics") == "gyrorig_recorder_degraded 1")
        finally:
            daemon.terminate()
            daemon.wait(60)


def test_one_shot_fails_at_once_on_a_full_disk(small_disk: Path) -> None:
    session = Session(small_disk, RecorderSettings())
    (small_disk / "ballast").write_bytes(bytes(400_000))
    with pytest.raises(MachineError, match="No space left"):
        session.run(120)
    with pytest.raises(MachineError):
        session.recorder.close()
    (small_disk / "ballast").unlink()
    assert [r.outcome for r in recover_folder(small_disk)] == [RecoveryOutcome.RECOVERED]
    numbers = samples(small_disk)
    assert numbers == list(range(len(numbers)))
