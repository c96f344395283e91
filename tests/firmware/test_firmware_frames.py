"""The C packer against the shared vectors and the Python encoder, both ways."""

import json
from collections.abc import Callable, Sequence
from ctypes import (
    CDLL,
    c_char_p,
    c_int16,
    c_uint8,
    c_uint16,
    c_uint32,
    c_uint64,
    create_string_buffer,
)
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.board import (
    Batch,
    Edge,
    FrameEvent,
    FrameParser,
    Sample,
    Slow,
    TimeReply,
)
from gyrorig_protocol.board.crc import compute_crc16
from gyrorig_protocol.board.frame_encoding import encode_frame

VECTORS = Path(__file__).resolve().parents[2] / "firmware_protocol" / "vectors"
CASES: list[dict[str, Any]] = json.loads((VECTORS / "board_frames.json").read_text())["vectors"]
NO_AIR = -32768


def wire(function: Any, *arguments: Any) -> bytes:
    buffer = create_string_buffer(253)
    size = function(buffer, *arguments)
    return buffer.raw[:size]


def counts(values: Sequence[int]) -> Any:
    return (c_int16 * len(values))(*values)


def c_sample(lib: CDLL, f: Sample) -> bytes:
    assert f.device_time is not None
    assert f.accel is not None
    assert f.temperature is not None
    head = c_uint8(f.flags), c_uint16(f.sequence), c_uint32(f.device_time)
    return wire(lib.vf_sample, *head, counts(f.gyro), counts(f.accel), c_int16(f.temperature))


def c_batch(lib: CDLL, f: Batch) -> bytes:
    gyro = [n for row in f.gyro for n in row]
    accel = [n for row in f.accel or f.gyro for n in row]
    head = c_uint8(f.flags), c_uint16(f.sequence), c_uint32(f.device_time)
    shape = c_uint8(3 if f.accel is None else 6), c_uint8(len(f.gyro))
    return wire(lib.vf_batch, *head, *shape, counts(gyro), counts(accel), c_int16(f.temperature))


def c_slow(lib: CDLL, f: Slow) -> bytes:
    numbers = (
        f.sequence,
        f.sensor_overruns,
        f.frames_dropped,
        f.bus_errors,
        f.saturations,
    )
    air = NO_AIR if f.air_temperature_decidegc is None else f.air_temperature_decidegc
    tail = c_int16(f.temperature), c_int16(air), c_uint16(f.supply_mv or 0)
    counters = (c_uint32 * 5)(*numbers)
    return wire(lib.vf_slow, c_uint64(f.device_time), c_uint16(f.boot), counters, *tail)


def c_edge(lib: CDLL, f: Edge) -> bytes:
    return wire(lib.vf_edge, c_uint64(f.device_time), c_uint8(f.input), c_uint8(f.rising))


def c_time_reply(lib: CDLL, f: TimeReply) -> bytes:
    ping = f.nonce.to_bytes(4, "little") + f.host_stamp.to_bytes(8, "little")
    return wire(lib.vf_time_reply, ping, c_uint64(f.device_receive), c_uint64(f.device_send))


def c_ack(lib: CDLL, fields: dict[str, Any]) -> bytes:
    rate, low = round(fields["rate_hz"] * 10), round(fields["bandwidth_hz"] * 10)
    ends = c_uint8(fields["batch"]), c_uint8(fields["accel"])
    config = c_uint32(int(fields["config"], 16))
    full_scale = c_uint16(round(fields["full_scale_dps"]))
    return wire(lib.vf_ack, c_uint16(rate), c_uint16(low), full_scale, *ends, config)


def c_hello(lib: CDLL, fields: dict[str, Any]) -> bytes:
    (sensor,) = fields["sensors"]
    names = (c_char_p(fields[key].encode()) for key in ("fw", "board", "uid"))
    head = c_uint16(fields["boot"]), c_uint32(int(fields["config"], 16))
    rates = (c_uint16(round(sensor[key] * 10)) for key in ("odr", "bw"))
    who, full_scale = c_uint16(sensor["who"]), c_uint16(round(sensor["fs"]))
    per_count = c_char_p(str(sensor["lsb"]).encode())
    return wire(lib.vf_hello, *names, *head, who, full_scale, *rates, per_count, c_char_p(b"dps"))


FROM_FIELDS: dict[str, Callable[[CDLL, dict[str, Any]], bytes]] = {
    "Sample": lambda lib, fields: c_sample(lib, Sample(**fields)),
    "Batch": lambda lib, fields: c_batch(lib, Batch(**fields)),
    "Slow": lambda lib, fields: c_slow(lib, Slow(**fields)),
    "Edge": lambda lib, fields: c_edge(lib, Edge(**fields)),
    "TimeReply": lambda lib, fields: c_time_reply(lib, TimeReply(**fields)),
    "Ack": c_ack,
    "Hello": c_hello,
}
PACKED = [case for case in CASES if case.get("type") in FROM_FIELDS]


@pytest.mark.parametrize("case", PACKED, ids=lambda case: str(case["name"]))
def test_c_makes_the_bytes_of_the_vector(library: CDLL, case: dict[str, Any]) -> None:
    assert FROM_FIELDS[case["type"]](library, case["fields"]).hex() == case["wire_hex"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: str(case["name"]))
def test_c_decodes_the_vector(library: CDLL, case: dict[str, Any]) -> None:
    # A board knows faults of stuffing and check only; those of content are its host's.
    data = bytes.fromhex(case["wire_hex"])
    for piece in filter(None, data.split(b"\0")):
        if len(piece) > 251:
            continue
        buffer = create_string_buffer(piece, len(piece))
        size = library.gyb_unstuff(buffer, c_uint8(len(piece)))
        if case.get("fault") in ("CRC", "COBS", "OVERSIZE"):
            assert size == 0
        else:
            assert encode_frame(buffer.raw[1 : size + 1]) == data


def i16() -> st.SearchStrategy[int]:
    return st.integers(-(2**15), 2**15 - 1)


def unsigned(bits: int) -> st.SearchStrategy[int]:
    return st.integers(0, 2**bits - 1)


TRIPLES = st.tuples(i16(), i16(), i16())
SAMPLES = st.builds(Sample, unsigned(8), unsigned(16), unsigned(32), TRIPLES, TRIPLES, i16())
AIR = st.none() | st.integers(-(2**15) + 1, 2**15 - 1)
SUPPLY = st.none() | st.integers(1, 65535)
SLOWS = st.builds(Slow, unsigned(64), unsigned(16), *[unsigned(32)] * 5, i16(), AIR, SUPPLY)
EDGES = st.builds(Edge, unsigned(64), unsigned(8), st.booleans())
REPLIES = st.builds(TimeReply, unsigned(32), unsigned(64), unsigned(64), unsigned(64))


@st.composite
def batches(draw: st.DrawFn) -> Batch:
    six = draw(st.booleans())
    count = draw(st.integers(1, 19 if six else 39))
    rows = st.lists(TRIPLES, min_size=count, max_size=count).map(tuple)
    head = draw(unsigned(8)), draw(unsigned(16)), draw(unsigned(32))
    return Batch(*head, draw(rows), draw(rows) if six else None, draw(i16()))


@settings(max_examples=150, deadline=None)
@given(frame=SAMPLES | SLOWS | EDGES | REPLIES | batches())
def test_c_and_python_make_the_same_bytes(
    library: CDLL, frame: Sample | Slow | Edge | TimeReply | Batch
) -> None:
    match frame:
        case Sample():
            made = c_sample(library, frame)
        case Batch():
            made = c_batch(library, frame)
        case Slow():
            made = c_slow(library, frame)
        case Edge():
            made = c_edge(library, frame)
        case TimeReply():
            made = c_time_reply(library, frame)
    assert made == frame.encode()
    (event,) = FrameParser().feed(made, 0)
    assert isinstance(event, FrameEvent)
    assert event.frame == frame


@settings(max_examples=150, deadline=None)
@given(payload=st.binary(min_size=1, max_size=248))
def test_any_payload_round_trips_between_c_and_python(library: CDLL, payload: bytes) -> None:
    buffer = create_string_buffer(b"\xff\xff" + payload, 253)
    size = library.gyb_seal(buffer, c_uint8(len(payload)))
    assert buffer.raw[:size] == encode_frame(payload)
    stuffed = create_string_buffer(buffer.raw[1 : size - 1], size - 2)
    assert library.gyb_unstuff(stuffed, c_uint8(size - 2)) == len(payload)
    assert stuffed.raw[1 : len(payload) + 1] == payload


@settings(max_examples=150, deadline=None)
@given(data=st.binary(min_size=1, max_size=251).map(lambda raw: raw.replace(b"\0", b"\1")))
def test_c_and_python_agree_on_noise(library: CDLL, data: bytes) -> None:
    buffer = create_string_buffer(data, len(data))
    size = library.gyb_unstuff(buffer, c_uint8(len(data)))
    parser = FrameParser()
    parser.feed(b"\0" + data + b"\0", 0)
    named = {cause.name: count for cause, count in parser.faults.items() if count}
    assert (size == 0) == bool({"COBS", "CRC"} & named.keys())


def test_a_cobs_code_beyond_the_end_is_rejected_with_a_valid_checksum(library: CDLL) -> None:
    stuffed = bytearray(Edge(1, 2, True).encode()[1:-1])
    index = 0
    while index + stuffed[index] < len(stuffed):
        index += stuffed[index]
    stuffed[index] += 1  # the last code: what is unstuffed stays the same
    assert library.gyb_unstuff(create_string_buffer(bytes(stuffed)), c_uint8(len(stuffed))) == 0


def test_a_frame_that_is_too_long_is_rejected(library: CDLL) -> None:
    assert library.gyb_seal(create_string_buffer(260), c_uint8(249)) == 0
    assert library.gyb_seal(create_string_buffer(260), c_uint8(0)) == 0
    full = [0] * 120
    head = c_uint8(0), c_uint16(0), c_uint32(0)
    for axes, most in ((3, 39), (6, 19)):
        for count in (most, most + 1):
            made = wire(
                library.vf_batch,
                *head,
                c_uint8(axes),
                c_uint8(count),
                counts(full),
                counts(full),
                0,
            )
            assert bool(made) == (count == most)


def test_the_checksum_is_crc_16_ccitt_false(library: CDLL) -> None:
    library.gyb_crc16.restype = c_uint16
    assert library.gyb_crc16(b"123456789", c_uint8(9)) == 0x29B1 == compute_crc16(b"123456789")
