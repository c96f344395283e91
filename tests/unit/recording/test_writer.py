"""The writer refuses what is wrong, and loses at most what it promises."""

import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.clock_messages import HOST_CLOCK_TOPIC, HostClock
from gyrorig_protocol.recording.mcap.losses import LossCause
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    ImuRaw,
    SessionEvent,
    imu_raw_topic,
)
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.writer import RecordingWriter

T = 1_790_000_000_000_000_000
B1 = BoardId("B-1")
TOPIC = imu_raw_topic(B1)


def imu(time_ns: int, k: int = 0) -> ImuRaw:
    return ImuRaw(time_ns, k, k, 0, 0, (k, k, k))


@pytest.fixture
def out(tmp_path: Path, contract_metadata: Any) -> RecordingWriter:
    return RecordingWriter(tmp_path / "a.mcap", contract_metadata)


def test_the_file_has_its_final_name_after_close(out: RecordingWriter, tmp_path: Path) -> None:
    part = tmp_path / "a.mcap.part"
    assert out.path == part
    out.write(TOPIC, imu(T))
    assert [p.name for p in tmp_path.iterdir()] == [part.name]
    assert out.close() == tmp_path / "a.mcap"
    assert out.close() == out.path == tmp_path / "a.mcap"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]
    with pytest.raises(MachineError, match="closed"):
        out.write(TOPIC, imu(T))


@pytest.mark.parametrize("name", ["a.mcap", "a.mcap.part"])
def test_nothing_is_overwritten(tmp_path: Path, contract_metadata: Any, name: str) -> None:
    (tmp_path / name).write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        RecordingWriter(tmp_path / "a.mcap", contract_metadata)
    assert (tmp_path / name).read_bytes() == b"precious"


def test_a_file_created_by_another_program_is_kept(out: RecordingWriter, tmp_path: Path) -> None:
    out.write(TOPIC, imu(T))
    (tmp_path / "a.mcap").write_bytes(b"precious")
    with pytest.raises(MachineError):
        out.close()
    assert (tmp_path / "a.mcap").read_bytes() == b"precious"
    assert len(read_recording(out.path).imu(B1)) == 1


def test_a_missing_folder_is_a_machine_error(tmp_path: Path, contract_metadata: Any) -> None:
    with pytest.raises(MachineError, match="No such file"):
        RecordingWriter(tmp_path / "none" / "a.mcap", contract_metadata)


def test_skipped_messages_leave_a_gap(out: RecordingWriter) -> None:
    out.skip_sequence(TOPIC, 5)  # nothing before it that a gap could follow
    out.write(TOPIC, imu(T))
    out.skip_sequence(TOPIC, 2)
    out.write(TOPIC, imu(T + 1))
    out.write(TOPIC, imu(T + 2))
    assert read_recording(out.close()).imu(B1)["message_sequence"].tolist() == [0, 3, 4]


def test_invalid_calls_raise(out: RecordingWriter) -> None:
    out.write(TOPIC, imu(T))
    mistakes: list[Callable[[], None]] = [
        lambda: out.write(TOPIC, imu(T - 1)),
        lambda: out.write(TOPIC, imu(T + 1), T + 2),
        lambda: out.write(HOST_CLOCK_TOPIC, HostClock(0, 0, 0, 0.0, 0.0, 0)),
        lambda: out.write(TOPIC, SessionEvent(T, 0, "static", "")),
        lambda: out.write("no/slash", imu(T)),
    ]
    for wrong in mistakes:
        with pytest.raises(ValueError, match=r".+"):
            wrong()
    out.close()
    assert read_recording(out.path).messages(TOPIC) == [imu(T)]


@pytest.mark.parametrize(
    "wrong",
    [
        {"host_time_ns": np.array([T + 1, T])},
        {"device_time": np.array([-1, 0])},
        {"status": np.array([0, 1 << 16])},
        {"gyro": np.zeros((2, 2), int)},
        {"gyro": np.zeros((2, 3))},
        {"publish_time_ns": np.array([T])},
        {"sequence": np.array([1])},
    ],
)
def test_invalid_arrays_raise(out: RecordingWriter, wrong: dict[str, Any]) -> None:
    zeros = np.zeros(2, int)
    right: dict[str, Any] = {
        "host_time_ns": np.array([T, T]),
        "publish_time_ns": None,
        "device_time": zeros,
        "sequence": zeros,
        "status": zeros,
        "temperature": zeros,
        "gyro": np.zeros((2, 3), int),
    }
    with pytest.raises(ValueError, match=r".+"):
        out.write_imu_array(B1, **(right | wrong))
    out.write_imu_array(B1, **right)
    out.close()
    assert len(read_recording(out.path).imu(B1)) == 2


@pytest.mark.parametrize(
    "metadata",
    [
        {},
        {"gyrorig": {"session": "s"}},
        {"gyrorig": {"session": "s", "anchor_utc_ns": 1, "anchor_monotonic_raw_ns": "0"}},
        {
            "gyrorig": {
                "format": "2",
                "session": "s",
                "anchor_utc_ns": "0",
                "anchor_monotonic_raw_ns": "0",
            }
        },
    ],
)
def test_invalid_metadata_raise(tmp_path: Path, metadata: Any) -> None:
    with pytest.raises(ValueError, match=r"metadata|format"):
        RecordingWriter(tmp_path / "a.mcap", metadata)
    assert not list(tmp_path.iterdir())


def test_tick_flushes_within_a_second_and_syncs_within_ten(
    out: RecordingWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    now_ns = 0
    monkeypatch.setattr(os, "fdatasync", lambda _: synced.append(now_ns))
    longest_ns = flushed_ns = 0
    for k in range(2500):  # 25 s of ticks every 10 ms
        now_ns = k * 10_000_000
        out.write(TOPIC, imu(T + now_ns, k))
        size = out.bytes_written
        out.tick(now_ns)
        if out.bytes_written > size:
            flushed_ns = now_ns
        longest_ns = max(longest_ns, now_ns - flushed_ns)
    assert longest_ns < 1_000_000_000
    spacing = np.diff([0, *synced, now_ns])
    assert spacing.max() < 10_000_000_000
    assert len(read_recording(out.path).imu(B1)) >= 2400


class FullDisk:
    """Refuses every byte behind the first `limit`, as a full disk does: first short, then not."""

    def __init__(self, limit: int) -> None:
        self.room = limit
        self.write = os.write

    def __call__(self, handle: int, data: memoryview) -> int:
        if not self.room:
            raise OSError(28, "No space left on device")
        written = self.write(handle, data[: self.room])
        self.room -= written
        return written


def fill_until_refused(path: Path, metadata: Any) -> tuple[RecordingWriter | None, int]:
    """Write and flush until the disk refuses; returns how many messages were taken."""
    out, taken = None, 0
    try:
        out = RecordingWriter(path, metadata)
        for k in range(400):
            out.write(TOPIC, imu(T + k, k))
            taken += 1
            if k % 20 == 19:
                out.flush()
        out.close()
    except MachineError:
        return out, taken
    raise AssertionError("nothing was refused")


@pytest.mark.parametrize("block", range(4))
def test_a_full_disk_at_any_byte(
    tmp_path: Path, contract_metadata: Any, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    with RecordingWriter(tmp_path / "whole.mcap", contract_metadata) as complete:
        for k in range(400):
            complete.write(TOPIC, imu(T + k, k))
            if k % 20 == 19:
                complete.flush()
    length = complete.path.stat().st_size
    steps = random.Random(block)
    for number, limit in enumerate(steps.sample(range(length), 60)):
        path = tmp_path / f"{block}-{number}.mcap"
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", FullDisk(limit))
            out, taken = fill_until_refused(path, contract_metadata)
        if out is None:  # refused within the metadata: nothing to keep
            assert not path.with_name(path.name + ".part").exists()
            continue
        assert out.closed
        assert out.path.name.endswith(".part")
        assert out.path.stat().st_size <= limit
        remaining = read_recording(out.path)
        actual = remaining.messages(TOPIC) if TOPIC in remaining.topics else []
        assert actual == [imu(T + k, k) for k in range(len(actual))]
        assert len(actual) + out.lost_messages == taken
        assert [loss.cause for loss in remaining.losses] == [LossCause.UNFINISHED]
        with pytest.raises(MachineError):
            out.write(TOPIC, imu(T + 500))


LIMITED = """
import resource, signal, sys
from pathlib import Path
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.messages import SessionEvent
from gyrorig_protocol.recording.writer import RecordingWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
own = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
out = RecordingWriter(Path(sys.argv[1]), {"gyrorig": own})
try:
    for k in range(100_000):
        out.write("/session/event", SessionEvent(k, 2, "", str(hash(str(k)))))
        if k % 100 == 99:
            out.flush()
except MachineError as error:
    print(error)
    sys.exit(error.exit_code)
"""


def test_a_file_size_limit_of_the_system(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    ended = subprocess.run(
        [sys.executable, "-c", LIMITED, str(path)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 1, ended.stderr
    assert "are complete and kept" in ended.stdout
    part = path.with_name("a.mcap.part")
    remaining = read_recording(part)
    times = [event.host_time_ns for event in remaining.events()]
    assert len(times) >= 100
    assert times == list(range(len(times)))
    assert remaining.losses[0].cause is LossCause.UNFINISHED
    assert part.stat().st_size <= 100_000


KILLED = """
import sys
from pathlib import Path
from gyrorig_protocol.recording.messages import SessionEvent
from gyrorig_protocol.recording.writer import RecordingWriter
own = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
out = RecordingWriter(Path(sys.argv[1]), {"gyrorig": own})
for k in range(10_000_000):
    out.write("/session/event", SessionEvent(k, 2, "sweep", "x" * (k % 50)))
    out.tick(k * 10_000_000)
    if k % 100 == 99:
        print(k, flush=True)
"""


@pytest.mark.parametrize("lines", [1, 7, 30, 61])
def test_kill_at_any_time_leaves_the_prefix(tmp_path: Path, lines: int) -> None:
    path = tmp_path / "a.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        last = [writer.stdout.readline() for _ in range(lines)][-1]
        os.kill(writer.pid, signal.SIGKILL)
    remaining = read_recording(path.with_name("a.mcap.part"))
    events = remaining.events()
    # Simulated 10 ms a message: at most 100, one second, can be missing.
    assert len(events) >= int(last) + 1 - 100
    assert events == [SessionEvent(k, 2, "sweep", "x" * (k % 50)) for k in range(len(events))]
    assert not remaining.is_complete


def test_the_file_has_its_indexes(out: RecordingWriter) -> None:
    for k in range(50):
        out.write(TOPIC, imu(T + k, k), publish_time_ns=T + k - 3)
        out.write(SESSION_EVENT_TOPIC, SessionEvent(T + k, 2, "", ""))
    with out.close().open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        assert reader.get_header().library.startswith("gyrorig ")
        sequences = [m.sequence for _, c, m in reader.iter_messages() if c.topic == TOPIC]
    assert sequences == list(range(50))
    assert summary is not None
    assert all(c.metadata == {"offered_qos_profiles": ""} for c in summary.channels.values())
    assert summary.chunk_indexes[0].compression == "zstd"
    assert len(summary.chunk_indexes[0].message_index_offsets) == 2
