"""What is written is read back, by our reader and by independent ones."""

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.message_schemas import IMU_RAW, SCHEMAS
from gyrorig_protocol.recording.messages import (
    PTU_POSITION_TOPIC,
    SESSION_EVENT_TOPIC,
    ImuRaw,
    SessionEvent,
    imu_raw_topic,
)
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording, times_ns
from gyrorig_protocol.recording.salvage import read_strictly
from gyrorig_protocol.recording.writer import RecordingWriter

Plain = Callable[[Any], Any]

B1 = BoardId("B-1")
T = 1_790_000_000_000_000_000
OWN = {"gyrorig": {"format": "1", "session": "s"}}


def same(recording: Recording, entries: Mapping[str, list[Any]]) -> bool:
    return {topic: recording.messages(topic) for topic in recording.topics} == entries


def test_a_recording_round_trips(tmp_path: Path, script: Any, contract_metadata: Any) -> None:
    recording = read_recording(script.write(tmp_path / "a.mcap"))
    assert recording.is_complete
    assert recording.notes == ()
    assert same(recording, script.by_topic())
    assert recording.metadata["gyrorig.board.B-2"] == contract_metadata["gyrorig.board.B-2"]
    assert recording.metadata["gyrorig"]["format"] == "1"
    assert recording.metadata["foxglove"] == {"deviceName": "rig-1"}
    assert [a.name for a in recording.attachments] == ["rig.yaml"]
    assert recording.board_ids == ("B-1", "B-2")
    assert recording.start_ns == T
    assert recording.end_ns == max(time_ns for _, _, time_ns in script.entries)
    numbers = recording.imu(B1)["message_sequence"].tolist()
    assert numbers == list(range(len(numbers)))


def test_the_shortcuts_return_the_written_messages(tmp_path: Path, script: Any) -> None:
    recording = read_recording(script.write(tmp_path / "a.mcap"))
    by_topic = script.by_topic()
    positions = recording.ptu_positions()
    assert times_ns(positions["reply_time"]).tolist() == positions["log_time"].tolist()
    assert positions["pan"].tolist() == [m.pan_rad for m in by_topic[PTU_POSITION_TOPIC]]
    assert recording.ptu_commands() == by_topic["/ptu/command"]
    assert recording.events() == by_topic[SESSION_EVENT_TOPIC]
    assert len(recording.clock_pings(B1)) == len(by_topic["/board/B-1/clock"])
    assert len(recording.clock_pings(BoardId("B-2"))) == 0
    assert recording.host_clock()["ntp_status"].tolist() == [64] * 4
    assert recording.reference_attitude()["orientation"].shape == (4, 4)
    with pytest.raises(InputError, match="Choose one of its boards: B-1, B-2"):
        recording.imu(BoardId("B-3"))


triples = st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3)
steps = st.lists(
    st.tuples(
        st.integers(0, 10**9),
        st.integers(0, 2**64 - 1),
        triples,
        st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=5),
        st.sampled_from(["imu", "event", "flush"]),
    ),
    max_size=30,
)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    deadline=None,
)
@given(steps=steps)
def test_any_order_of_messages_and_flushes(
    tmp_path_factory: pytest.TempPathFactory, contract_metadata: Any, steps: Any
) -> None:
    path = tmp_path_factory.mktemp("any") / "a.mcap"
    expected: dict[str, list[Any]] = {}
    with RecordingWriter(path, contract_metadata) as out:
        t = T
        for later_ns, device, counts, text, problem in steps:
            t += later_ns
            if problem == "flush":
                out.flush()
                continue
            imu = problem == "imu"
            topic = imu_raw_topic(B1) if imu else SESSION_EVENT_TOPIC
            message: Any = (
                ImuRaw(t, device, 1, 2, 3, counts) if imu else SessionEvent(t, 2, "dwell", text)
            )
            out.write(topic, message, publish_time_ns=t - 5)
            expected.setdefault(topic, []).append(message)
    recording = read_recording(path)
    assert recording.is_complete
    assert same(recording, expected)
    for topic in expected:
        stamped = recording.timed_messages(topic)
        assert [s.publish_time_ns for s in stamped] == [s.log_time_ns - 5 for s in stamped]
    if expected:  # and so does mcap's own reader, by the chunks and by the message indexes
        assert read_strictly(path) == {topic: len(them) for topic, them in expected.items()}
        with path.open("rb") as file:
            indexed = list(make_reader(file, validate_crcs=True).iter_messages())
        times = [message.log_time for _, _, message in indexed]
        assert times == sorted(times)
        for topic, them in expected.items():
            actual = [message.data for _, channel, message in indexed if channel.topic == topic]
            assert actual == [item.encode() for item in them]


def test_arrays_write_what_messages_write(tmp_path: Path, contract_metadata: Any) -> None:
    random = np.random.default_rng(3)
    n = 500
    host = T + np.cumsum(random.integers(0, 10**7, n))
    gyro, accel, mag = (random.integers(-(2**31), 2**31, (n, 3)) for _ in range(3))
    device = random.integers(0, 2**64, n, dtype=np.uint64)
    other = random.integers(0, 2**15, (3, n))
    with RecordingWriter(tmp_path / "a.mcap", contract_metadata) as out:
        out.write_imu_array(
            B1,
            host_time_ns=host,
            publish_time_ns=host - 9,
            device_time=device,
            sequence=other[0],
            status=other[1],
            temperature=-other[2],
            gyro=gyro,
            accel=accel,
            mag=mag,
        )
    with RecordingWriter(tmp_path / "b.mcap", contract_metadata) as out:
        for i in range(n):
            vectors = [(int(v[i, 0]), int(v[i, 1]), int(v[i, 2])) for v in (gyro, accel, mag)]
            sequence, status, temperature = (int(v) for v in other[:, i] * (1, 1, -1))
            imu = ImuRaw(int(host[i]), int(device[i]), sequence, status, temperature, *vectors)
            out.write(imu_raw_topic(B1), imu, publish_time_ns=int(host[i]) - 9)
    a, b = (read_recording(tmp_path / name) for name in ("a.mcap", "b.mcap"))
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert (a.imu(B1) == b.imu(B1)).all()
    assert (a.imu(B1)["gyro"] == gyro).all()


def ours(recording: Recording, topic: str) -> list[tuple[int, Any]]:
    """Log time and fields, named as in the schema."""
    actual = recording.topics[topic]
    if actual.array is None:
        names = ("request_time", "first_byte_time", "reply_time", "host_time")
        rows = []
        for item in actual.timed_messages:
            slots = vars(type(item.message))["__slots__"]
            fields = {name.removesuffix("_ns"): getattr(item.message, name) for name in slots}
            assert any(name in fields for name in names)
            rows.append((item.log_time_ns, fields))
        return rows
    columns: dict[str, list[Any]] = {}
    for name in (actual.array.dtype.names or ())[3:]:
        column = actual.array[name]
        columns[name] = (times_ns(column) if column.dtype.names else column).tolist()
    values = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return list(zip(actual.array["log_time"].tolist(), values, strict=True))


def by_stock(path: Path, plain: Plain) -> dict[str, list[tuple[int, Any]]]:
    actual: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
            actual.setdefault(channel.topic, []).append((message.log_time, plain(decoded)))
    return actual


def test_the_sample_gives_the_same_as_the_mcap_reader(contracts: Path, plain: Plain) -> None:
    path = contracts / "sample.mcap"
    recording = read_recording(path)
    assert recording.is_complete
    stock = by_stock(path, plain)
    assert set(stock) == set(recording.topics)
    for topic, messages in stock.items():
        assert ours(recording, topic) == messages


def test_independent_readers_read_our_files(tmp_path: Path, script: Any, plain: Plain) -> None:
    path = script.write(tmp_path / "a.mcap")
    recording = read_recording(path)
    stock = by_stock(path, plain)
    for topic, messages in stock.items():
        assert ours(recording, topic) == messages
    actual: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path]) as reader:
        for connection, time_ns, raw in reader.messages():
            decoded = plain(reader.deserialize(raw, connection.msgtype))
            actual.setdefault(connection.topic, []).append((time_ns, decoded))
    assert actual == stock


def test_the_contract_checker_accepts_our_files(
    tmp_path: Path, script: Any, contract_judge: Path
) -> None:
    path = script.write(tmp_path / "a.mcap")
    judged = subprocess.run(
        [sys.executable, str(contract_judge), str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout + judged.stderr


def foreign(
    path: Path,
    fill: Callable[[Writer], None],
    metadata: Mapping[str, dict[str, str]] = OWN,
    **options: Any,
) -> Path:
    """A file made with the plain `mcap` writer."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2", library="other 1")
        for name, record in metadata.items():
            writer.add_metadata(name, record)
        fill(writer)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def fill_imu(writer: Writer, channels: int = 1, count: int = 100) -> None:
    schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", IMU_RAW.encode())
    numbers = [
        writer.register_channel(imu_raw_topic(B1), "cdr", schema, {}) for _ in range(channels)
    ]
    for i in range(count):
        payload = ImuRaw(T + i, i, i, 0, 0, (i, -i, i)).encode()
        writer.add_message(numbers[i % channels], T + i, payload, T + i, i)


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE])
@pytest.mark.parametrize("channels", [1, 3])
def test_other_writers_options(
    tmp_path: Path, compression: CompressionType, index: IndexType, channels: int
) -> None:
    path = foreign(
        tmp_path / "a.mcap",
        lambda writer: fill_imu(writer, channels),
        compression=compression,
        index_types=index,
        chunk_size=1500,
        enable_data_crcs=channels == 3,
    )
    recording = read_recording(path)
    assert recording.is_complete
    assert recording.imu(B1)["sequence"].tolist() == list(range(100))
    assert recording.imu(B1)["gyro"][:, 1].tolist() == [-i for i in range(100)]


def test_chunks_without_a_checksum_are_noted(tmp_path: Path) -> None:
    recording = read_recording(foreign(tmp_path / "a.mcap", fill_imu, enable_crcs=False))
    assert recording.notes == ("1 chunks have no checksum",)
    assert len(recording.imu(B1)) == 100


def test_unknown_topics_are_noted_and_not_read(tmp_path: Path) -> None:
    def fill(writer: Writer) -> None:
        fill_imu(writer)
        text = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        fixed = writer.register_schema("x/msg/P", "ros2msg", b"float64[2] p\nint8 q")
        json = writer.register_schema("j", "jsonschema", b"{}")
        for topic, encoding, schema in (("/s", "cdr", text), ("/j", "json", json)):
            number = writer.register_channel(topic, encoding, schema, {})
            writer.add_message(number, T, b"\0\1\0\0\1\0\0\0\0", T)
        number = writer.register_channel("/p", "cdr", fixed, {})
        writer.add_message(number, T, b"\0\1\0\0" + np.array([1.5, 2.5]).tobytes() + b"\7", T)
        number = writer.register_channel("/board/no name!/imu_raw", "cdr", 1, {})
        writer.add_message(number, T, ImuRaw(T, 0, 0, 0, 0, (0, 0, 0)).encode(), T)

    recording = read_recording(foreign(tmp_path / "a.mcap", fill))
    assert recording.is_complete
    assert recording.board_ids == ("B-1",)
    assert len(recording.notes) == 4
    for topic in ("/s", "/p"):
        with pytest.raises(InputError):
            recording.array(topic)


def test_repeated_metadata_is_noted(tmp_path: Path) -> None:
    def fill(writer: Writer) -> None:
        writer.add_metadata("gyrorig", {"format": "1", "session": "other"})

    recording = read_recording(foreign(tmp_path / "a.mcap", fill))
    assert recording.notes == ("metadata 'gyrorig' occurs twice; the last one is used",)
    assert recording.metadata["gyrorig"]["session"] == "other"


def other_fields(writer: Writer) -> None:
    text = IMU_RAW.replace("int32[3] mag\n", "")
    schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", text.encode())
    number = writer.register_channel(imu_raw_topic(B1), "cdr", schema, {})
    writer.add_message(number, T, b"\0\1\0\0" + bytes(48), T)


@pytest.mark.parametrize(
    ("fill", "metadata", "word"),
    [
        (fill_imu, {}, "has no gyrorig metadata"),
        (fill_imu, {"gyrorig": {"format": "2"}}, "format '2'"),
        (fill_imu, {"gyrorig": {}}, "format None"),
        (other_fields, OWN, "does not have the fields that recording format 1 defines"),
    ],
)
def test_other_formats_are_rejected(tmp_path: Path, fill: Any, metadata: Any, word: str) -> None:
    with pytest.raises(InputError, match=word) as caught:
        read_recording(foreign(tmp_path / "a.mcap", fill, metadata))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"x", b"\x89MCAP0\r", b"%PDF-1.7" * 99, bytes(4096)])
def test_other_files_are_rejected(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_rejected(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")  # to open it would wait for ever
    for path in (
        tmp_path,
        tmp_path / "pipe.mcap",
        tmp_path / "none.mcap",
        tmp_path / "none" / "none.mcap",
    ):
        with pytest.raises(InputError):
            read_recording(path)


def test_the_checksum_is_that_of_the_file(tmp_path: Path, script: Any) -> None:
    path = script.write(tmp_path / "a.mcap")
    judged = subprocess.run(["sha256sum", str(path)], capture_output=True, text=True, check=True)
    assert judged.stdout.split()[0] == read_recording(path).sha256


def test_schemas_are_those_of_the_sample(contracts: Path) -> None:
    with (contracts / "sample.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    for schema in summary.schemas.values():
        assert schema.data.decode() == SCHEMAS[schema.name]
