"""Bytes from devices: the pan-tilt unit's replies, boards' frames, payloads and lines."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from tests.fuzz.target import Target, pieces, promise

from gyrorig_protocol.board import (
    ColumnMap,
    FaultCause,
    FrameEvent,
    FrameParser,
    Sample,
    TextLineParser,
    decode_payload,
)
from gyrorig_protocol.board.wire import MAX_PAYLOAD_BYTES, MAX_STUFFED_BYTES, frame_bytes
from gyrorig_protocol.ptu import Expects, PtuCommand, PtuReplyParser, Reply, read

VECTORS = Path(__file__).resolve().parents[2] / "firmware_protocol" / "vectors"
LINE_BYTES = 80
MAPS = (
    ColumnMap(gyro=(0, 1, 2)),
    ColumnMap(gyro=(1, 2, 3), time=0, gyro_unit="dps", time_unit="s", columns=4),
    ColumnMap(gyro=(1, 2, 3), sequence=0, separator=",", temperature=4, temperature_unit="degC"),
)


def ptu_replies(data: bytes) -> None:
    """Events do not depend on cuts, memory is bounded, and any reply can be read."""
    whole, cut = PtuReplyParser(LINE_BYTES), PtuReplyParser(LINE_BYTES)
    events = whole.feed(data, 1)
    promise(events == [e for piece in pieces(data) for e in cut.feed(piece, 1)], "cuts matter")
    promise(whole.buffered_bytes <= LINE_BYTES, "more is kept than the limit")
    for event in events:
        if isinstance(event, Reply):
            for expects in Expects:
                for text in ("PP", "CNT", "BT"):
                    read(PtuCommand(text, expects), event)


def board_frames(data: bytes) -> None:
    """Events do not depend on cuts, memory is bounded, and everything is counted."""
    whole, cut = FrameParser(), FrameParser()
    events = _placeless(whole.feed(data, 1))
    found = _placeless([e for piece in pieces(data) for e in cut.feed(piece, 1)])
    promise(events == found, "cuts matter")
    promise(whole.buffered_bytes <= MAX_STUFFED_BYTES, "more is kept than the limit")
    promise(len(events) == whole.frames + sum(whole.faults.values()), "not all is counted")


def board_payloads(data: bytes) -> None:
    """A payload with a right check is a record that says the same again, or a cause."""
    frame = decode_payload(data)
    if isinstance(frame, FaultCause):
        return
    promise(decode_payload(frame.payload()) == frame, "what is read is not what is written")
    if len(data) <= MAX_PAYLOAD_BYTES:
        (event,) = FrameParser().feed(frame_bytes(data), 1)
        promise(isinstance(event, FrameEvent), "a frame with a right check is refused")


def board_text(data: bytes) -> None:
    """As `board_frames`, and no count is beyond its width."""
    for columns in MAPS:
        whole, cut = (TextLineParser(columns, False, LINE_BYTES) for _ in range(2))
        events = whole.feed(data, 1)
        found = [e for piece in pieces(data) for e in cut.feed(piece, 1)]
        promise(_placeless(events) == _placeless(found), "cuts matter")
        promise(whole.buffered_bytes <= LINE_BYTES, "more is kept than the limit")
        for event in events:
            if isinstance(event, FrameEvent) and isinstance(event.frame, Sample):
                promise(max(map(abs, event.frame.gyro)) < 2**31, "a count is out of range")


def _placeless(events: Sequence[Any]) -> list[Any]:
    """The events without their place in a read, which is all that cuts may change."""
    return [msgspec.structs.replace(event, offset=0) for event in events]


def _vectors(name: str, key: str) -> list[bytes]:
    cases = json.loads((VECTORS / name).read_text())["vectors"]
    return [bytes.fromhex(case[key]) for case in cases if key in case]


def _payloads() -> list[bytes]:
    events = FrameParser().feed(b"".join(_vectors("board_frames.json", "wire_hex")), 1)
    return [event.payload for event in events if isinstance(event, FrameEvent)]


def _lines() -> list[bytes]:
    return [b"1,2,3\n4,5,6\r\n", b"0.001 -1e2 3.5 4\n", b"17,1,2,3,25.0\n# x\n", b"\n\n,,,\n"]


TARGETS = (
    Target("ptu_replies", ptu_replies, lambda: _vectors("ptu_replies.json", "bytes_hex"), 512),
    Target("board_frames", board_frames, lambda: _vectors("board_frames.json", "wire_hex")),
    Target("board_payloads", board_payloads, _payloads, 300),
    Target("board_text", board_text, _lines, 512),
)
