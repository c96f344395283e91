"""What a board's byte stream can hold: a frame or sample, or bytes that are neither."""

from enum import Enum
from typing import TypeAlias

import msgspec

from gyrorig_protocol.board.frames import (
    Batch,
    Edge,
    HelloRequest,
    Sample,
    Slow,
    TimeReply,
    TimeRequest,
)
from gyrorig_protocol.board.hello import Ack, Hello, Set


class FaultCause(Enum):
    """Why bytes were not taken; the value says it in words."""

    OVERSIZE = "longer than a frame or line can be"
    COBS = "the stuffing does not meet the end of the frame"
    CRC = "the check does not match"
    LENGTH = "the length does not fit the type"
    UNKNOWN_TYPE = "a type that this version does not know"
    CONTENT = "a field holds what it cannot hold"
    COLUMNS = "the line has another number of columns"
    NUMBER = "a column is no finite number"


BoardFrame: TypeAlias = (
    Sample | Batch | Slow | Edge | Hello | HelloRequest | TimeRequest | TimeReply | Set | Ack
)


class FrameEvent(msgspec.Struct, frozen=True, gc=False):
    """A frame or sample, and when its last byte was in the host's hands."""

    frame: BoardFrame
    received_ns: int  # of the read that held its last byte
    offset: int  # of that byte in that read
    payload: bytes  # as it came, without its check: a HELLO is kept so


class FrameFault(msgspec.Struct, frozen=True, gc=False):
    """Bytes that were no frame or sample; `raw` is at most one byte longer than the limit."""

    cause: FaultCause
    received_ns: int
    offset: int
    raw: bytes


BoardEvent: TypeAlias = FrameEvent | FrameFault
