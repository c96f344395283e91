"""Records, segments, error frames; and that no bytes make anything raise."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.board.board_events import FaultCause
from gyrorig_protocol.can import (
    BusReport,
    CanBoardParser,
    CanFrame,
    FrameFlag,
    bus_reports,
    error_frame,
    hello_frames,
    pack_frames,
    sync_frame,
    unpack_frames,
)
from gyrorig_protocol.can.can_frame import RECORD
from gyrorig_protocol.can.hello_segments import HelloAssembler
from gyrorig_protocol.errors import UsageError

FRAMES = st.builds(
    CanFrame,
    st.integers(0, 2**29 - 1),
    st.binary(max_size=8),
    st.integers(0, 15),
    st.integers(1, 2**62),
)


@settings(deadline=None)
@given(frames=st.lists(FRAMES, max_size=20), cut=st.integers(0, RECORD.size - 1))
def test_records_round_trip_and_an_incomplete_one_is_ignored(
    frames: list[CanFrame], cut: int
) -> None:
    packed = pack_frames(frames)
    assert len(packed) == 24 * len(frames)
    assert unpack_frames(packed, 7) == frames
    assert unpack_frames(packed + bytes(cut), 7) == frames


def test_a_frame_without_timestamp_has_that_of_the_read_call() -> None:
    assert unpack_frames(pack_frames([sync_frame(5)]), 99)[0].timestamp_ns == 99


@pytest.mark.parametrize(
    "frame", [CanFrame(1, bytes(9)), CanFrame(-1, b""), CanFrame(2**32, b""), CanFrame(1, b"", 256)]
)
def test_invalid_frames_cannot_be_packed(frame: CanFrame) -> None:
    with pytest.raises(UsageError):
        pack_frames([frame])


@settings(deadline=None)
@given(text=st.binary(min_size=1, max_size=446))
def test_a_hello_in_segments_round_trips(text: bytes) -> None:
    collector = HelloAssembler()
    results = [collector.feed(frame.data) for frame in hello_frames(3, text)]
    assert results[:-1] == [None] * (len(results) - 1)
    assert results[-1] == text


@settings(deadline=None)
@given(text=st.binary(min_size=20, max_size=200), lost=st.integers(0, 2))
def test_a_lost_segment_is_a_fault_and_the_next_hello_is_complete(text: bytes, lost: int) -> None:
    collector = HelloAssembler()
    frames = hello_frames(3, text)
    results = [collector.feed(f.data) for index, f in enumerate(frames) if index != lost]
    assert text not in results
    assert lost == 0 or FaultCause.CONTENT in results
    assert [collector.feed(frame.data) for frame in frames][-1] == text


def test_a_changed_segment_fails_the_checksum() -> None:
    collector = HelloAssembler()
    frames = hello_frames(3, b'{"proto":1}' * 4)
    results = [collector.feed(f.data[:3] + b"!" + f.data[4:]) for f in frames]
    assert results[-1] is FaultCause.CRC


@settings(deadline=None)
@given(pieces=st.lists(st.binary(max_size=8), max_size=300))
def test_segments_never_raise_and_memory_is_bounded(pieces: list[bytes]) -> None:
    collector = HelloAssembler()
    for piece in pieces:
        collector.feed(piece)
        assert len(collector._parts) <= 64


@settings(deadline=None)
@given(
    frames=st.lists(
        st.builds(
            CanFrame,
            st.integers(0, 9).map(lambda kind: kind << 7 | 5),
            st.binary(max_size=8),
            st.sampled_from([0, 0, 0, 0, 1, 2, 4, 8]),
            st.integers(0, 2**40),
        ),
        max_size=300,
    )
)
def test_the_board_parser_never_raises(frames: list[CanFrame]) -> None:
    parser = CanBoardParser(5)
    for frame in frames:
        parser.feed(frame)
        assert parser.waiting_count <= 256


@settings(deadline=None)
@given(identifier=st.integers(0, 2**29 - 1), data=st.binary(max_size=8))
def test_every_error_frame_reports_something(identifier: int, data: bytes) -> None:
    assert bus_reports(CanFrame(identifier, data, int(FrameFlag.ERROR)))


@pytest.mark.parametrize("report", list(BusReport))
def test_simulated_reports_round_trip(report: BusReport) -> None:
    assert bus_reports(error_frame(report)) == [report]


def test_bus_off_and_passive_have_the_codes_of_linux() -> None:
    # <linux/can/error.h>: CAN_ERR_BUSOFF 0x40; CAN_ERR_CRTL 4, data[1] TX_PASSIVE 0x20
    assert bus_reports(CanFrame(0x40, bytes(8), 4)) == [BusReport.BUS_OFF]
    passive = struct.pack("8B", 0, 0x20, 0, 0, 0, 0, 0, 0)
    assert bus_reports(CanFrame(4, passive, 4)) == [BusReport.ERROR_PASSIVE]
