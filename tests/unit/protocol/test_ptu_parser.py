"""The parser's contract: device bytes raise nothing, cuts change nothing, memory is bounded."""

import itertools
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.ptu import (
    Axis,
    Echo,
    InvalidLine,
    InvalidLineReason,
    LimitFlag,
    PtuEvent,
    PtuReplyParser,
    Reply,
)

VECTORS = Path(__file__).resolve().parents[3] / "firmware_protocol" / "vectors"
CASES: list[dict[str, Any]] = json.loads((VECTORS / "ptu_replies.json").read_text())["vectors"]
_EVENT_KINDS = {"InvalidLine": "FrameError"}  # names of classes as the vectors have them

# Bytes that mean something to the parser are far more likely than the rest.
_PIECES = st.sampled_from(
    [
        b"!P",
        b"!T",
        b"!D",
        b"!",
        b"*",
        b"* 22\r\n",
        b"PP ",
        b"\r",
        b"\n",
        b"\r\n",
        b" ",
        b"! Value\r\n",
    ]
    + [bytes.fromhex(case["bytes_hex"]) for case in CASES]
)
STREAMS = st.lists(_PIECES | st.binary(max_size=12), max_size=30).map(b"".join)


def without_stamps(event: PtuEvent) -> tuple[Any, ...]:
    named = [field.name for field in fields(event) if not field.name.endswith("_ns")]
    return (type(event), *(getattr(event, name) for name in named))


def parse(pieces: list[bytes], max_line_bytes: int = 256) -> list[tuple[Any, ...]]:
    parser = PtuReplyParser(max_line_bytes)
    events = []
    for index, piece in enumerate(pieces):
        events += parser.feed(piece, index)
        assert parser.buffered_bytes <= max_line_bytes
    return [without_stamps(event) for event in events]


def split(stream: bytes, cuts: list[int]) -> list[bytes]:
    bounds = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    return [stream[a:b] for a, b in itertools.pairwise(bounds)]


@given(stream=STREAMS, cuts=st.lists(st.integers(0, 400), max_size=8), limit=st.integers(1, 40))
def test_cuts_do_not_change_events(stream: bytes, cuts: list[int], limit: int) -> None:
    complete = parse([stream], limit)
    assert parse(split(stream, cuts), limit) == complete
    assert parse([bytes([byte]) for byte in stream], limit) == complete


@given(garbage=STREAMS | st.binary(max_size=600))
def test_garbage_raises_nothing_and_a_reply_after_it_is_read(garbage: bytes) -> None:
    events = parse([garbage, b"\r\n", b"* 22\r\n"], 64)
    assert events[-1] == (Reply, True, "22", "", b"* 22\r\n")


@given(case=st.sampled_from(CASES), garbage=STREAMS)
def test_a_reply_before_garbage_is_not_changed_by_it(case: dict[str, Any], garbage: bytes) -> None:
    stream = bytes.fromhex(case["bytes_hex"]) + b"\r\n"
    alone = parse([stream])
    assert parse([stream + garbage])[: len(alone)] == alone


@given(data=st.binary(min_size=1, max_size=300), limit=st.integers(1, 64))
def test_raw_bytes_of_an_error_are_bounded(data: bytes, limit: int) -> None:
    events = PtuReplyParser(limit).feed(data * 3 + b"\n", 0)
    assert all(len(e.raw) <= limit for e in events if isinstance(e, Reply | InvalidLine))


@given(number=st.integers(-(2**31), 2**31 - 1), echo=st.sampled_from(["", "PP ", "tp ", "BT "]))
def test_replies_round_trip(number: int, echo: str) -> None:
    ((kind, ok, text, received, _raw),) = parse([f"{echo}* {number}\r\n".encode()])
    assert (kind, ok, int(text), received) == (Reply, True, number, echo.strip())


@pytest.mark.parametrize("case", CASES, ids=lambda case: str(case["name"]))
def test_vectors(case: dict[str, Any]) -> None:
    events = PtuReplyParser().feed(bytes.fromhex(case["bytes_hex"]), 0)
    assert [_EVENT_KINDS.get(type(event).__name__, type(event).__name__) for event in events] == [
        e["kind"] for e in case["events"]
    ]
    for event, expected in zip(events, case["events"], strict=True):
        for name, value in expected.items():
            if name == "reason":
                assert isinstance(event, InvalidLine)
                assert event.reason is InvalidLineReason[value]
            elif name != "kind":
                assert getattr(event, name) == value


def test_timestamps_are_those_of_status_mark_and_line_end() -> None:
    parser = PtuReplyParser()
    assert parser.feed(b"PP ", 10) == []
    assert parser.feed(b"*", 20) == []
    assert parser.feed(b" 2", 30) == []
    assert parser.feed(b"2\r", 40) == []
    (reply,) = parser.feed(b"\n", 50)
    assert reply == Reply(True, "22", "PP", b"PP * 22\r\n", 20, 50)


def test_the_timestamp_of_an_error_is_that_of_its_mark() -> None:
    parser = PtuReplyParser()
    parser.feed(b"!", 10)
    (reply,) = parser.feed(b" Value\r\n", 20)
    assert isinstance(reply, Reply)
    assert (reply.ok, reply.first_byte_ns, reply.last_byte_ns) == (False, 10, 20)


def test_a_limit_flag_is_reported_at_once_inside_a_long_line() -> None:
    parser = PtuReplyParser(16)
    (error,) = parser.feed(b"x" * 17, 1)
    assert isinstance(error, InvalidLine)
    assert error.reason is InvalidLineReason.OVERSIZE
    assert parser.feed(b"xx!", 2) == []
    assert parser.feed(b"T", 3) == [LimitFlag(Axis.TILT, 3)]
    assert parser.feed(b"xx\r\n* 1\r\n", 4) == [Reply(True, "1", "", b"* 1\r\n", 4, 4)]


def test_a_line_as_long_as_the_limit_is_read_and_one_byte_more_is_not() -> None:
    assert parse([b"* 3456789\r\n"], 10)[0][0] is Reply
    assert parse([b"* 34567890\r\n"], 10)[0][:2] == (InvalidLine, InvalidLineReason.OVERSIZE)


def test_the_echo_of_another_command_is_rejected() -> None:
    parser = PtuReplyParser()
    parser.expect("TP")
    (event,) = parser.feed(b"PP * 22\r\n", 0)
    assert isinstance(event, InvalidLine)
    assert event.reason is InvalidLineReason.OTHER_ECHO
    for line in (b"TP * 22\r\n", b"tp  * 22\r\n", b"* 22\r\n"):
        (event,) = parser.feed(line, 0)
        assert isinstance(event, Reply)
    parser.expect("PO100 TO50 A")
    events = parser.feed(b"PO100 *\r\nTO50 A *\r\n", 0)
    assert all(isinstance(event, Reply) for event in events)
    parser.expect(None)
    assert isinstance(parser.feed(b"PP * 22\r\n", 0)[0], Reply)


def test_reset_drops_an_unfinished_line() -> None:
    parser = PtuReplyParser()
    parser.feed(b"garbage * !", 0)
    parser.reset()
    assert parser.buffered_bytes == 0
    assert parser.feed(b"PP\r\n", 7) == [Echo("PP", 7)]
