"""A board's serial protocol: GCB1 frames and plain text lines, without input or output (sans-IO).

What to use when:

- `FrameParser` for a board that sends GCB1 frames; `TextLineParser` with a `ColumnMap` for a
  board that prints lines of numbers. Both return `FrameEvent`s that contain `Sample`s.
- The frame classes (`Sample`, `Hello`, `TimeRequest`, ...) and their `encode()` to send.
"""

from gyrorig_protocol.board.board_events import (
    BoardEvent,
    BoardFrame,
    FaultCause,
    FrameEvent,
    FrameFault,
)
from gyrorig_protocol.board.board_frames import (
    Batch,
    Edge,
    HelloRequest,
    Sample,
    SampleFlag,
    Slow,
    TimeReply,
    TimeRequest,
)
from gyrorig_protocol.board.frame_parser import FrameParser
from gyrorig_protocol.board.json_frames import Ack, Hello, Sensor, Set
from gyrorig_protocol.board.payload_decoder import decode_payload
from gyrorig_protocol.board.text_lines import ColumnMap, TextLineParser

__all__ = [
    "Ack",
    "Batch",
    "BoardEvent",
    "BoardFrame",
    "ColumnMap",
    "Edge",
    "FaultCause",
    "FrameEvent",
    "FrameFault",
    "FrameParser",
    "Hello",
    "HelloRequest",
    "Sample",
    "SampleFlag",
    "Sensor",
    "Set",
    "Slow",
    "TextLineParser",
    "TimeReply",
    "TimeRequest",
    "decode_payload",
]
