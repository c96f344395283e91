"""Cables unplugged and processes stopped while the real daemon records from ptys.

A pty whose master is closed shows the daemon what a pulled USB adapter does: readable,
an empty read, EIO on writing, and no node (measured).
"""

import os
import select
import signal
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_protocol.recording.messages import PtuCommandRecord, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording

GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")
RIG = """
rig: system
ptu: {{port: {ptu}, baud: 115200}}
boards:
  - {{id: B-1, port: {first}, baud: 460800}}
  - {{id: B-2, port: {second}, baud: 460800}}
"""
# Long enough for all that happens meanwhile to be seen in the file also on a busy machine.
REST = "name: rest\nsteps:\n  - rest: {seconds: 15.0, phase: static}\n"
MOVE = "name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 4.0}\n"


class Cable:
    """A line between a device's pty and a link that the daemon opens; it can be pulled."""

    def __init__(self, device: str, link: Path) -> None:
        self.link = link
        self._device = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._device)
        self._master: int | None = None
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._carry)
        self.plug()
        self._thread.start()

    def plug(self) -> None:
        master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(master, False)
        self.link.symlink_to(os.ttyname(slave))
        with self._lock:
            self._master, self._slave = master, slave

    def pull(self) -> None:
        with self._lock:
            master, self._master = self._master, None
        self.link.unlink()
        if master is not None:
            os.close(master)
            os.close(self._slave)

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        if self._master is not None:
            self.pull()
        os.close(self._device)

    def _carry(self) -> None:
        while not self._ended.is_set():
            select.select([self._device], [], [], 0.005)
            with self._lock, suppress(BlockingIOError):
                data = os.read(self._device, 4096)
                if self._master is not None:
                    os.write(self._master, data)  # what does not fit is lost
            with self._lock, suppress(OSError):
                if self._master is not None:
                    os.write(self._device, os.read(self._master, 4096))


class Bench:
    """A served emulated rig whose unit and first board hang on cables."""

    def __init__(self, folder: Path) -> None:
        boards = (BoardSettings("B-1"), BoardSettings("B-2"))
        ptu = PtuSettings(baud=115200)
        self.emulated = EmulatedRig(RigSettings(seed=2, ptu=ptu, boards=boards), raw_now_ns())
        self._server = PtyServer(self.emulated)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._server.run, args=(self._ended.is_set,))
        self._thread.start()
        paths = self._server.paths
        self.unit = Cable(paths["ptu"], folder / "unit")
        self.board = Cable(paths["board:B-1"], folder / "board")
        self.folder = folder
        text = RIG.format(ptu=self.unit.link, first=self.board.link, second=paths["board:B-2"])
        (folder / "rig.yaml").write_text(text)

    def record(self, program: str) -> subprocess.Popen[str]:
        (self.folder / "program.yaml").write_text(program)
        files = [str(self.folder / name) for name in ("rig.yaml", "program.yaml", "out")]
        command = [*GYRORIGD, "record", "--config", files[0], "--program", files[1]]
        return subprocess.Popen([*command, "--out", files[2]], stderr=subprocess.PIPE, text=True)

    def turns(self) -> bool:
        now_s = (raw_now_ns() - self.emulated.origin_ns) * 1e-9
        return self.emulated.stage.pan.is_moving(now_s)

    def close(self) -> None:
        for cable in (self.unit, self.board):
            cable.close()
        self._ended.set()
        self._thread.join()
        self._server.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    made.close()


def wait_for(is_finished: Callable[[], bool], seconds: float = 60.0) -> None:
    end_s = time.monotonic() + seconds
    while not is_finished():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def growing(bench: Bench, topic: str = "/board/B-1/imu_raw") -> int:
    """Return how many messages the growing file holds."""
    for path in (bench.folder / "out").glob("*.mcap.part"):
        with suppress(Exception):
            return len(read_recording(path).array(topic))
    return 0


def recorded(bench: Bench) -> Recording:
    (path,) = (bench.folder / "out").glob("*.mcap")
    return read_recording(path)


def event_texts(recording: Recording) -> list[str]:
    return [m.text for m in recording.messages("/session/event") if isinstance(m, SessionEvent)]


@contextmanager
def stopped(pid: int, seconds: float) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
        time.sleep(seconds)  # what is tested is that nothing happens for so long
    finally:
        os.kill(pid, signal.SIGCONT)


def test_a_board_is_replugged_while_the_other_continues(bench: Bench) -> None:
    daemon = bench.record(REST)
    wait_for(lambda: growing(bench) > 50)
    bench.board.pull()
    wait_for(lambda: growing(bench, "/board/B-2/imu_raw") > growing(bench) + 40)
    bench.board.plug()
    _, errors = daemon.communicate(timeout=60)
    assert (daemon.returncode, errors) == (0, "")
    recording = recorded(bench)
    assert recording.is_complete
    faults = event_texts(recording)
    assert any("board B-1" in text and "is gone: it was unplugged" in text for text in faults)
    assert any("board B-1" in text and "sends samples again, after" in text for text in faults)
    other = recording.array("/board/B-2/imu_raw")["sequence"].astype(np.int64)
    assert np.all(np.diff(other) == 1)
    rows = recording.array("/board/B-1/imu_raw")
    steps = np.diff(rows["sequence"].astype(np.int64))
    assert np.sum(steps != 1) == 1
    assert len(rows) > np.argmax(steps) + 50  # it came back before the end
    assert np.all(np.diff(recording.array("/ptu/position")["sequence"].astype(np.int64)) == 1)


def test_a_unit_unplugged_in_motion_ends_the_program(bench: Bench) -> None:
    daemon = bench.record(MOVE)
    wait_for(lambda: bench.turns() and growing(bench) > 50)
    bench.unit.pull()
    _, errors = daemon.communicate(timeout=60)
    assert daemon.returncode == 1
    assert "unplugged" in errors
    assert "was not confirmed" in errors
    recording = recorded(bench)
    assert recording.is_complete
    assert "aborted" in event_texts(recording)
    for board in ("B-1", "B-2"):
        sequence = recording.array(f"/board/{board}/imu_raw")["sequence"].astype(np.int64)
        assert np.all(np.diff(sequence) == 1)


def child_of(pid: int) -> int:
    """Return the acquisition process of a daemon."""
    words = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=True
    )
    (child,) = words.stdout.split()
    return int(child)


def test_a_stopped_process_does_not_catch_up(bench: Bench) -> None:
    daemon = bench.record(REST)
    wait_for(lambda: growing(bench) > 50)
    # A poll waits for a second, of which a busy computer needs a part.
    with stopped(child_of(daemon.pid), 0.4):
        pass
    wait_for(lambda: growing(bench) > 200)
    with stopped(daemon.pid, 1.2):
        pass
    _, errors = daemon.communicate(timeout=60)
    assert (daemon.returncode, errors) == (0, "")
    recording = recorded(bench)
    stalls = [text for text in event_texts(recording) if "did not run" in text]
    assert any(text.startswith("the acquisition process") for text in stalls)
    assert any(text.startswith("the daemon") for text in stalls)
    for board in ("B-1", "B-2"):
        sequence = recording.array(f"/board/{board}/imu_raw")["sequence"].astype(np.int64)
        assert np.all(np.diff(sequence) == 1)  # the kernel kept 0.4 s of it
    positions = recording.array("/ptu/position")
    asked = positions["request_time"]
    asked_ns = asked["sec"].astype(np.int64) * 1_000_000_000 + asked["nanosec"]
    assert np.min(np.diff(asked_ns)) >= 9_000_000  # 100 a second, and never a burst
    # a poll that is stopped for its patience is a silence; nothing else is sent meanwhile
    sent = [m for m in recording.messages("/ptu/command") if isinstance(m, PtuCommandRecord)]
    late = [m.command for m in sent if m.request_time_ns > asked_ns[0]]
    assert late[-1] == "H"
    assert set(late) <= {"BT", "H"}
    assert len(late) < 6
