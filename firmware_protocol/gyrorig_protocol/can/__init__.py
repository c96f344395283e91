"""CAN protocols of boards: our own frames, and other IMUs by a DBC file; no input or output.

What to use when:

- `CanBoardParser` for our own boards, `CanSignalParser` with a `ResolvedSignalMap` for other IMUs.
  Both return `FrameEvent`s that contain `Sample`s, as the parsers in `board` do.
- `CanFrame`, `pack_frames` and `unpack_frames` for frames and their encoding as bytes.
- `sync_frame`, `hello_request_frame` and the other `*_frame` functions for frames to send.
- `bus_reports` for the error frames of the controller; `board_dbc` for other programs.
"""

from gyrorig_protocol.can.board_can_frames import (
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
from gyrorig_protocol.can.bus_errors import BusReport, bus_reports, error_frame
from gyrorig_protocol.can.can_board_parser import CanBoardEvent, CanBoardParser, LatchEvent
from gyrorig_protocol.can.can_frame import CanFrame, FrameFlag, pack_frames, unpack_frames
from gyrorig_protocol.can.dbc import parse_dbc
from gyrorig_protocol.can.signal_map import ResolvedSignalMap, SignalMap, resolve_signals
from gyrorig_protocol.can.signal_parser import CanSignalParser

__all__ = [
    "MAX_NODE",
    "SYNC_IDENTIFIER",
    "BusReport",
    "CanBoardEvent",
    "CanBoardParser",
    "CanFrame",
    "CanSignalParser",
    "FrameFlag",
    "FrameType",
    "LatchEvent",
    "ResolvedSignalMap",
    "SignalMap",
    "accel_frame",
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
    "resolve_signals",
    "status_frame",
    "sync_frame",
    "unpack_frames",
]
