"""Samples as columns hold what the records hold, whichever way a file is read."""

import mmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording import topic_collector
from gyrorig_protocol.recording.encoding.message_schemas import IMU_RAW
from gyrorig_protocol.recording.imu_columns import SOLVER_FIELDS, GrowingColumns
from gyrorig_protocol.recording.mcap.mapped_file import PageReleaser, map_file
from gyrorig_protocol.recording.messages import ImuRaw, imu_raw_topic
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_protocol.recording.writer import RecordingWriter

T = 1_790_000_000_000_000_000
B1 = BoardId("B-1")


@pytest.fixture
def long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every recording counts as a long one."""
    monkeypatch.setattr(topic_collector, "MAX_RECORD_BYTES", 0)


def write(path: Path, metadata: Any, gyro: np.ndarray, chunks: int = 4) -> Path:
    random = np.random.default_rng(5)
    n = len(gyro)
    columns: dict[str, Any] = {
        "host_time_ns": T + np.cumsum(random.integers(0, 10**7, n)),
        "device_time": random.integers(0, 2**64, n, dtype=np.uint64),
        "sequence": random.integers(0, 2**32, n, dtype=np.uint32),
        "status": random.integers(0, 2**16, n),
        "temperature": random.integers(-(2**15), 2**15, n),
        "gyro": gyro,
        "accel": random.integers(-(2**15), 2**15, (n, 3)),
    }
    with RecordingWriter(path, metadata) as out:
        for k, rows in enumerate(np.array_split(np.arange(n), chunks)):
            part = {name: values[rows] for name, values in columns.items()}
            out.write_imu_array(B1, publish_time_ns=None, **part)
            out.flush()
            if k == 1:
                out.skip_sequence(imu_raw_topic(B1), 3)
    return path


def small(n: int) -> np.ndarray:
    counts: np.ndarray = np.random.default_rng(6).integers(-(2**15), 2**15, (n, 3))
    return counts


def check_columns(recording: Recording, records: Any) -> None:
    columns = recording.imu_columns(B1)
    assert np.array_equal(columns.host_time_ns, times_ns(records["host_time"]))
    assert np.array_equal(columns.device_time, records["device_time"].astype(np.int64))
    for name in ("sequence", "status", "temperature", "gyro"):
        actual = getattr(columns, name)
        assert actual.dtype.itemsize <= records[name].dtype.itemsize
        assert np.array_equal(actual, records[name]), name
    assert np.array_equal(recording.imu_field(B1, "accel"), records["accel"])
    assert np.array_equal(recording.imu_field(B1, "mag"), records["mag"])
    assert np.array_equal(recording.imu_field(B1, "host_time"), times_ns(records["host_time"]))


def test_columns_of_kept_records(tmp_path: Path, contract_metadata: Any) -> None:
    recording = read_recording(write(tmp_path / "r.mcap", contract_metadata, small(5000)))
    check_columns(recording, recording.imu(B1))
    assert recording.imu_columns(B1).gyro.dtype == np.int16


@pytest.mark.parametrize("wide", [None, 0, 2600, 4999])
def test_a_long_recording_gives_the_same_data(
    tmp_path: Path, contract_metadata: Any, monkeypatch: pytest.MonkeyPatch, wide: int | None
) -> None:
    gyro = small(5000)
    if wide is not None:
        gyro[wide, 1] = 2**15  # one count that 16 bits do not hold
    path = write(tmp_path / "r.mcap", contract_metadata, gyro)
    remaining = read_recording(path)
    monkeypatch.setattr(topic_collector, "MAX_RECORD_BYTES", 0)
    actual = read_recording(path)
    assert actual.topics[imu_raw_topic(B1)].array is None
    # Once from what the first reading kept, and once more from the file.
    for _ in range(2):
        check_columns(actual, remaining.imu(B1))
    assert actual.imu_columns(B1).gyro.dtype == (np.int16 if wide is None else np.int32)
    assert np.array_equal(actual.imu(B1), remaining.imu(B1))
    assert actual.span_ns == remaining.span_ns
    assert actual.sha256 == remaining.sha256
    for topic, expected in remaining.topics.items():
        assert len(actual.topics[topic]) == len(expected)
        assert actual.topics[topic].missing_count == expected.missing_count == 3
        assert actual.topics[topic].span_ns == expected.span_ns


@pytest.mark.usefixtures("long")
def test_a_long_recording_has_all_other_data(tmp_path: Path, script: Any) -> None:
    recording = read_recording(script.write(tmp_path / "r.mcap"))
    expected = script.by_topic()
    assert {topic: recording.messages(topic) for topic in recording.topics} == expected
    with pytest.raises(InputError, match="has no samples of board B-3"):
        recording.imu_columns(BoardId("B-3"))


@pytest.mark.usefixtures("long")
def test_damage_of_a_long_recording_is_reported_equally(
    tmp_path: Path, contract_metadata: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "r.mcap", contract_metadata, small(4000), chunks=8)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    actual = read_recording(path)
    assert len(actual.topics[imu_raw_topic(B1)]) == len(actual.imu_columns(B1).sequence) == 3500
    monkeypatch.setattr(topic_collector, "MAX_RECORD_BYTES", 1 << 30)
    remaining = read_recording(path)
    assert actual.losses == remaining.losses
    assert actual.losses
    check_columns(actual, remaining.imu(B1))


@pytest.mark.usefixtures("long")
def test_two_channels_of_one_topic_are_merged(tmp_path: Path, contract_metadata: Any) -> None:
    path = tmp_path / "r.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other 1")
        for name, record in contract_metadata.items():
            writer.add_metadata(name, {**record, **({"format": "1"} if name == "gyrorig" else {})})
        schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", IMU_RAW.encode())
        numbers = [writer.register_channel(imu_raw_topic(B1), "cdr", schema, {}) for _ in range(2)]
        for i in range(100):
            payload = ImuRaw(T + i, i, i, 0, 0, (i, -i, i)).encode()
            writer.add_message(numbers[i // 10 % 2], T + i, payload, T + i, i)
        writer.finish()  # type: ignore[no-untyped-call]
    recording = read_recording(path)
    assert recording.imu_columns(B1).sequence.tolist() == list(range(100))


@pytest.mark.usefixtures("long")
def test_messages_of_wrong_size_are_reported_as_lost(
    tmp_path: Path, contract_metadata: Any
) -> None:
    path = tmp_path / "r.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other 1")
        for name, record in contract_metadata.items():
            writer.add_metadata(name, {**record, **({"format": "1"} if name == "gyrorig" else {})})
        schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", IMU_RAW.encode())
        number = writer.register_channel(imu_raw_topic(B1), "cdr", schema, {})
        for i in range(50):
            payload = ImuRaw(T + i, i, i, 0, 0, (i, -i, i)).encode()
            writer.add_message(number, T + i, payload[: 64 - 20 * (i % 10 == 9)], T + i, i)
        writer.finish()  # type: ignore[no-untyped-call]
    recording = read_recording(path)
    assert [loss.messages for loss in recording.losses] == [5]
    expected = [i for i in range(50) if i % 10 != 9]
    assert recording.imu_columns(B1).sequence.tolist() == expected


def test_columns_grow(tmp_path: Path, contract_metadata: Any) -> None:
    records = read_recording(write(tmp_path / "r.mcap", contract_metadata, small(700))).imu(B1)
    columns = GrowingColumns((*SOLVER_FIELDS, "mag"), 3)
    for begin in range(0, 700, 70):
        columns.append(records[begin : begin + 70])
    assert columns.count == 700
    assert np.array_equal(columns.to_imu_columns().gyro, records["gyro"])
    assert np.array_equal(columns.column("mag"), records["mag"])


def resident_bytes(address_of: memoryview) -> int:
    """How much of a mapped file counts as this process's memory, by the kernel's own list."""
    start = np.frombuffer(address_of, np.uint8).ctypes.data
    inside = False
    for line in Path("/proc/self/smaps").read_text().splitlines():
        head = line.split()[0]
        if "-" in head and not head.endswith(":"):
            low, high = (int(part, 16) for part in head.split("-"))
            inside = low <= start < high
        elif inside and head == "Rss:":
            return int(line.split()[1]) * 1024
    raise AssertionError("the file is not mapped")


@pytest.mark.skipif(
    not (Path("/proc/self/smaps").exists() and hasattr(mmap, "MADV_DONTNEED")),
    reason="this system does not say what is resident",
)
def test_pages_are_released_behind_the_reader(tmp_path: Path) -> None:
    path = tmp_path / "large"
    content = np.random.default_rng(1).bytes(48 << 20)
    path.write_bytes(content)
    data = map_file(path)
    passage, most = PageReleaser(data), 0
    for index in range(0, len(data), 1 << 20):
        assert data[index : index + (1 << 20)] == content[index : index + (1 << 20)]
        passage.release_before(index)
        most = max(most, resident_bytes(data))
    assert most < 20 << 20
    assert data[:100] == content[:100]


def test_plain_bytes_have_no_pages_to_release() -> None:
    PageReleaser(memoryview(b"x")).release_before(1 << 40)
