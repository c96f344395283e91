"""GCB1 against independent implementations: PyPI cobs, a bitwise CRC, struct's own layouts."""

import json
import struct
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cobs import cobs as pypi_cobs  # type: ignore[import-untyped]
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.board import (
    Ack,
    Batch,
    Edge,
    FaultCause,
    FrameEvent,
    FrameFault,
    FrameParser,
    Hello,
    HelloRequest,
    Sample,
    SampleFlag,
    Sensor,
    Set,
    Slow,
    TimeReply,
    TimeRequest,
    cobs,
    decode_payload,
)
from gyrorig_protocol.board.crc import compute_crc16
from gyrorig_protocol.board.frame_encoding import encode_frame
from gyrorig_protocol.errors import UsageError

VECTORS = Path(__file__).resolve().parents[3] / "firmware_protocol" / "vectors"
CASES: list[dict[str, Any]] = json.loads((VECTORS / "board_frames.json").read_text())["vectors"]
TYPES = (Sample, Batch, Slow, Edge, Hello, HelloRequest, TimeRequest, TimeReply, Set, Ack)


def bitwise_crc(data: bytes) -> int:
    # The definition: polynomial 0x1021, start 0xFFFF, nothing reflected, no final xor.
    register = 0xFFFF
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            register = (register << 1) ^ 0x1021 if register & 0x8000 else register << 1
            register &= 0xFFFF
    return register


def i16() -> st.SearchStrategy[int]:
    return st.integers(-(2**15), 2**15 - 1)


def unsigned(bits: int) -> st.SearchStrategy[int]:
    return st.integers(0, 2**bits - 1)


TRIPLES = st.tuples(i16(), i16(), i16())
SAMPLES = st.builds(Sample, unsigned(8), unsigned(16), unsigned(32), TRIPLES, TRIPLES, i16())


@st.composite
def batches(draw: st.DrawFn) -> Batch:
    six = draw(st.booleans())
    count = draw(st.integers(1, 19 if six else 39))
    rows = st.lists(TRIPLES, min_size=count, max_size=count).map(tuple)
    accel = draw(rows) if six else None
    head = (draw(unsigned(8)), draw(unsigned(16)), draw(unsigned(32)))
    return Batch(*head, draw(rows), accel, draw(i16()))


SLOWS = st.builds(
    Slow,
    unsigned(64),
    unsigned(16),
    *[unsigned(32)] * 5,
    i16(),
    st.none() | st.integers(-(2**15) + 1, 2**15 - 1),
    st.none() | st.integers(1, 65535),
)
POSITIVE = st.none() | st.floats(1e-3, 1e6)
HELLOS = st.builds(
    Hello,
    st.integers(1, 255),
    st.just("1.0"),
    st.just("uno"),
    st.text("0123456789abcdef", max_size=24),
    unsigned(16),
    st.tuples(st.builds(Sensor, unsigned(8), st.floats(1, 2000), st.floats(1e-4, 1))),
    config=st.text("0123456789abcdef", max_size=8),
)
SMALL = st.none() | st.integers(1, 4000).map(float)
FRAMES = st.one_of(
    SAMPLES,
    batches(),
    SLOWS,
    HELLOS,
    st.builds(Edge, unsigned(64), unsigned(8), st.booleans()),
    st.just(HelloRequest()),
    st.builds(TimeRequest, unsigned(32), unsigned(64)),
    st.builds(TimeReply, unsigned(32), *[unsigned(64)] * 3),
    st.builds(Set, SMALL, SMALL, SMALL, st.none() | st.integers(1, 39)),
    st.builds(Ack, st.just("5e6f7a8b"), SMALL, accel=st.booleans()),
)


@given(payload=st.lists(st.just(0) | st.integers(0, 255), max_size=253).map(bytes))
def test_cobs_equals_the_pypi_package(payload: bytes) -> None:
    stuffed = cobs.encode(payload)
    assert stuffed == pypi_cobs.encode(payload)
    assert len(stuffed) == len(payload) + 1
    assert 0 not in stuffed
    assert cobs.decode(stuffed) == payload


@given(stuffed=st.binary(min_size=1, max_size=254).map(lambda data: data.replace(b"\0", b"\1")))
def test_cobs_rejects_what_the_pypi_package_rejects(stuffed: bytes) -> None:
    try:
        expected = pypi_cobs.decode(stuffed)
    except pypi_cobs.DecodeError:
        expected = None
    assert cobs.decode(stuffed) == expected


def test_cobs_bounds() -> None:
    assert cobs.decode(b"") is None
    assert cobs.decode(b"\1" * 255) is None
    with pytest.raises(UsageError):
        cobs.encode(bytes(254))


@given(data=st.binary(max_size=300))
def test_crc_follows_its_definition(data: bytes) -> None:
    assert compute_crc16(data) == bitwise_crc(data)


def test_crc_check_value() -> None:
    # The check value of CRC-16/CCITT-FALSE in the catalogue of CRC algorithms.
    assert compute_crc16(b"123456789") == 0x29B1


@given(frame=FRAMES)
def test_frames_round_trip_and_match_the_independent_encoder(frame: Any) -> None:
    payload = frame.encode_payload()
    checked = payload + bitwise_crc(payload).to_bytes(2, "little")
    wire = b"\0" + pypi_cobs.encode(checked) + b"\0"
    assert frame.encode() == wire
    (event,) = FrameParser().feed(wire, 5)
    assert event == FrameEvent(frame, 5, len(wire) - 1, payload)


@pytest.mark.parametrize("case", CASES, ids=lambda case: str(case["name"]))
def test_vectors(case: dict[str, Any]) -> None:
    wire = bytes.fromhex(case["wire_hex"])
    (event,) = FrameParser().feed(wire, 0)
    if "fault" in case:
        assert isinstance(event, FrameFault)
        assert event.cause is FaultCause[case["fault"]]
        return
    assert isinstance(event, FrameEvent)
    kind = {kind.__name__: kind for kind in TYPES}[case["type"]]
    assert type(event.frame) is kind
    for name, value in case["fields"].items():
        assert json.loads(msgspec.json.encode(getattr(event.frame, name))) == value
    if not issubclass(kind, Hello | Set | Ack):  # JSON has several spellings
        assert event.frame.encode() == wire


@given(payload=st.binary(max_size=248))
def test_any_payload_gives_a_frame_or_a_fault_cause(payload: bytes) -> None:
    decoded = decode_payload(payload)
    assert isinstance(decoded, (FaultCause, *TYPES))


@given(frame=FRAMES, cut=st.integers(1, 40))
def test_a_payload_of_wrong_length_is_never_accepted(frame: Any, cut: int) -> None:
    payload = frame.encode_payload()
    for damaged in (payload[: max(len(payload) - cut, 0)], payload + b"\1" * cut):
        decoded = decode_payload(damaged)
        if isinstance(frame, Batch) and isinstance(decoded, Batch):
            # The count is in the head, so that no other number of samples fits. The length alone
            # states whether a batch has accelerations. The checksum of the frame protects it.
            assert cut == 6 * len(frame.gyro) == 6 * len(decoded.gyro)
            assert (frame.accel is None) != (decoded.accel is None)
            continue
        # A request is a HELLO without JSON.
        assert isinstance(decoded, FaultCause) or decoded == HelloRequest()


def test_the_length_of_a_batch_states_whether_it_has_accelerations() -> None:
    still = (0, 0, 0)
    batch = Batch(0, 0, 0, (still,) * 4, None, 0)
    decoded = decode_payload(batch.encode_payload() + b"\1" * 24)
    assert isinstance(decoded, Batch)
    assert len(decoded.gyro) == 4
    assert decoded.accel is not None


@given(kind=st.sampled_from([0x10, 0x30, 0x31]), text=st.text(max_size=100) | st.binary())
def test_untrusted_json_gives_a_fault_cause(kind: int, text: str | bytes) -> None:
    data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    assert isinstance(decode_payload(bytes([kind]) + data), (FaultCause, *TYPES))


GOOD = '{"proto":1,"fw":"1","board":"b","uid":"u","boot":1,"sensors":[%s]}'
SENSOR = '{"who":211,"fs":250,"lsb":0.00875}'


@pytest.mark.parametrize(
    "text",
    [
        "[" * 240,
        '{"a":' * 48,
        GOOD % "",
        GOOD % SENSOR.replace("250", "0"),
        GOOD % SENSOR.replace("250", "-250"),
        GOOD % SENSOR.replace("250", "NaN"),
        GOOD % SENSOR.replace("250", "1e999"),
        GOOD % SENSOR.replace("250", "1e-310"),
        GOOD % SENSOR.replace("250", '"250"'),
        GOOD % SENSOR.replace("250", "9" * 100),
        GOOD % SENSOR.replace("211", "-1"),
        GOOD % SENSOR.replace("211", '""'),
        (GOOD % SENSOR).replace('"boot":1', '"boot":1.5'),
        (GOOD % SENSOR).replace('"boot":1', '"boot":99999999999999999999'),
        (GOOD % SENSOR).replace('"proto":1', '"proto":0'),
        (GOOD % SENSOR).replace('"uid":"u"', '"uid":"\\u0000"'),
        (GOOD % SENSOR).replace('"uid":"u"', '"uid":"a\\nb"'),
        (GOOD % SENSOR).replace('"uid":"u",', ""),
        GOOD % ",".join(['{"who":1,"fs":1,"lsb":1}'] * 5),
        (GOOD % SENSOR) + "x",
    ],
)
def test_an_invalid_hello_is_rejected(text: str) -> None:
    assert decode_payload(b"\x10" + text.encode()) is FaultCause.CONTENT


def test_a_hello_with_keys_of_a_newer_board_is_read() -> None:
    newer = (GOOD % SENSOR).replace('"proto":1', '"proto":1,"moon":{"phase":[[[]]]}')
    decoded = decode_payload(b"\x10" + newer.encode())
    assert isinstance(decoded, Hello)
    assert decoded.sensors == (Sensor(211, 250.0, 0.00875),)
    assert decoded.tick_hz == 1e6


def test_a_hello_of_two_sensors_fits_into_a_frame() -> None:
    sensors = (
        Sensor(211, 250.0, 0.00875, 100.0, 25.0),
        Sensor("adxl345", 4.0, 0.0039, unit="g"),
    )
    hello = Hello(1, "1.0.0", "uno", "0123456789abcdef01234567", 12, sensors, config="1a2b3c4d")
    (event,) = FrameParser().feed(hello.encode(), 0)
    assert isinstance(event, FrameEvent)
    assert event.frame == hello


def test_values_out_of_range_are_rejected_before_sending() -> None:
    triple = (0, 0, 0)
    for frame in (
        Sample(0, 0, 0, (32768, 0, 0), triple, 0),
        Sample(256, 0, 0, triple, triple, 0),
        Sample(0, 65536, 0, triple, triple, 0),
        Sample(0, 0, 2**32, triple, triple, 0),
        Batch(0, 0, 0, (), None, 0),
        Batch(0, 0, 0, (triple,), (triple, triple), 0),
        Batch(0, 0, 0, (triple,) * 40, None, 0),
        Batch(0, 0, 0, (triple,) * 20, (triple,) * 20, 0),
        Hello(1, "f" * 64, "b" * 64, "u" * 64, 1, (Sensor(1, 1.0, 1.0),) * 2),
        TimeRequest(-1, 0),
    ):
        with pytest.raises(UsageError):
            frame.encode()
    with pytest.raises(UsageError):
        encode_frame(bytes(249))
    assert len(encode_frame(bytes(248))) == 253


def test_a_sample_has_27_bytes_and_shares_a_delimiter() -> None:
    wire = Sample(4, 1, 2, (3, 4, 5), (6, 7, 8), 9).encode()
    assert len(wire) == 27
    assert len(FrameParser().feed(wire + wire[1:], 0)) == 2


@given(frame=SAMPLES)
def test_the_layout_is_the_documented_one(frame: Sample) -> None:
    _, flags, sequence, time, *values = struct.unpack("<BBHI7h", frame.encode_payload())
    assert (flags, sequence, time) == (frame.flags, frame.sequence, frame.device_time)
    assert tuple(values) == (*frame.gyro, *(frame.accel or ()), frame.temperature)


def test_missing_values_are_sent_as_zero() -> None:
    (event,) = FrameParser().feed(Sample(0, 1, None, (1, 2, 3)).encode(), 0)
    assert isinstance(event, FrameEvent)
    assert event.frame == Sample(0, 1, 0, (1, 2, 3), (0, 0, 0), 0)


def test_a_batch_gives_samples_with_timestamps_that_wrap() -> None:
    rows = ((1, 2, 3), (4, 5, 6), (7, 8, 9))
    samples = Batch(SampleFlag.SATURATED, 65534, 1500, rows, rows[::-1], 9).to_samples(1250.0)
    assert [s.sequence for s in samples] == [65534, 65535, 0]
    assert [s.device_time for s in samples] == [2**32 - 1000, 250, 1500]
    assert [s.gyro for s in samples] == list(rows)
    assert [s.accel for s in samples] == list(rows[::-1])
    fifo = SampleFlag.SATURATED | SampleFlag.STAMP_FROM_FIFO
    assert [s.flags for s in samples] == [fifo, fifo, SampleFlag.SATURATED]
    assert Batch(0, 0, 0, rows, None, 9).to_samples(1.0)[0].accel is None
