"""Parser events of a board's byte stream: a frame or sample, or invalid bytes."""

from enum import Enum
from typing import TypeAlias

import msgspec

from gyrorig_protocol.board.board_frames import (
    Batch,
    Edge,
    HelloRequest,
    Sample,
    Slow,
    TimeReply,
    TimeRequest,
)
from gyrorig_protocol.board.json_frames import Ack, Hello, Set


class FaultCause(Enum):
    """Why bytes are invalid; the value is the text for people."""

    OVERSIZE = "longer than a frame or line can be"
    COBS = "the byte stuffing does not end with the frame"
    CRC = "the checksum does not match"
    LENGTH = "the length does not fit the type"
    UNKNOWN_TYPE = "this version does not know the frame type"
    CONTENT = "a field has an impossible value"
    COLUMNS = "the line has the wrong number of columns"
    NUMBER = "a column is not a finite number"


BoardFrame: TypeAlias = (
    Sample | Batch | Slow | Edge | Hello | HelloRequest | TimeRequest | TimeReply | Set | Ack
)


class FrameEvent(msgspec.Struct, frozen=True, gc=False):
    """A frame or sample, and the time at which its last byte was received."""

    frame: BoardFrame
    received_ns: int  # timestamp of the read call that returned its last byte
    offset: int  # of that byte in the read data
    payload: bytes  # as received, without its checksum; a HELLO is recorded like this


class FrameFault(msgspec.Struct, frozen=True, gc=False):
    """Invalid bytes; `raw` is at most one byte longer than the limit."""

    cause: FaultCause
    received_ns: int
    offset: int
    raw: bytes


BoardEvent: TypeAlias = FrameEvent | FrameFault
