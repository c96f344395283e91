"""Any IMU by a preset or a DBC file: counts, units, losses."""

import math
import struct

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyrorig_protocol.board.board_events import BoardEvent, FaultCause, FrameEvent
from gyrorig_protocol.board.board_frames import Sample
from gyrorig_protocol.can import CanFrame, CanSignalParser, SignalMap, resolve_signals
from gyrorig_protocol.errors import UsageError

DEG = math.pi / 180.0
DBC = """\
BO_ 100 Rates: 8 IMU
 SG_ X : 0|16@1- (0.0625,0) [0|0] "deg/s" A
 SG_ Y : 16|16@1- (0.0625,0) [0|0] "deg/s" A
 SG_ Z : 32|16@1- (0.0625,0) [0|0] "deg/s" A
 SG_ Count : 48|4@1+ (1,0) [0|0] "" A
BO_ 101 More: 8 IMU
 SG_ Clock : 0|32@1+ (0.1,0) [0|0] "ms" A
 SG_ Temp : 32|8@1- (0.5,20) [0|0] "degC" A
 SG_ AX : 40|8@1- (0.03,0.01) [0|0] "g" A
"""


def rate_map(**extra: object) -> SignalMap:
    plain = {"dbc": DBC, "gyro": ["Rates.X", "Rates.Y", "Rates.Z"], **extra}
    return msgspec.convert(plain, SignalMap)


def samples(events: list[BoardEvent]) -> list[Sample]:
    return [e.frame for e in events if isinstance(e, FrameEvent) and isinstance(e.frame, Sample)]


def test_j1939_by_group_and_sender() -> None:
    bound = resolve_signals(SignalMap(preset="j1939", source_address=0x80), "A")
    assert bound.gyro_scale_rad_s == pytest.approx(DEG / 128)
    assert bound.accel_scale_m_s2 == pytest.approx(0.01)
    parser = CanSignalParser(bound)
    rates = struct.pack("<4H", 32000, 32000 + 128, 32000 - 1280, 0xFFFF)
    accels = struct.pack("<4H", 32000, 32000, 32000 + 981, 0xFFFF)
    events = parser.feed(CanFrame(0x08F02D80, accels, 1))
    events += parser.feed(CanFrame(0x0CF02A80, rates, 1))  # priority 3
    events += parser.feed(CanFrame(0x18F02A80, rates, 1))  # any priority
    assert not parser.wants(0x0CF02A81 | 1 << 31)  # another sender
    assert not parser.wants(0x2A80)
    assert [(s.gyro, s.accel, s.sequence) for s in samples(events)] == [
        ((0, 128, -1280), (0, 0, 981), 0),
        ((0, 128, -1280), None, 1),
    ]


def test_invalid_j1939_codes_are_faults() -> None:
    parser = CanSignalParser(resolve_signals(SignalMap(preset="j1939", source_address=1), "A"))
    not_available = struct.pack("<4H", 32000, 0xFFFF, 32000, 0)
    highest = struct.pack("<4H", 32000, 0xFAFF, 32000, 0)
    assert samples(parser.feed(CanFrame(0x0CF02A01, not_available, 1))) == []
    assert parser.faults[FaultCause.CONTENT] == 1
    assert samples(parser.feed(CanFrame(0x0CF02A01, highest, 1)))[0].gyro == (0, 32255, 0)


def test_mm510_rates_of_two_messages_are_one_sample() -> None:
    bound = resolve_signals(SignalMap(preset="mm5.10"), "A")
    assert bound.gyro_scale_rad_s == pytest.approx(0.005 * DEG)
    parser = CanSignalParser(bound)
    yaw = CanFrame(0x70, struct.pack("<4H", 32768 + 200, 0, 32768, 0))
    roll = CanFrame(0x80, struct.pack("<4H", 32768 - 100, 0, 32768, 0))
    up = CanFrame(0x576, struct.pack("<4H", 0, 0, 32768 + 7845, 0))
    order = [yaw, up, roll, yaw, roll, yaw, yaw, up, roll]  # one roll lost
    actual = samples([event for frame in order for event in parser.feed(frame)])
    assert [s.gyro for s in actual] == [(-100, 0, 200)] * 3
    assert [s.sequence for s in actual] == [0, 1, 3]  # the loss shows as a gap
    assert actual[0].accel is not None
    # 4.1768/0.000127465 is not an integer, therefore counts are 1e-6 m/s^2
    assert actual[0].accel[2] == pytest.approx(9.80665e6, rel=1e-3)
    assert actual[1].accel is None


def test_racelogic_floats_are_counts_of_a_fine_scale() -> None:
    bound = resolve_signals(SignalMap(preset="racelogic"), "A")
    parser = CanSignalParser(bound)
    frames = [
        CanFrame(0x600, struct.pack(">ff", -1.5, 0.25)),
        CanFrame(0x601, struct.pack(">ff", -0.5, 31.25)),
        CanFrame(0x603, struct.pack(">ff", 1.0, 0.0)),
        CanFrame(0x602, struct.pack(">ff", 2.0, 3.0)),
    ]
    (sample,) = samples([event for frame in frames for event in parser.feed(frame)])
    assert [c * bound.gyro_scale_rad_s / DEG for c in sample.gyro] == pytest.approx(
        [3.0, 2.0, -1.5], abs=1e-5
    )
    assert sample.accel == (2451662, -4903325, 9806650)
    assert sample.temperature == 3125
    nan = CanFrame(0x602, struct.pack(">ff", math.nan, math.inf))
    assert samples([e for f in (frames[0], nan) for e in parser.feed(f)]) == []
    assert parser.faults[FaultCause.CONTENT] == 1


def test_a_dbc_file_with_counter_clock_and_temperature() -> None:
    chosen = rate_map(
        accel=["More.AX", None, None], counter="Rates.Count", time="More.Clock",
        temperature="More.Temp",
    )  # fmt: skip
    bound = resolve_signals(chosen, "A")
    assert bound.tick_hz == pytest.approx(1e4)
    parser = CanSignalParser(bound)
    actual = []
    for count, clock in ((14, 100), (15, 200), (1, 400)):
        parser.feed(CanFrame(101, struct.pack("<IbbH", clock, 10, 33, 0)))
        actual += samples(parser.feed(CanFrame(100, struct.pack("<3hH", 1, -2, 3, count))))
    assert [s.gyro for s in actual] == [(1, -2, 3)] * 3
    assert [s.sequence for s in actual] == [14, 15, 17]  # one was lost, over the wrap of 4 bits
    assert [s.device_time for s in actual] == [100, 200, 400]
    assert actual[0].temperature == 2500
    assert actual[0].accel is not None
    assert actual[0].accel[0] == round((33 * 0.03 + 0.01) * 9.80665e6)


def test_short_frames_are_counted() -> None:
    parser = CanSignalParser(resolve_signals(rate_map(), "A"))
    parser.feed(CanFrame(100, bytes(5)))
    assert parser.faults[FaultCause.LENGTH] == 1


@settings(deadline=None)
@given(
    frames=st.lists(
        st.builds(
            CanFrame,
            st.sampled_from([100, 101, 102, 0x0CF02A01]),
            st.binary(max_size=8),
            st.sampled_from([0, 0, 1, 2, 4, 8]),
        ),
        max_size=100,
    ),
    preset=st.booleans(),
)
def test_the_signal_parser_never_raises(frames: list[CanFrame], preset: bool) -> None:
    chosen = SignalMap(preset="j1939", source_address=1) if preset else rate_map()
    parser = CanSignalParser(resolve_signals(chosen, "A"))
    for frame in frames:
        parser.feed(frame)


@pytest.mark.parametrize(
    ("chosen", "problem"),
    [
        (SignalMap(), "neither a preset nor a DBC"),
        (SignalMap(preset="j1939"), "source_address"),
        (SignalMap(preset="mm5.10", dbc=DBC), "both a preset and its own signals"),
        (rate_map(gyro=[None, None, None]), "names no gyro signal"),
        (rate_map(gyro=["Rates.Q", None, None]), "no signal Q"),
        (rate_map(gyro=["Q.X", None, None]), "has no message Q"),
        (rate_map(gyro=["Rates.Count", None, None]), "gyro_unit"),
        (rate_map(time="Rates.Count"), "tick_hz"),
        (rate_map(counter="Rates.X"), "unsigned"),
        (rate_map(dbc="imu.dbc"), "but not its text"),
    ],
)
def test_the_error_names_the_fault_of_a_map(chosen: SignalMap, problem: str) -> None:
    with pytest.raises(UsageError, match=problem):
        resolve_signals(chosen, "A")


APART = """\
BO_ 100 First: 8 IMU
 SG_ X : 0|16@1- (0.0625,0) [0|0] "deg/s" A
BO_ 101 Second: 8 IMU
 SG_ Y : 0|16@1- (0.0625,0) [0|0] "deg/s" A
 SG_ Z : 16|16@1- (0.0625,0) [0|0] "deg/s" A
BO_ 102 Third: 8 IMU
 SG_ Count : 0|8@1+ (1,0) [0|0] "" A
"""


@pytest.mark.parametrize(
    ("lost", "numbers"),
    [
        (101, [5, 6, 8, 9, 10, 11]),  # a rate: the sample is missing
        (102, [5, 6, 7, 8, 9, 10, 11]),  # the counter alone: no sample is missing
    ],
)
def test_a_lost_message_does_not_shift_the_numbers(lost: int, numbers: list[int]) -> None:
    plain = {"dbc": APART, "gyro": ["First.X", "Second.Y", "Second.Z"], "counter": "Third.Count"}
    parser = CanSignalParser(resolve_signals(msgspec.convert(plain, SignalMap), "A"))
    events: list[BoardEvent] = []
    for count in range(5, 12):
        for identifier in (102, 100, 101):
            if count == 7 and identifier == lost:
                continue
            data = bytes([count]) if identifier == 102 else b""
            events += parser.feed(CanFrame(identifier, data.ljust(8, b"\0")))
    assert [sample.sequence for sample in samples(events)] == numbers


def test_a_sample_without_its_time_is_a_gap() -> None:
    """Its time would be recorded as 0, and look like a step of the clock."""
    parser = CanSignalParser(resolve_signals(rate_map(time="More.Clock"), "A"))
    events: list[BoardEvent] = []
    for number in range(6):
        if number != 3:
            events += parser.feed(CanFrame(101, struct.pack("<IbbH", 100 * number, 0, 0, 0)))
        events += parser.feed(CanFrame(100, struct.pack("<3hH", 1, 2, 3, number)))
    complete = samples(events)
    assert [sample.device_time for sample in complete] == [0, 100, 200, 400, 500]
    assert [sample.sequence for sample in complete] == [0, 1, 2, 4, 5]
    assert parser.faults[FaultCause.CONTENT] == 1
