"""Chunks opened together give what chunks opened alone give, or are opened alone."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording import topic_collector
from gyrorig_protocol.recording.encoding.message_schemas import IMU_RAW
from gyrorig_protocol.recording.mcap.chunk_reader import locate_messages, locate_messages_in_group
from gyrorig_protocol.recording.mcap.record_scan import ChunkRecord
from gyrorig_protocol.recording.messages import ImuRaw, imu_raw_topic
from gyrorig_protocol.recording.reader import read_recording

B1 = BoardId("B-1")


def message(channel: int, size: int) -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + size, channel, 0, 0, 0) + bytes(size)


def chunked(contents: list[bytes], indexes: list[dict[int, list[int]]]) -> Any:
    """Return records of chunks with these contents, their indexes, and a file of the indexes."""
    file, chunks = b"", []
    for content, index in zip(contents, indexes, strict=True):
        bounds = {}
        for channel, offsets in index.items():
            bounds[channel] = (len(file), len(offsets))
            file += b"".join(struct.pack("<QQ", 0, at) for at in offsets)
        chunks.append(ChunkRecord(0, 0, len(content), 0, "", 0, 0, bounds))
    return chunks, b"".join(contents), memoryview(file)


def test_a_group_of_chunks_equals_single_chunks() -> None:
    contents = [message(1, 8) + message(2, 5) + message(1, 8), message(2, 5), message(1, 8)]
    chunks, joined, file = chunked(contents, [{1: [0, 75], 2: [39]}, {2: [0]}, {1: [0]}])
    actual = locate_messages_in_group(chunks, joined, file)
    assert actual is not None
    base = 0
    expected: dict[int, list[int]] = {}
    for chunk, content in zip(chunks, contents, strict=True):
        for channel, offsets in locate_messages(chunk, content, file).offsets.items():
            expected.setdefault(channel, []).extend((offsets + base).tolist())
        base += len(content)
    assert {channel: offsets.tolist() for channel, offsets in actual.items()} == expected


def test_a_message_across_two_chunks_is_not_one() -> None:
    complete = message(1, 8) + message(1, 8)
    chunks, joined, file = chunked([complete[:50], complete[50:]], [{1: [0, 39]}, {}])
    assert locate_messages_in_group(chunks, joined, file) is None


@pytest.mark.parametrize(
    "index",
    [
        {1: [0]},  # a message that no index names
        {1: [0, 39], 2: [39]},  # one that two name
        {1: [0, 40]},  # none there
        {1: [0, -39]},
        {1: [0, 4000]},
        {2: [0, 39]},  # of another channel
        {},
    ],
)
def test_an_index_without_proof_is_not_used(index: dict[int, list[int]]) -> None:
    contents = [message(1, 8), message(1, 8) * 2]
    chunks, joined, file = chunked(
        contents, [{1: [0]}, {c: [a % 2**64 for a in at] for c, at in index.items()}]
    )
    assert locate_messages_in_group(chunks, joined, file) is None


@pytest.mark.parametrize("group_bytes", [1, 3000, 1 << 19])
@pytest.mark.parametrize("damage", [None, 0.3, 0.6, 0.9])
def test_groups_of_any_size_give_the_same(
    tmp_path: Path,
    scripted: Any,
    monkeypatch: pytest.MonkeyPatch,
    group_bytes: int,
    damage: float | None,
) -> None:
    path = scripted(200, 20).write(tmp_path / "r.mcap")
    if damage is not None:
        content = bytearray(path.read_bytes())
        content[int(len(content) * damage)] ^= 1
        path.write_bytes(content)
    monkeypatch.setattr(topic_collector, "MAX_GROUP_BYTES", 1)
    expected = read_recording(path)
    monkeypatch.setattr(topic_collector, "MAX_GROUP_BYTES", group_bytes)
    actual = read_recording(path)
    assert actual.losses == expected.losses
    assert bool(actual.losses) == (damage is not None)
    for topic in expected.topics:
        assert actual.messages(topic) == expected.messages(topic)


def test_an_invalid_message_is_attributed_to_its_chunk(
    tmp_path: Path, contract_metadata: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "r.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="other 1")
        for name, record in contract_metadata.items():
            writer.add_metadata(name, {**record, **({"format": "1"} if name == "gyrorig" else {})})
        schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", IMU_RAW.encode())
        number = writer.register_channel(imu_raw_topic(B1), "cdr", schema, {})
        for i in range(200):
            payload = ImuRaw(i, i, i, 0, 0, (i, -i, i)).encode()
            if i in {133, 157}:
                payload = b"\x00\x02" + payload[2:]  # no header that we know
            writer.add_message(number, i, payload, i, i)
            if i % 10 == 9:
                writer.flush()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]
    together = read_recording(path)
    monkeypatch.setattr(topic_collector, "MAX_GROUP_BYTES", 1)
    alone = read_recording(path)
    assert [loss.messages for loss in alone.losses] == [2]
    assert together.losses == alone.losses
    assert np.array_equal(together.imu(B1), alone.imu(B1))
