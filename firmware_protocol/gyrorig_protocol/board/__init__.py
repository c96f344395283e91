"""A board's serial link: GCB1 frames and plain text lines; no I/O.

What to use when:

- `FrameParser` for a board that speaks GCB1; `TextLineParser` with a `ColumnMap` for one
  that prints lines of numbers. Both give `FrameEvent`s with `Sample`s in them.
- The records (`Sample`, `Hello`, `TimeRequest`, ...) and their `encode()` to write.
"""

from gyrorig_protocol.board.decode import decode_payload
from gyrorig_protocol.board.events import (
    BoardEvent,
    BoardFrame,
    FaultCause,
    FrameEvent,
    FrameFault,
)
from gyrorig_protocol.board.frames import (
    Batch,
    Edge,
    HelloRequest,
    Sample,
    SampleFlag,
    Slow,
    TimeReply,
    TimeRequest,
)
from gyrorig_protocol.board.hello import Ack, Hello, Sensor, Set
from gyrorig_protocol.board.parser import FrameParser
from gyrorig_protocol.board.text import ColumnMap, TextLineParser

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
