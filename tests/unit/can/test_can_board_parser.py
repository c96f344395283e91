"""Parser of our own boards' frames: samples have complete timestamps and numbers after any loss."""

from dataclasses import dataclass, field

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.board.board_events import FaultCause, FrameEvent
from gyrorig_protocol.board.board_frames import Sample, SampleFlag, Slow
from gyrorig_protocol.board.json_frames import Hello, Sensor
from gyrorig_protocol.can import (
    CanBoardEvent,
    CanBoardParser,
    CanFrame,
    LatchEvent,
    accel_frame,
    gyro_frame,
    health_frame,
    hello_frames,
    latch_frame,
    status_frame,
)

NODE = 5
PERIOD_US = 1190.0  # 840 Hz, where 800 is named


@dataclass
class Board:
    """A board's frames as they should be: time in us, host time the same plus a constant."""

    first_number: int = 65500
    start_us: int = 2**32 - 900_000  # wraps on the way
    boot: int = 7
    accel: bool = True
    truth: dict[bytes, tuple[int, int]] = field(default_factory=dict)  # by gyro data

    def frames(self, count: int, seed: int = 0) -> list[tuple[int, str, CanFrame]]:
        """Return frames with host time, kind and frame; STATUS after every 84th sample."""
        made: list[tuple[int, str, CanFrame]] = []
        for index in range(count):
            jitter = (index * 2654435761 + seed) % 7
            time = self.start_us + round(index * PERIOD_US) + jitter
            host_ns = (time - self.start_us) * 1000 + 5_000_000
            if self.accel:
                made.append((host_ns, "accel", accel_frame(NODE, (index % 999, 2, 3), time)))
            # Two bytes identify the sample.
            gyro = gyro_frame(NODE, (index & 0x7FFF, index >> 15, -1), time)
            number = (self.first_number + index) & 0xFFFF
            self.truth[gyro.data] = number, time & ~3 & 0xFFFF_FFFF
            made.append((host_ns, "gyro", gyro))
            if index % 84 == 0:
                made.append(
                    (
                        host_ns,
                        "status",
                        status_frame(NODE, time, self.first_number + index, self.boot),
                    )
                )
        return made


def feed(
    parser: CanBoardParser, frames: list[tuple[int, str, CanFrame]], offset_ns: int = 0
) -> list[CanBoardEvent]:
    events: list[CanBoardEvent] = []
    for host_ns, _, frame in frames:
        stamped = CanFrame(frame.identifier, frame.data, frame.flags, host_ns + offset_ns)
        events += parser.feed(stamped)
    return events


def samples(events: list[CanBoardEvent]) -> list[tuple[bytes, Sample]]:
    return [
        (event.payload, event.frame)
        for event in events
        if isinstance(event, FrameEvent) and isinstance(event.frame, Sample)
    ]


def check(board: Board, samples: list[tuple[bytes, Sample]]) -> None:
    for data, sample in samples:
        assert (sample.sequence, sample.device_time) == board.truth[data]


def test_nothing_lost_nothing_changed() -> None:
    board = Board()
    actual = samples(feed(CanBoardParser(NODE), board.frames(2000)))
    check(board, actual)
    assert len(actual) == 2000
    numbers = [sample.sequence for _, sample in actual]
    assert numbers == [(65500 + index) & 0xFFFF for index in range(2000)]
    assert all(sample.accel is not None for _, sample in actual)


@settings(max_examples=15, deadline=None)
@given(
    lost=st.lists(st.tuples(st.integers(0, 700), st.integers(1, 100)), max_size=4),
    begin=st.integers(0, 90),
    swaps=st.lists(st.integers(200, 700), max_size=4),
    seed=st.integers(0, 1000),
    accel=st.booleans(),
)
def test_received_samples_have_right_numbers_and_times_after_any_loss(
    lost: list[tuple[int, int]], begin: int, swaps: list[int], seed: int, accel: bool
) -> None:
    board = Board(accel=accel)
    frames = board.frames(800, seed)
    gone = {index for first, length in lost for index in range(first, first + length)}
    step = 2 if accel else 1
    counts = {"gyro": -1}
    remaining: list[tuple[int, str, CanFrame]] = []
    for entry in frames:
        counts["gyro"] += entry[1] == "gyro"
        index = counts["gyro"]
        if index < begin or (index in gone and entry[1] != "status"):
            continue
        remaining.append(entry)
    for index in swaps:
        where = index * step
        if where + 1 < len(remaining) and {remaining[where][1], remaining[where + 1][1]} == {
            "gyro"
        }:
            remaining[where], remaining[where + 1] = remaining[where + 1], remaining[where]
    parser = CanBoardParser(NODE)
    actual = samples(feed(parser, remaining))
    first = [sample for _, sample in actual]
    # Until two STATUS have given the period (0.1 s), a lost sample cannot be seen in the numbers.
    settled = [pair for pair in actual if first and board.truth[pair[0]][0] != first[0].sequence]
    previous: set[bytes] = set()
    statuses = 0
    for _, kind, frame in remaining:
        statuses += kind == "status"
        if kind == "gyro" and statuses >= 2:
            previous.add(frame.data)
    check(board, [pair for pair in settled if pair[0] in previous])
    delivered = sum(kind == "gyro" for _, kind, _ in remaining)
    assert len(actual) + parser.faults[FaultCause.CONTENT] + parser.waiting_count == delivered
    assert parser.faults[FaultCause.CONTENT] == 0


@settings(max_examples=8, deadline=None)
@given(gap_s=st.floats(0.2, 80.0), keep=st.integers(150, 600))
def test_after_any_gap_samples_wait_for_a_status(gap_s: float, keep: int) -> None:
    board = Board()
    frames = board.frames(keep)
    later = Board(
        first_number=board.first_number + keep + round(gap_s * 1e6 / PERIOD_US),
        start_us=board.start_us + round((keep + round(gap_s * 1e6 / PERIOD_US)) * PERIOD_US),
    )
    parser = CanBoardParser(NODE)
    check(board, samples(feed(parser, frames)))
    after = later.frames(600)
    actual = samples(feed(parser, after, later.start_us * 1000 - board.start_us * 1000))
    check(later, actual)
    assert len(actual) == 600


def test_a_stalled_host_loses_nothing() -> None:
    board = Board()
    frames = board.frames(2000)
    # 200 ms of frames come in one burst, stamped when the host wakes up
    stalled = [
        (max(host_ns, 900_000_000) if 700_000_000 < host_ns < 900_000_000 else host_ns, kind, f)
        for host_ns, kind, f in frames
    ]
    parser = CanBoardParser(NODE)
    actual = samples(feed(parser, stalled))
    check(board, actual)
    assert len(actual) == 2000


def test_a_reset_starts_again_and_counts_waiting_samples() -> None:
    board, after = Board(), Board(first_number=0, start_us=0, boot=8)
    parser = CanBoardParser(NODE)
    feed(parser, board.frames(500))
    restart = after.frames(300)
    # STATUS goes first after a start
    status = next(entry for entry in restart if entry[1] == "status")
    restart.remove(status)
    events = feed(parser, [status, *restart], 1_500_000_000)
    check(after, samples(events))
    assert len(samples(events)) == 300
    boots = [
        e.frame.boot for e in events if isinstance(e, FrameEvent) and isinstance(e.frame, Slow)
    ]
    assert set(boots) == {8}


def test_a_duplicate_keeps_its_number() -> None:
    board = Board(accel=False)
    frames = board.frames(400)
    doubled = [*frames[:300], frames[299], *frames[300:]]
    actual = samples(feed(CanBoardParser(NODE), doubled))
    check(board, actual)
    assert len(actual) == 401


def test_temperature_health_saturation_and_latch() -> None:
    board = Board()
    parser = CanBoardParser(NODE)
    feed(parser, board.frames(100))
    parser.full_scale_counts = 28571  # 250 dps of 8.75 mdps
    parser.feed(health_frame(NODE, -3, 251, (255, 1, 2, 3)))
    parser.feed(health_frame(NODE, -3, 251, (1, 1, 2, 3)))
    events = feed(parser, board.frames(101)[-2:])
    clipped = gyro_frame(NODE, (0, -28571, 0), 2**32)
    events += parser.feed(CanFrame(clipped.identifier, clipped.data, 0, 130_000_000))
    last = samples(events)[-1][1]
    assert last.temperature == 251
    assert last.flags & SampleFlag.SATURATED
    slow = parser.feed(status_frame(NODE, 0, 0, 7))[0]
    assert isinstance(slow, FrameEvent)
    assert isinstance(slow.frame, Slow)
    assert slow.frame.sensor_overruns == 257  # the low bits went on over 255
    assert slow.frame.temperature == -3
    assert parser.feed(latch_frame(NODE, 300, 0x107, 2**40 + 5)) == [
        LatchEvent(300 & 0xFF, 7, 2**40 + 5, 0)
    ]


def test_a_hello_in_segments_equals_one_on_a_serial_line() -> None:
    hello = Hello(1, "1", "GY80", "ab12", 3, (Sensor(211, 250, 0.00875, 100, 25),))
    parser = CanBoardParser(NODE)
    events = [e for f in hello_frames(NODE, hello.encode_payload()[1:]) for e in parser.feed(f)]
    assert [e.frame for e in events if isinstance(e, FrameEvent)] == [hello]
    broken = [e for f in hello_frames(NODE, b'{"proto":0}') for e in parser.feed(f)]
    assert [type(e).__name__ for e in broken] == ["FrameFault"]


def test_wrong_lengths_are_counted() -> None:
    parser = CanBoardParser(NODE)
    for kind in range(2, 8):
        parser.feed(CanFrame(kind << 7 | NODE, b"\1"))
    parser.feed(CanFrame(1 << 7 | NODE, b""))
    assert parser.faults[FaultCause.LENGTH] == 6
    assert parser.faults[FaultCause.UNKNOWN_TYPE] == 1
    assert parser.wants(4 << 7 | NODE)
    assert not parser.wants(4 << 7 | NODE | 1 << 31)
    assert not parser.wants(1 << 7)


@pytest.mark.parametrize("gap_s", [1.0, 81.0, 83.0, 100.0, 164.5])
def test_samples_after_a_silence_have_different_numbers(gap_s: float) -> None:
    """The 16-bit number wraps after 82 s at 800 Hz, the time in a STATUS after 72 minutes."""
    parser = CanBoardParser(NODE)
    period_us = 1250
    samples: list[Sample] = []

    def send(first: int, count: int) -> None:
        for number in range(first, first + count):
            at_us = number * period_us
            frames = [gyro_frame(NODE, (1, 2, 3), at_us)]
            if number % 80 == 0:
                frames.insert(0, status_frame(NODE, at_us, number, 7))
            for frame in frames:
                timed = msgspec.structs.replace(frame, timestamp_ns=at_us * 1000 + 5_000)
                for event in parser.feed(timed):
                    if isinstance(event, FrameEvent) and isinstance(event.frame, Sample):
                        samples.append(event.frame)

    send(0, 400)
    samples.clear()
    first = 30 + int(gap_s * 1e6 / period_us)
    send(first, 400)
    expected = [(first + index) & 0xFFFF for index in range(400)]
    assert [sample.sequence for sample in samples] == expected


def test_a_reset_forgets_the_temperature_and_the_counters_of_the_board() -> None:
    parser = CanBoardParser(NODE)
    parser.full_scale_counts = 1000
    parser.feed(health_frame(NODE, 600, None, (7, 7, 7, 7)))
    parser.reset()
    frames = [status_frame(NODE, 1000, 1, 55), gyro_frame(NODE, (1500, 2, 3), 1400)]
    events = [event for frame in frames for event in parser.feed(frame)]
    slow, sample = (event.frame for event in events if isinstance(event, FrameEvent))
    assert isinstance(slow, Slow)
    assert slow.temperature == slow.sensor_overruns == slow.saturations == 0
    assert isinstance(sample, Sample)
    assert sample.temperature is None
    assert not sample.flags & SampleFlag.SATURATED
