"""Cut or damaged anywhere, a recording gives what is sound and states the rest."""

import random
import struct
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.message_schemas import IMU_RAW
from gyrorig_protocol.recording.mcap.losses import LossCause
from gyrorig_protocol.recording.messages import ImuRaw, imu_raw_topic
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording

T = 1_790_000_000_000_000_000
B1 = BoardId("B-1")

MAGIC = b"\x89MCAP0\r\n"


def read_bytes(folder: Path, content: bytes) -> Recording | InputError:
    path = folder / "x.mcap"
    path.write_bytes(content)
    try:
        return read_recording(path)
    except InputError as error:
        return error


def contents(recording: Recording) -> dict[str, list[Any]]:
    actual = {topic: recording.messages(topic) for topic in recording.topics}
    return {topic: messages for topic, messages in actual.items() if messages}


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """(byte behind the chunk, messages up to there), from the stock reader's own index."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    total, actual = 0, []
    complete = path.read_bytes()
    for chunk in summary.chunk_indexes:
        for index in chunk.message_index_offsets.values():
            total += struct.unpack_from("<I", complete, index + 11)[0] // 16
        actual.append((chunk.chunk_start_offset + chunk.chunk_length, total))
    return actual


def record_ends(whole: bytes) -> tuple[list[int], int]:
    """Where the top-level records end, and where the data section does."""
    index, ends, data_end = len(MAGIC), [len(MAGIC)], 0
    while index < len(whole) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", whole, index)
        index += 9 + length
        ends.append(index)
        data_end = index if opcode == 0x0F else data_end
    return ends, data_end


@pytest.mark.long
@pytest.mark.parametrize("block", range(8))
def test_cut_at_every_byte(tmp_path: Path, scripted: Any, block: int) -> None:
    script = scripted(4, flush_every=5)
    path = script.write(tmp_path / "a.mcap")
    complete = path.read_bytes()
    ends = chunk_ends(path)
    assert len(ends) >= 4
    records, data_end = record_ends(complete)
    expected = [script.by_topic(count) for count in range(len(script.entries) + 1)]
    for length in range(block, len(complete), 8):
        actual = read_bytes(tmp_path, complete[:length])
        count = max((n for end, n in ends if end <= length), default=0)
        if isinstance(actual, InputError):
            assert count == 0
            continue
        assert contents(actual) == expected[count], length
        assert not actual.is_complete
        causes = {loss.cause for loss in actual.losses}
        assert causes <= {LossCause.UNFINISHED, LossCause.TRUNCATED, LossCause.SUMMARY}
        for loss in actual.losses:
            assert loss.offset + loss.bytes == length
        # Whatever lies behind the last whole record is stated, to the byte.
        used = max(end for end in records if end <= min(length, data_end))
        assert sum(loss.bytes for loss in actual.losses) == length - used


def is_stated(recording: Recording, whole: Recording, wanted: dict[str, list[Any]]) -> bool:
    """The same, or a subset in order with the difference stated."""
    present = contents(recording)
    if recording.metadata != whole.metadata or present.keys() - wanted.keys():
        return False
    missing = 0
    for topic, messages in wanted.items():
        rest = iter(messages)
        if not all(message in rest for message in present.get(topic, [])):
            return False
        missing += len(messages) - len(present.get(topic, []))
    if recording.attachments != whole.attachments and recording.is_complete:
        return False
    if missing and recording.is_complete:
        return False
    previous = recording.lost_messages
    return previous is None or missing == 0 or previous >= missing


def flip(whole: bytes, bit: int) -> bytes:
    damaged = bytearray(whole)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


@pytest.mark.long
@pytest.mark.parametrize("block", range(8))
def test_single_bit_flips(tmp_path: Path, scripted: Any, block: int) -> None:
    script = scripted(3, flush_every=5)
    path = script.write(tmp_path / "a.mcap")
    intact = path.read_bytes()
    complete = read_recording(path)
    expected = script.by_topic()
    # Every byte of the file once, the blocks together; which bit of it, by its place.
    for index in range(block, len(intact), 8):
        bit = 8 * index + (index // 8 + block) % 8
        actual = read_bytes(tmp_path, flip(intact, bit))
        assert isinstance(actual, InputError) or is_stated(actual, complete, expected), bit


@pytest.mark.parametrize("tail", ["part", "whole"])
def test_bit_flips_in_an_unfinished_file(tmp_path: Path, script: Any, tail: str) -> None:
    path = script.write(tmp_path / "a.mcap")
    end, count = chunk_ends(path)[-2]
    complete = path.read_bytes()
    intact = complete[: end + 20] if tail == "part" else complete
    first = read_bytes(tmp_path, intact)
    assert isinstance(first, Recording)
    expected = script.by_topic(count) if tail == "part" else script.by_topic()
    bits = random.Random(5)
    for _ in range(500):
        bit = bits.randrange(8 * len(intact))
        actual = read_bytes(tmp_path, flip(intact, bit))
        assert isinstance(actual, InputError) or is_stated(actual, first, expected), bit


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    deadline=None,
)
@given(data=st.data())
def test_any_damage_never_raises_anything_else(
    tmp_path: Path, script: Any, data: st.DataObject
) -> None:
    path = tmp_path / "a.mcap"
    path = path if path.exists() else script.write(path)
    intact = path.read_bytes()
    index = data.draw(st.integers(0, len(intact)))
    width = data.draw(st.integers(0, 200))
    noise = data.draw(st.binary(max_size=200))
    actual = read_bytes(tmp_path, intact[:index] + noise + intact[index + width :])
    if isinstance(actual, Recording) and noise != intact[index : index + width]:
        expected = script.by_topic()
        for topic, messages in contents(actual).items():
            rest = iter(expected[topic])
            assert all(message in rest for message in messages)


def test_every_valid_chunk_after_a_damaged_one_is_read(tmp_path: Path, script: Any) -> None:
    path = script.write(tmp_path / "a.mcap")
    intact = path.read_bytes()
    (first_end, first), (second_end, second), *_ = chunk_ends(path)
    index = intact.rindex(b"zstd", first_end, second_end)
    last = len(script.entries)
    expected: dict[str, list[Any]] = {}
    for k, (topic, message, _) in enumerate(script.entries):
        if not first <= k < second:
            expected.setdefault(topic, []).append(message)
    chunk_at = index - 41  # opcode, length, three times u64, CRC, length of the text
    for damaged_at in (
        index + 40,
        index - 5,
        chunk_at,
        chunk_at + 1,
        chunk_at + 8,
        index + 1,
        index + 5,
    ):
        for tail in (len(intact), chunk_ends(path)[-1][0]):  # finished, and not
            damaged = bytearray(intact[:tail])
            damaged[damaged_at] ^= 0x10
            actual = read_bytes(tmp_path, bytes(damaged))
            assert isinstance(actual, Recording)
            assert contents(actual) == expected, damaged_at - chunk_at
            causes = {loss.cause for loss in actual.losses}
            assert causes & {LossCause.DAMAGED, LossCause.REFUSED}
            if tail == len(intact):
                assert (actual.lost_messages or second - first) >= second - first
    assert last > second


def test_the_first_chunk_of_an_unfinished_file_is_damaged(tmp_path: Path, script: Any) -> None:
    path = script.write(tmp_path / "a.mcap")
    (first_end, first), *_, (last_end, last) = chunk_ends(path)
    expected: dict[str, list[Any]] = {}
    for topic, message, _ in script.entries[first:last]:
        expected.setdefault(topic, []).append(message)
    chunk_at = path.read_bytes().index(b"zstd") - 41
    for damaged_at in (chunk_at, chunk_at + 5, chunk_at + 43, first_end - 5):
        damaged = bytearray(path.read_bytes()[:last_end])
        damaged[damaged_at] ^= 0x11
        actual = read_bytes(tmp_path, bytes(damaged))
        assert isinstance(actual, Recording)
        assert contents(actual) == expected
        assert actual.lost_messages in {first, None}


def test_a_wrong_index_does_not_matter(tmp_path: Path, script: Any) -> None:
    path = script.write(tmp_path / "a.mcap")
    intact = path.read_bytes()
    complete = read_recording(path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    random_ = random.Random(1)
    for chunk in summary.chunk_indexes:
        damaged = bytearray(intact)
        for index in chunk.message_index_offsets.values():
            size = struct.unpack_from("<I", intact, index + 11)[0]
            for k in range(index + 15, index + 15 + size):
                damaged[k] = random_.randrange(256)
        actual = read_bytes(tmp_path, bytes(damaged))
        assert isinstance(actual, Recording)
        assert contents(actual) == contents(complete)
        assert actual.is_complete


def test_zeros_after_a_power_cut(tmp_path: Path, script: Any) -> None:
    path = script.write(tmp_path / "a.mcap")
    end, count = chunk_ends(path)[2]
    actual = read_bytes(tmp_path, path.read_bytes()[:end] + bytes(5000))
    assert isinstance(actual, Recording)
    assert contents(actual) == script.by_topic(count)
    assert sum(loss.bytes for loss in actual.losses) == 5000


def test_a_second_recording_in_the_same_file_is_reported(tmp_path: Path, script: Any) -> None:
    path = script.write(tmp_path / "a.mcap")
    first = contents(read_recording(path))
    whole = path.read_bytes()
    actual = read_bytes(tmp_path, whole + whole)
    assert isinstance(actual, Recording)
    assert contents(actual) == first
    assert actual.lost_messages is None
    assert [loss.cause for loss in actual.losses] == [LossCause.DAMAGED]
    assert "further chunks" in actual.losses[0].text


def test_changed_metadata_is_restored_from_its_copy(tmp_path: Path, script: Any) -> None:
    intact = script.write(tmp_path / "a.mcap").read_bytes()
    actual = read_bytes(tmp_path, intact.replace(b"0.000153", b"0.000152", 1))
    assert isinstance(actual, Recording)
    assert actual.metadata["gyrorig.board.B-1"]["gyro_scale_rad_s"] == "0.000153"
    assert [loss.cause for loss in actual.losses] == [LossCause.METADATA]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(packed: bytes, compression: bytes, unpacked_size: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, unpacked_size, crc) + text(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def file_of(*records: bytes) -> bytes:
    main_record = text(b"format") + text(b"1")
    head = record(1, text(b"ros2") + text(b"x")) + record(12, text(b"gyrorig") + text(main_record))
    return MAGIC + head + b"".join(records)


GIGABYTE = 1 << 30


def zstd_bomb(*, with_size: bool) -> bytes:
    size = GIGABYTE if with_size else -1
    packer = zstandard.ZstdCompressor().compressobj(size=size)
    block = bytes(1 << 20)
    return b"".join(packer.compress(block) for _ in range(1 << 10)) + packer.flush()


def lz4_bomb() -> bytes:
    packer = lz4.frame.LZ4FrameCompressor()
    block = bytes(1 << 20)
    parts = [packer.begin(), *(packer.compress(block) for _ in range(1 << 10)), packer.flush()]
    return b"".join(parts)


@pytest.mark.parametrize("claim", ["honest", "below the limit", "by ratio", "small"])
@pytest.mark.parametrize("kind", ["zstd", "zstd without size", "lz4"])
def test_decompression_bombs_are_rejected_without_memory(
    tmp_path: Path, kind: str, claim: str
) -> None:
    bomb = lz4_bomb() if kind == "lz4" else zstd_bomb(with_size=kind == "zstd")
    size = {
        "honest": GIGABYTE,
        "below the limit": 64 << 20,
        "by ratio": len(bomb) * 200,
        "small": 1000,
    }[claim]
    tracemalloc.start()
    try:
        actual = read_bytes(
            tmp_path, file_of(chunk(bomb, kind.split(maxsplit=1)[0].encode(), size))
        )
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert isinstance(actual, Recording)
    assert actual.losses[-1].cause in {LossCause.REFUSED, LossCause.DAMAGED}
    # Sixty-four megabytes are allowed, and unpacking holds them twice; not a gigabyte.
    assert peak < 160 << 20


def test_a_schema_cannot_allocate_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 22)
        writer.start(profile="ros2", library="x")
        writer.add_metadata("gyrorig", {"format": "1"})
        schema = writer.register_schema("x/msg/X", "ros2msg", b"uint8[65000] a")
        number = writer.register_channel("/x", "cdr", schema, {})
        for k in range(20_000):  # a correct index of messages that are far too short
            writer.add_message(number, k, b"\0\1\0\0", k)
        writer.finish()  # type: ignore[no-untyped-call]
    tracemalloc.start()
    try:
        actual = read_recording(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert not actual.losses
    assert actual.notes == (
        "the topic '/x' is not read, because its messages have the unknown type x/msg/X",
    )
    assert "/x" not in actual.topics
    assert peak < 8 << 20


def test_messages_that_do_not_match_their_type_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    valid = [ImuRaw(T + k, k, k, 0, 0, (k, k, k)) for k in range(30)]
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, index_types=IndexType.ALL)
        writer.start(profile="ros2", library="x")
        writer.add_metadata("gyrorig", {"format": "1"})
        schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", IMU_RAW.encode())
        number = writer.register_channel(imu_raw_topic(B1), "cdr", schema, {})
        for k, message in enumerate(valid):
            payload = message.encode()
            writer.add_message(number, T + k, payload, T + k)
            for wrong in (payload[:-1], payload + b"x", b"\0\0" + payload[2:], b""):
                writer.add_message(number, T + k, wrong, T + k)
        writer.finish()  # type: ignore[no-untyped-call]
    actual = read_recording(path)
    assert actual.messages(imu_raw_topic(B1)) == valid
    assert actual.lost_messages == 120


def test_messages_outside_chunks_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(profile="ros2", library="x")
        writer.add_metadata("gyrorig", {"format": "1"})
        schema = writer.register_schema("gyrorig_msgs/msg/ImuRaw", "ros2msg", IMU_RAW.encode())
        number = writer.register_channel(imu_raw_topic(B1), "cdr", schema, {})
        writer.add_message(number, T, ImuRaw(T, 0, 0, 0, 0, (0, 0, 0)).encode(), T)
        writer.finish()  # type: ignore[no-untyped-call]
    actual = read_recording(path)
    assert actual.lost_messages == 1
    assert actual.losses[0].cause is LossCause.REFUSED


@pytest.mark.parametrize(
    "inside",
    [
        b"\x05",
        record(5, bytes(22))[:-1],
        record(5, bytes(21)),
        record(9, b""),
        record(3, b"\1\0"),
        record(5, struct.pack("<HIQQ", 7, 0, T, T)),  # of a channel that nothing declares
    ],
)
def test_a_valid_checksum_over_invalid_content(tmp_path: Path, inside: bytes) -> None:
    item = chunk(inside, b"", len(inside), zlib.crc32(inside))
    actual = read_bytes(tmp_path, file_of(item))
    assert isinstance(actual, Recording)
    assert [loss.cause for loss in actual.losses] == [LossCause.UNFINISHED, LossCause.DAMAGED]
    assert not actual.topics


def test_many_damaged_records_take_linear_time(tmp_path: Path) -> None:
    content = file_of(*[record(0x7F, b"")] * 60_000)
    actual = read_bytes(tmp_path, content)
    assert isinstance(actual, Recording)
    assert sum(loss.bytes for loss in actual.losses) == 9 * 60_000
    assert len(actual.losses) < 5
