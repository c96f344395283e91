"""A CAN bus: our boards' frames, any IMU's signals, and DBC files."""

import functools
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz.target import Target, check_single_line, require

from gyrorig_protocol.board import FaultCause
from gyrorig_protocol.can import (
    CanBoardParser,
    CanFrame,
    CanSignalParser,
    ResolvedSignalMap,
    SignalMap,
    accel_frame,
    bus_reports,
    gyro_frame,
    hello_frames,
    latch_frame,
    parse_dbc,
    resolve_signals,
    status_frame,
    unpack_frames,
)
from gyrorig_protocol.can.board_can_frames import NODE_BITS
from gyrorig_protocol.can.can_board_parser import MAX_WAITING_SAMPLES
from gyrorig_protocol.can.can_frame import RECORD
from gyrorig_protocol.errors import UsageError

NODE = 1
FRAME_BYTES = 10  # of an input: kind, length, eight bytes of data
DBC = Path(__file__).resolve().parents[2] / "config" / "can" / "gyrorig-boards.dbc"


def _frames(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Cut an input into a kind, a step of time in 0.1 ms, and up to eight bytes."""
    for index in range(0, len(data) - FRAME_BYTES + 1, FRAME_BYTES):
        kind, size = data[index], data[index + 1]
        yield kind, size >> 4, data[index + 2 : index + 2 + min(size & 15, 8)]


def can_board(data: bytes) -> None:
    """Events are counted, what waits is bounded, and times only go on."""
    parser, now_ns, events = CanBoardParser(NODE), 1, 0
    for kind, step, content in _frames(data):
        now_ns += step * 100_000
        frame = CanFrame((kind % 10) << NODE_BITS | NODE, content, kind >> 6, now_ns)
        events += len(parser.feed(frame))
        bus_reports(frame)
    require(parser.waiting_count <= MAX_WAITING_SAMPLES, "more waits than the limit")
    require(sum(parser.faults.values()) <= events, "a fault that is no event")
    parser.reset()
    require(parser.waiting_count == 0, "something waits after a reset")


def can_records(data: bytes) -> None:
    """Any bytes of the acquisition process are split into frames."""
    frames = unpack_frames(data, 1)
    require(len(frames) == len(data) // RECORD.size, "a record is no frame")
    require(all(len(frame.data) <= 8 for frame in frames), "a frame of more than 8 bytes")


@functools.cache
def _maps() -> tuple[ResolvedSignalMap, ...]:
    chosen = (
        SignalMap(preset="j1939", source_address=128),
        SignalMap(preset="mm5.10"),
        SignalMap(preset="racelogic"),
    )
    return tuple(resolve_signals(item, "x") for item in chosen)


def can_signals(data: bytes) -> None:
    """Signals of any frame are counts within their width, or faults."""
    for bound in _maps():
        parser, keys = CanSignalParser(bound), sorted(bound.needed_bytes)
        for kind, _, content in _frames(data):
            key = keys[kind % len(keys)]
            frame = CanFrame(key & 0x1FFF_FFFF, content, key >> 31, 1)
            for event in parser.feed(frame):
                require(not isinstance(getattr(event, "cause", None), str), "a cause of no kind")
        require(set(parser.faults) == set(FaultCause), "a fault of no kind")


def dbc(data: bytes) -> None:
    """A DBC file is rejected with one line, or each of its signals can be read."""
    try:
        messages = parse_dbc(data.decode("utf-8", errors="replace"), "x")
    except UsageError as fault:
        check_single_line(fault)
        return
    for message in messages.values():
        for signal in message.signals.values():
            signal.raw_value(bytes(range(64)))


def _seeds() -> list[bytes]:
    frames = [
        status_frame(NODE, 1000, 3, 7),
        gyro_frame(NODE, (1, -2, 3), 1000),
        accel_frame(NODE, (4, 5, 6), 1000),
        latch_frame(NODE, 9, 7, 123456),
        *hello_frames(NODE, b'{"proto":1,"fw":"1","board":"b","uid":"u","boot":1,"sensors":[]}'),
    ]
    packed = [_pack(frame) for frame in frames]
    return [b"".join(packed), *packed]


def _pack(frame: CanFrame) -> bytes:
    kind, size = frame.identifier >> NODE_BITS, 0x50 | len(frame.data)
    return bytes([kind, size]) + frame.data.ljust(8, b"\0")


TARGETS = (
    Target("can_board", can_board, _seeds, 1000),
    Target("can_records", can_records, lambda: [bytes(range(24)) * 2], 480),
    Target("can_signals", can_signals, _seeds, 1000),
    Target("dbc", dbc, lambda: [DBC.read_bytes()[:4000]], 4096),
)
