"""A board's CAN frames: our own, and any IMU's by a DBC file; no I/O.

What to use when:

- `BoardFrameParser` for our own boards, `SignalParser` with a bound `SignalMap` for any
  other. Both give `FrameEvent`s with `Sample`s, as the parsers of `board` do.
- `CanFrame`, `pack_frames` and `unpack_frames` for frames and how they travel as bytes.
- `sync_frame`, `hello_request_frame` and the other `*_frame` functions to send.
- `bus_reports` for what the controller says of the bus; `board_dbc` for other people's tools.
"""

from gyrorig_protocol.can.board import (
    MAX_NODE,
    SYNC_IDENTIFIER,
    FrameType,
    accel_frame,
    gyro_frame,
    health_frame,
    hello_frames,
    hello_request_frame,
    latch_frame,
    status_frame,
    sync_frame,
)
from gyrorig_protocol.can.board_dbc import board_dbc
from gyrorig_protocol.can.board_parser import BoardFrameParser, CanBoardEvent, LatchEvent
from gyrorig_protocol.can.bus_errors import BusReport, bus_reports, error_frame
from gyrorig_protocol.can.dbc import parse_dbc
from gyrorig_protocol.can.frame import CanFrame, FrameFlag, pack_frames, unpack_frames
from gyrorig_protocol.can.signal_map import BoundMap, SignalMap, bind
from gyrorig_protocol.can.signal_parser import SignalParser

__all__ = [
    "MAX_NODE",
    "SYNC_IDENTIFIER",
    "BoardFrameParser",
    "BoundMap",
    "BusReport",
    "CanBoardEvent",
    "CanFrame",
    "FrameFlag",
    "FrameType",
    "LatchEvent",
    "SignalMap",
    "SignalParser",
    "accel_frame",
    "bind",
    "board_dbc",
    "bus_reports",
    "error_frame",
    "gyro_frame",
    "health_frame",
    "hello_frames",
    "hello_request_frame",
    "latch_frame",
    "pack_frames",
    "parse_dbc",
    "status_frame",
    "sync_frame",
    "unpack_frames",
]
