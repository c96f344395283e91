"""The board with a virtual clock and line: timestamps, numbers, losses and answers."""

import statistics
from collections.abc import Iterator
from ctypes import CDLL, c_int16, c_uint8, c_uint16, c_uint32, c_uint64, create_string_buffer
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.board import (
    Ack,
    Batch,
    BoardFrame,
    Edge,
    FrameEvent,
    FrameParser,
    Hello,
    HelloRequest,
    Sample,
    SampleFlag,
    Set,
    Slow,
    TimeReply,
    TimeRequest,
)

BYTE_US = 40  # 250000 baud
RING = 63  # of an Arduino's transmitter
DRDY = int(SampleFlag.STAMPED_AT_DATA_READY)
MOST = 1 << 20


class Board:
    """`virtual_board.c` with a sample every `period_us`."""

    def __init__(self, lib: CDLL, start: int = 0, seed: int = 1, clock_us: int = 100_000) -> None:
        self._lib = lib
        self.now = start
        self._number = 0
        lib.vb_begin(
            c_uint64(start), c_uint32(seed), c_uint32(BYTE_US), c_uint32(RING), c_uint32(clock_us)
        )

    def batch(self, samples: int, accel: bool) -> None:
        self._lib.vb_accel(c_uint8(accel))
        self._lib.vb_batch(c_uint8(samples))

    def take(self, flags: int = DRDY) -> None:
        triple = (c_int16 * 3)(self._number, -self._number, 7)
        self._lib.vb_take(c_uint8(flags), triple, triple, c_int16(215))
        self._number += 1

    def lose(self, count: int) -> None:
        self._lib.vb_lost(c_uint32(count))

    def stick(self) -> None:
        self._lib.vb_stuck(c_uint16(1))

    def edge(self, time: int) -> None:
        self._lib.vb_edge(c_uint32(time & 0xFFFF_FFFF))

    def hear(self, data: bytes) -> None:
        self._lib.vb_receive(data, c_uint8(len(data)))

    def run(self, microseconds: int, step: int = 50) -> None:
        for _ in range(microseconds // step):
            self.now += step
            self._lib.vb_at(c_uint64(self.now))
            self._lib.vb_poll()

    def sent(self) -> list[tuple[BoardFrame, int]]:
        """Return what was sent, with the time of each frame's first byte."""
        data, begun = create_string_buffer(MOST), (c_uint64 * MOST)()
        size = self._lib.vb_out(data, begun, c_uint32(MOST))
        parser, frames = FrameParser(), []
        start = None
        for index, byte in enumerate(data.raw[:size]):
            if byte == 0 and start is None:
                start = begun[index]
            for event in parser.feed(bytes([byte]), 0):
                assert isinstance(event, FrameEvent)
                assert start is not None
                frames.append((event.frame, start))
                start = None
        return frames

    def frames(self) -> list[BoardFrame]:
        return [frame for frame, _ in self.sent()]

    def of(self, kind: type[Sample] | type[Slow] | type[Batch]) -> Iterator[BoardFrame]:
        return (frame for frame in self.frames() if isinstance(frame, kind))


def test_hello_is_sent_first_and_on_request(library: CDLL) -> None:
    board = Board(library)
    board.run(20_000)
    board.hear(HelloRequest().encode())
    board.run(20_000)
    first, second = (f for f in board.frames() if isinstance(f, Hello))
    assert first == second
    assert (first.uid, first.boot, first.reset) == ("00112233", 7, "power")
    assert first.sensors[0].rate_hz == 100.0


def test_clock_frames_have_the_timestamp_of_their_first_byte(library: CDLL) -> None:
    board = Board(library, start=(1 << 32) - 2_000_000)  # the clock wraps on the way
    for _ in range(800):
        board.take()
        board.run(5_000)
    slow = [(frame, index) for frame, index in board.sent() if isinstance(frame, Slow)]
    assert 30 < len(slow) < 50
    for frame, index in slow:
        assert frame.device_time == index
    assert slow[-1][1] > 1 << 32


def test_clock_frames_are_sent_at_random_phase(library: CDLL) -> None:
    # Against the 1 ms frames of USB no phase may be preferred, although a fifth of the time
    # the line is busy with 200 Hz samples, and then a new moment is drawn.
    board = Board(library, seed=12345)
    for _ in range(10_000):
        board.take()
        board.run(5_000, step=25)
    index = [frame.device_time for frame in board.of(Slow) if isinstance(frame, Slow)]
    gaps = [after - before for before, after in pairwise(index)]
    assert 90_000 < statistics.mean(gaps) < 115_000
    assert min(gaps) > 45_000
    phases = [time % 1000 / 1000.0 for time in index]
    thirds = [sum(third <= 3 * phase < third + 1 for phase in phases) for third in range(3)]
    for count in thirds:  # binomial, 4 standard deviations
        assert abs(count - len(index) / 3) < 4 * (len(index) * 2 / 9) ** 0.5


def test_numbers_count_samples_not_frames(library: CDLL) -> None:
    board = Board(library, clock_us=0)
    board.run(20_000)
    for number in range(20):
        board.take(DRDY | (int(SampleFlag.SATURATED) if number == 4 else 0))
        if number == 9:
            board.lose(3)
        board.run(5_000)
    samples = [frame for frame in board.of(Sample) if isinstance(frame, Sample)]
    assert [s.sequence for s in samples] == [*range(10), *range(13, 23)]
    assert [s.sequence for s in samples if s.flags & SampleFlag.OVERRUN] == [13]
    assert [s.sequence for s in samples if s.flags & SampleFlag.SATURATED] == [4]
    assert all(s.flags & SampleFlag.STAMPED_AT_DATA_READY for s in samples)
    assert [s.device_time for s in samples] == [20_000 + 5_000 * k for k in range(20)]


def test_a_full_queue_drops_frames_and_reports_it(library: CDLL) -> None:
    board = Board(library)
    for _ in range(400):  # at once: 4096 bytes hold 178
        board.take()
    board.run(400_000)
    board.take()
    board.run(400_000)
    samples = [frame for frame in board.of(Sample) if isinstance(frame, Sample)]
    assert [s.sequence for s in samples] == [*range(178), 400]
    assert samples[-1].flags & SampleFlag.FRAMES_DROPPED
    slow = [frame for frame in board.of(Slow) if isinstance(frame, Slow)]
    assert slow[-1].frames_dropped == 222
    assert slow[-1].sequence == 401


def test_the_queue_is_full_to_the_byte(library: CDLL) -> None:
    board = Board(library, clock_us=0)
    for _ in range(7):  # 23 bytes each
        board.take()
    for time in range(328):  # 12 each: together one more than 4096
        board.edge(time)
    board.run(400_000)
    frames = board.frames()
    assert [f.sequence for f in frames if isinstance(f, Sample)] == [*range(7)]
    assert [f.device_time for f in frames if isinstance(f, Edge)] == [*range(327)]


def test_two_losses_in_a_row_leave_no_gap_within_a_batch(library: CDLL) -> None:
    board = Board(library, clock_us=0)
    board.batch(4, accel=False)
    for loss in (3, 5):
        board.lose(loss)
        board.take()
    for _ in range(3):
        board.take()
    board.run(50_000)
    batches = [frame for frame in board.of(Batch) if isinstance(frame, Batch)]
    assert [(b.sequence, len(b.gyro)) for b in batches] == [(3, 1), (9, 4)]


@pytest.mark.parametrize(("accel", "size"), [(False, 8), (True, 8), (True, 39)])
def test_batches_have_the_timestamp_of_their_last_sample(
    library: CDLL, accel: bool, size: int
) -> None:
    board = Board(library, clock_us=0)
    board.batch(size, accel)
    for number in range(57):
        board.take()
        if number == 20:
            board.lose(2)
        board.run(1_250)
    board.run(100_000)
    batches = [frame for frame in board.of(Batch) if isinstance(frame, Batch)]
    received = []
    for frame in batches:
        assert (frame.accel is not None) == accel
        assert frame.device_time == 1_250 * frame.gyro[-1][0]
        received += [(frame.sequence + k, row[0]) for k, row in enumerate(frame.gyro)]
    assert received == [(n + (2 if n > 20 else 0), n) for n in range(len(received))]
    assert len(received) >= 40
    assert [b.sequence for b in batches if b.flags & SampleFlag.OVERRUN] == [23]


def test_time_requests_are_answered_with_both_times(library: CDLL) -> None:
    board = Board(library, start=(5 << 32) + 77, clock_us=0)
    board.run(20_000)
    for nonce in range(20):
        board.take()
        board.run(100)  # the sample is on the line
        asked = board.now
        board.hear(TimeRequest(nonce, 1 << 60).encode())
        board.run(10_000)
        reply, index = board.sent()[-1]
        assert isinstance(reply, TimeReply)
        assert (reply.nonce, reply.host_stamp) == (nonce, 1 << 60)
        assert reply.device_receive == asked
        assert reply.device_send == index > asked


def test_a_port_that_is_never_empty_does_not_stop_the_board(library: CDLL) -> None:
    board = Board(library)
    board.stick()
    for _ in range(200):
        board.take()
        board.hear(TimeRequest(1, 1).encode())
        board.run(5_000)
    board.run(100_000)
    kinds = {type(frame) for frame in board.frames()}
    assert kinds == {Hello, Sample}  # no wrong timestamp
    assert len(list(board.of(Sample))) == 200


def test_set_is_executed_and_acknowledged(library: CDLL) -> None:
    board = Board(library, clock_us=0)
    board.run(20_000)
    before = next(f for f in board.frames() if isinstance(f, Hello))
    board.hear(Set(rate_hz=200.0, full_scale_dps=500.0, batch=4, accel=False).encode())
    board.run(20_000)
    for _ in range(4):
        board.take()
    board.hear(HelloRequest().encode())
    board.run(20_000)
    ack = next(f for f in board.frames() if isinstance(f, Ack))
    hello = [f for f in board.frames() if isinstance(f, Hello)][-1]
    assert (ack.rate_hz, ack.full_scale_dps, ack.batch, ack.accel) == (200.0, 500.0, 4, False)
    assert ack.config == hello.config != before.config
    (batch,) = (f for f in board.frames() if isinstance(f, Batch))
    assert batch.flags & SampleFlag.CONFIGURATION_CHANGED
    assert batch.accel is None


def test_edges_keep_the_interrupts_time(library: CDLL) -> None:
    board = Board(library, start=(1 << 32) - 100, clock_us=0)
    before = board.now + 60
    board.run(200)  # over the wrap
    board.edge(before)
    board.run(30_000)
    (edge,) = (f for f in board.frames() if isinstance(f, Edge))
    assert (edge.device_time, edge.input, edge.rising) == (before, 3, True)


JSON = st.text(alphabet='{}":,.0123456789odrbwfsatcheluru ', max_size=60).map(str.encode)


@settings(max_examples=100, deadline=None)
@given(noise=st.lists(st.binary(max_size=120), max_size=6), cuts=st.lists(st.integers(1, 9)))
def test_noise_from_the_host_has_no_effect(
    library: CDLL, noise: list[bytes], cuts: list[int]
) -> None:
    board = Board(library, clock_us=0)
    stream = b"\0".join([*noise, b"", TimeRequest(9, 9).encode()])
    for cut in [*cuts, 255, 255, 255, 255]:
        board.hear(stream[:cut])
        stream = stream[cut:]
    board.run(40_000)
    assert any(isinstance(f, TimeReply) and f.nonce == 9 for f in board.frames())


@settings(max_examples=200, deadline=None)
@given(text=JSON | st.binary(max_size=60))
def test_c_accepts_only_valid_set_frames(library: CDLL, text: bytes) -> None:
    expected = create_string_buffer(32)
    taken = library.gyb_read_set(text, c_uint8(len(text)), expected)
    if taken:  # the other way does not hold: C refuses exponents and keys it does not know
        assert text.strip(b" \n").startswith(b"{")
        assert text.endswith(b"}")


@settings(max_examples=100, deadline=None)
@given(
    rate=st.none() | st.sampled_from([12.5, 100.0, 800.0]),
    scale=st.none() | st.sampled_from([250.0, 2000.0]),
    batch=st.none() | st.integers(1, 39),
    accel=st.none() | st.booleans(),
)
def test_c_reads_every_set_frame_of_python(
    library: CDLL, rate: float | None, scale: float | None, batch: int | None, accel: bool | None
) -> None:
    payload = Set(rate, None, scale, batch, accel).encode_payload()[1:]
    expected = create_string_buffer(16)
    assert library.gyb_read_set(payload, c_uint8(len(payload)), expected) == 1
    assert c_uint32.from_buffer(expected, 0).value == round((rate or 0.0) * 10)
    assert c_uint32.from_buffer(expected, 8).value == (scale or 0.0)
    assert c_uint8.from_buffer(expected, 12).value == (batch or 0)
    output = c_uint16.from_buffer(expected, 12).value >> 8
    assert output == (0xFF if accel is None else accel)
