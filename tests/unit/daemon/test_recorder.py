"""The queue in front of the writer: order, early messages, and a disk that fails."""

import errno
import itertools
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from gyrorig_daemon.recorder import Recorder, RecordingPlan
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.mcap.disk_file import DiskFile
from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.writer import RecordingWriter

TOPIC = "/session/event"
METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}


def event(at: int) -> SessionEvent:
    return SessionEvent(at, EventKind.NOTE, "", f"note {at}")


@pytest.mark.parametrize("threaded", [False, True])
def test_held_messages_are_written_first_and_early_ones_discarded(
    tmp_path: Path, threaded: bool
) -> None:
    recorder = Recorder(threaded)
    recorder.put(TOPIC, event(1), 1)
    recorder.put_or_hold(TOPIC, event(2), 2)
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    for at in range(3, 500):
        recorder.put(TOPIC, event(at), at)
    path = recorder.close()
    texts = [m.text for m in read_recording(path).messages(TOPIC) if isinstance(m, SessionEvent)]
    assert texts == [f"note {at}" for at in range(2, 500)]
    assert recorder.counts.lost == 0


def test_a_full_queue_leaves_a_gap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gyrorig_daemon.recorder.recorder.MAX_QUEUED_MESSAGES", 3)
    stuck, write = threading.Event(), RecordingWriter.write_encoded

    def slow(*arguments: Any, **named: Any) -> None:
        taken.release()
        stuck.wait()
        write(*arguments, **named)

    taken = threading.Semaphore(0)
    monkeypatch.setattr(RecordingWriter, "write_encoded", slow)
    recorder = Recorder(threaded=True)
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    recorder.put(TOPIC, event(0), 0)
    taken.acquire()  # the writer has it, and is stuck: three more fit
    for at in range(1, 9):
        recorder.put(TOPIC, event(at), at)
    assert recorder.counts.lost == 5
    stuck.set()
    for _ in range(3):
        taken.acquire()  # the queue is empty again
    for at in range(9, 11):
        recorder.put(TOPIC, event(at), at)
    recording = read_recording(recorder.close())
    texts = [m.text for m in recording.messages(TOPIC) if isinstance(m, SessionEvent)]
    assert texts == [f"note {at}" for at in (0, 1, 2, 3, 9, 10)]
    assert message_sequences(tmp_path / "a.mcap") == [0, 1, 2, 3, 9, 10]


def message_sequences(path: Path) -> list[int]:
    with path.open("rb") as file:
        return [message.sequence for _, _, message in make_reader(file).iter_messages([TOPIC])]


def failing_after(count: int, code: int) -> Callable[[DiskFile, bytes], int]:
    write = DiskFile.write
    left = [count]

    def limited(self: DiskFile, data: bytes) -> int:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(code, "no more")
        return write(self, data)

    return limited


@pytest.mark.parametrize("threaded", [False, True])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_disk_error_reaches_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, threaded: bool
) -> None:
    recorder = Recorder(threaded)
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    monkeypatch.setattr(DiskFile, "write", failing_after(0, code))

    def put_many() -> None:
        for at in itertools.count():  # a thread that writes may have its turn late
            recorder.put(TOPIC, event(at), at)

    with pytest.raises(MachineError, match="cannot be written"):
        put_many()
    with pytest.raises(MachineError):
        recorder.close()
    recorder.mute()
    recorder.put(TOPIC, event(1), 1)
    assert read_recording(tmp_path / "a.mcap.part").metadata["gyrorig"]["session"] == "s"
