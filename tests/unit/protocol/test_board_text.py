"""Text lines: the same contract as frames, units, and what a line may not hide."""

import itertools
import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.board import (
    ColumnMap,
    FaultCause,
    FrameEvent,
    FrameFault,
    Sample,
    TextLineParser,
)
from gyrorig_protocol.board.board_frames import Triple

PLAIN = ColumnMap(gyro=(0, 1, 2))
FULL = ColumnMap(gyro=(1, 2, 3), accel=(4, 5, 6), time=0, temperature=7, columns=8)
_PIECES = st.sampled_from([b"1,2,3\n", b"1 2 3\r\n", b"\n", b"# c\n", b"1,2\n", b"nan 1 2\n", b","])
STREAMS = st.lists(_PIECES | st.binary(max_size=20), max_size=20).map(b"".join)


def parse(pieces: list[bytes], columns: ColumnMap = PLAIN, limit: int = 64) -> list[Any]:
    parser = TextLineParser(columns, mid_stream=False, max_line_bytes=limit)
    events = []
    for index, piece in enumerate(pieces):
        events += parser.feed(piece, index)
        assert parser.buffered_bytes <= limit
    assert parser.frames == sum(isinstance(event, FrameEvent) for event in events)
    assert sum(parser.faults.values()) == len(events) - parser.frames
    return [event.frame if isinstance(event, FrameEvent) else event.cause for event in events]


@given(stream=STREAMS, cuts=st.lists(st.integers(0, 300), max_size=8), limit=st.integers(1, 64))
def test_cuts_do_not_change_events(stream: bytes, cuts: list[int], limit: int) -> None:
    bounds = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    complete = parse([stream], limit=limit)
    assert parse([stream[a:b] for a, b in itertools.pairwise(bounds)], limit=limit) == complete
    assert parse([bytes([byte]) for byte in stream], limit=limit) == complete


@given(before=STREAMS, after=STREAMS)
def test_a_line_in_garbage_is_read(before: bytes, after: bytes) -> None:
    events = parse([before + b"\n", b"-7,8,9\r\n", after])
    assert any(isinstance(e, Sample) and e.gyro == (-7, 8, 9) for e in events)


_I32 = st.integers(-(2**31) + 1, 2**31 - 1)


@given(
    gyro=st.tuples(_I32, _I32, _I32),
    accel=st.tuples(_I32, _I32, _I32),
    time=st.integers(0, 2**64 - 1),
    temperature=st.integers(-(2**15) + 1, 2**15 - 1),
    separator=st.sampled_from([",", ";", "\t", " ", ", ", "  "]),
    end=st.sampled_from(["\n", "\r\n"]),
)
def test_counts_round_trip(
    gyro: Triple, accel: Triple, time: int, temperature: int, separator: str, end: str
) -> None:
    line = separator.join(str(number) for number in (time, *gyro, *accel, temperature)) + end
    (sample,) = parse([line.encode()], FULL, limit=200)
    assert sample == Sample(0, 0, time, gyro, accel, temperature)


@given(rate_dps=st.floats(-2000, 2000))
def test_units_lose_less_than_half_a_count(rate_dps: float) -> None:
    for unit, factor in (("dps", 1.0), ("mdps", 1e3), ("rad/s", math.pi / 180)):
        columns = msgspec.convert({"gyro": (0, 1, 2), "gyro_unit": unit}, ColumnMap)
        (sample,) = parse([f"{rate_dps * factor:.12f} 0 0\n".encode()], columns)
        scale = columns.gyro_scale_rad_s
        assert scale is not None
        assert abs(sample.gyro[0] * scale - math.radians(rate_dps)) <= 0.51 * scale


def test_accel_and_temperature_units() -> None:
    columns = ColumnMap(
        gyro=(0, 0, 0), accel=(1, 1, 1), temperature=2, accel_unit="g", temperature_unit="degC"
    )
    assert columns.accel_scale_m_s2 == 1e-6
    assert columns.temperature_scale_c == 0.01
    (sample,) = parse([b"1 -1 21.57\n"], columns)
    assert sample.accel == (-9_806_650,) * 3
    assert sample.temperature == 2157
    columns = msgspec.structs.replace(columns, accel_unit="mg")
    assert parse([b"1 -1 21.57\n"], columns)[0].accel == (-9807,) * 3
    columns = msgspec.structs.replace(columns, accel_unit="m/s2")
    assert parse([b"1 -1 21.57\n"], columns)[0].accel == (-1_000_000,) * 3
    assert PLAIN.gyro_scale_rad_s is PLAIN.accel_scale_m_s2 is PLAIN.temperature_scale_c is None


@pytest.mark.parametrize(
    ("unit", "text", "ticks", "tick_hz"),
    [
        ("s", "1700000000.123456789", 1_700_000_000_123_456_789, 1e9),
        ("s", "12", 12_000_000_000, 1e9),
        ("s", "0.0000000019", 1, 1e9),
        ("ms", "4294967295", 4_294_967_295_000, 1e6),
        ("ms", "1.25", 1250, 1e6),
        ("us", "4294967295", 4_294_967_295, 1e6),
        ("us", "1.", 1, 1e6),
        ("us", "1.5", None, 1e6),
        ("ns", "18446744073709551615", 2**64 - 1, 1e9),
        ("ns", "18446744073709551616", None, 1e9),
        ("ticks", "7", 7, None),
        ("ticks", "-7", None, None),
        ("s", "1e3", None, 1e9),
        ("s", "nan", None, 1e9),
    ],
)
def test_time_units(unit: str, text: str, ticks: int | None, tick_hz: float | None) -> None:
    columns = msgspec.convert({"gyro": (1, 2, 3), "time": 0, "time_unit": unit}, ColumnMap)
    assert columns.tick_hz == tick_hz
    (event,) = parse([f"{text} 1 2 3\n".encode()], columns)
    if ticks is None:
        assert event is FaultCause.NUMBER
    else:
        assert event.device_time == ticks


@pytest.mark.parametrize(
    "field", ["nan", "inf", "1_0", "1.5", "1e99", "0x10", "", "2147483648", "1e999", "٣", "--1"]
)
def test_invalid_counts_are_faults(field: str) -> None:
    columns = msgspec.structs.replace(PLAIN, separator=",")
    assert parse([f"{field},2,3\n".encode()], columns) == [FaultCause.NUMBER]


@pytest.mark.parametrize("index", range(8))
def test_every_named_column_must_be_a_number(index: int) -> None:
    fields = ["1"] * 8
    assert len(parse([(",".join(fields) + "\n").encode()], FULL)) == 1
    fields[index] = "x"
    assert parse([(",".join(fields) + "\n").encode()], FULL) == [FaultCause.NUMBER]


def test_space_as_the_only_separator_leaves_commas_alone() -> None:
    columns = msgspec.structs.replace(PLAIN, separator=" ")
    assert parse([b"1  2 3\n", b"1,2,3\n", b"1, 2, 3\n"], columns) == [
        Sample(0, 0, None, (1, 2, 3)),
        FaultCause.COLUMNS,
        FaultCause.NUMBER,
    ]


def test_columns() -> None:
    exact = msgspec.structs.replace(PLAIN, columns=3)
    assert parse([b"1 2 3 4\n"]) == [Sample(0, 0, None, (1, 2, 3))]
    assert parse([b"1 2 3 4\n"], exact) == [FaultCause.COLUMNS]
    assert parse([b"1 2\n"]) == [FaultCause.COLUMNS]
    assert FULL.min_columns == 8
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"gyro": [0, 1, 2], "gyro_units": "dps"}, ColumnMap)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"gyro": [0, 1, 256]}, ColumnMap)


def test_comments_blank_lines_and_header_lines_are_skipped() -> None:
    columns = msgspec.structs.replace(PLAIN, skip_lines=2, comment="//")
    assert parse([b"x,y,z\n1,1,1\n\n  \r\n// 3,3,3\n4,5,6\n"], columns) == [
        Sample(0, 0, None, (4, 5, 6))
    ]


def test_an_invalid_line_is_a_gap_and_a_sequence_column_is_kept() -> None:
    events = parse([b"1,1,1\n1,x,1\n2,2,2\n"])
    assert [e.sequence for e in events if isinstance(e, Sample)] == [0, 2]
    columns = msgspec.structs.replace(PLAIN, sequence=3)
    (sample, fault) = parse([b"1,1,1,4294967295\n1,1,1,4294967296\n"], columns)
    assert sample.sequence == 2**32 - 1
    assert fault is FaultCause.NUMBER


def test_the_first_line_of_a_stream_is_dropped_as_incomplete() -> None:
    parser = TextLineParser(PLAIN)
    events = parser.feed(b"23,4,5\n123,4,5\n", 9)
    assert events == [FrameEvent(Sample(0, 0, None, (123, 4, 5)), 9, 14, b"123,4,5")]
    parser.feed(b"12", 9)
    parser.reset()
    assert parser.feed(b"3,4,5\n", 9) == []


def test_a_line_that_is_too_long_is_one_fault() -> None:
    parser = TextLineParser(PLAIN, mid_stream=False, max_line_bytes=10)
    (fault,) = parser.feed(b"1" * 50, 3)
    assert fault == FrameFault(FaultCause.OVERSIZE, 3, 49, b"1" * 11)
    assert parser.feed(b"1" * 50, 3) == []
    assert len(parser.feed(b"\n1,2,3\n", 3)) == 1
