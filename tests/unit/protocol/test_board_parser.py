"""The frame parser's contract: nothing raised, cuts change nothing, no wrong sample accepted."""

import itertools
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrorig_protocol.board import (
    FaultCause,
    FrameEvent,
    FrameFault,
    FrameParser,
    HelloRequest,
    Sample,
    TimeReply,
)
from gyrorig_protocol.board.delimiter_splitter import DelimiterSplitter

MAX_STUFFED_BYTES = 251
FRAME = Sample(4, 7, 123456, (1, -2, 300), (0, 256, -16384), -128)
WIRE = FRAME.encode()
_PIECES = st.sampled_from([WIRE, TimeReply(1, 2, 3, 4).encode(), b"\0", WIRE[:9], b"\1" * 200])
STREAMS = st.lists(_PIECES | st.binary(max_size=30), max_size=20).map(b"".join)


def parse(pieces: list[bytes]) -> list[tuple[Any, ...]]:
    parser = FrameParser()
    events = []
    for index, piece in enumerate(pieces):
        events += parser.feed(piece, index)
        assert parser.buffered_bytes <= MAX_STUFFED_BYTES
    assert parser.frames == sum(isinstance(event, FrameEvent) for event in events)
    assert sum(parser.faults.values()) == len(events) - parser.frames
    return [(e.frame, e.payload) if isinstance(e, FrameEvent) else (e.cause, e.raw) for e in events]


def split(stream: bytes, cuts: list[int]) -> list[bytes]:
    bounds = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    return [stream[a:b] for a, b in itertools.pairwise(bounds)]


@given(stream=STREAMS, cuts=st.lists(st.integers(0, 900), max_size=8))
def test_cuts_do_not_change_events(stream: bytes, cuts: list[int]) -> None:
    complete = parse([stream])
    assert parse(split(stream, cuts)) == complete
    assert parse([bytes([byte]) for byte in stream]) == complete


@given(before=STREAMS, after=STREAMS)
def test_garbage_on_both_sides_costs_no_frame(before: bytes, after: bytes) -> None:
    events = parse([before, WIRE, after])
    assert (FRAME, FRAME.encode_payload()) in events


@given(stream=st.binary(max_size=2000))
def test_pure_garbage_raises_nothing_and_faults_are_bounded(stream: bytes) -> None:
    for event in FrameParser().feed(stream, 0):
        assert isinstance(event, FrameFault)
        assert len(event.raw) <= MAX_STUFFED_BYTES + 1


@given(stream=STREAMS, cut=st.integers(0, 900), limit=st.integers(1, 40))
def test_the_splitter_keeps_every_byte_within_the_limit(
    stream: bytes, cut: int, limit: int
) -> None:
    splitter = DelimiterSplitter(b"\0", limit)
    pieces = splitter.feed(stream[:cut]) + splitter.feed(stream[cut:] + b"\0")
    assert [piece for piece, _ in pieces] == [part[: limit + 1] for part in stream.split(b"\0")]
    assert splitter.buffered_bytes == 0


def test_timestamp_and_offset_are_those_of_the_last_byte() -> None:
    parser = FrameParser()
    assert parser.feed(WIRE[:10], 100) == []
    assert parser.feed(WIRE[10:-1], 200) == []
    events = parser.feed(WIRE[-1:] + WIRE + HelloRequest().encode(), 300)
    assert [(e.received_ns, e.offset) for e in events] == [(300, 0), (300, 27), (300, 33)]


def test_an_endless_stream_without_a_delimiter_is_reported_once() -> None:
    parser = FrameParser()
    events = [event for _ in range(100) for event in parser.feed(b"\1" * 100, 0)]
    assert [type(event) for event in events] == [FrameFault]
    assert parser.faults[FaultCause.OVERSIZE] == 1
    assert parser.buffered_bytes == 0
    assert [type(event) for event in parser.feed(b"\1\0" + WIRE, 0)] == [FrameEvent]


def test_reset_drops_an_unfinished_frame() -> None:
    parser = FrameParser()
    parser.feed(WIRE[:12], 0)
    parser.reset()
    assert parser.buffered_bytes == 0
    assert len(parser.feed(WIRE, 0)) == 1


def _accepted(stream: bytes, sent: set[bytes]) -> tuple[int, int]:
    """Return how many sent samples were accepted, and how many that nobody sent."""
    payloads = [e.payload for e in FrameParser().feed(stream, 0) if isinstance(e, FrameEvent)]
    return sum(p in sent for p in payloads), sum(p not in sent for p in payloads)


def test_no_flipped_bit_lost_byte_or_doubled_byte_gives_a_wrong_sample() -> None:
    # Every place of a frame between two others. 2 faults of each frame are allowed to cost
    # two frames: those that hit the delimiter which a frame shares with its neighbour.
    chance = random.Random(20261121)
    tried = accepted_wrong = lost = 0
    for _ in range(6):
        frames = [_random_sample(chance) for _ in range(3)]
        sent = {frame.encode_payload() for frame in frames}
        stream = b"\0" + b"".join(frame.encode()[1:] for frame in frames)
        begin, end = 26, 26 + 27
        for location in range(begin, end):
            damaged = [
                stream[:location] + bytes([stream[location] ^ (1 << bit)]) + stream[location + 1 :]
                for bit in range(8)
            ]
            damaged.append(stream[:location] + stream[location + 1 :])
            damaged.append(stream[:location] + stream[location : location + 1] + stream[location:])
            damaged.append(stream[:location] + bytes([chance.randrange(256)]) + stream[location:])
            for bad in damaged:
                right, wrong = _accepted(bad, sent)
                tried += 1
                accepted_wrong += wrong
                lost += 3 - right
                assert right >= 1
    assert tried == 6 * 27 * 11
    assert accepted_wrong == 0
    assert lost <= 1.1 * tried


@pytest.mark.parametrize("kind", ["flip", "drop", "insert"])
def test_a_long_noisy_stream_gives_no_wrong_sample(kind: str) -> None:
    # 3000 frames, one byte in 500 damaged: about 160 faults of each kind. A CRC of 16 bits
    # lets one in 65536 pass at worst, and the length must fit as well.
    chance = random.Random(f"gyrorig {kind}")
    frames = [_random_sample(chance) for _ in range(3000)]
    noisy = bytearray()
    faults = 0
    for byte in b"".join(frame.encode() for frame in frames):
        if chance.random() >= 1 / 500:
            noisy.append(byte)
            continue
        faults += 1
        if kind == "flip":
            noisy.append(byte ^ (1 << chance.randrange(8)))
        elif kind == "insert":
            noisy += bytes([byte, chance.randrange(256)])
    right, wrong = _accepted(bytes(noisy), {frame.encode_payload() for frame in frames})
    assert faults > 100
    assert wrong == 0
    assert 3000 - right <= 1.15 * faults


def _random_sample(chance: random.Random) -> Sample:
    def triple(limit: int) -> tuple[int, int, int]:
        return (
            chance.randint(-limit, limit),
            chance.randint(-limit, limit),
            chance.randint(-limit, limit),
        )

    return Sample(
        chance.randrange(256),
        chance.randrange(65536),
        chance.randrange(2**32),
        triple(300),
        triple(20000),
        chance.randint(-40, 80),
    )
