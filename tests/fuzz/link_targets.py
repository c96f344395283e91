"""Bytes from devices: the pan-tilt unit's replies, boards' frames, payloads and lines."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
from tests.fuzz.target import Target, require, split_pieces

from gyrorig_protocol.board import (
    ColumnMap,
    FaultCause,
    FrameEvent,
    FrameParser,
    Sample,
    TextLineParser,
    decode_payload,
)
from gyrorig_protocol.board.frame_encoding import MAX_PAYLOAD_BYTES, MAX_STUFFED_BYTES, encode_frame
from gyrorig_protocol.board_protocols.json_lines import JsonLineParser, JsonOptions
from gyrorig_protocol.ptu import AnswerKind, PtuCommand, PtuReplyParser, Reply, read_value

VECTORS = Path(__file__).resolve().parents[2] / "firmware_protocol" / "vectors"
LINE_BYTES = 80
MAPS = (
    ColumnMap(gyro=(0, 1, 2)),
    ColumnMap(gyro=(1, 2, 3), time=0, gyro_unit="dps", time_unit="s", columns=4),
    ColumnMap(gyro=(1, 2, 3), sequence=0, separator=",", temperature=4, temperature_unit="degC"),
)


def ptu_replies(data: bytes) -> None:
    """Events do not depend on cuts, memory is bounded, and any reply can be read."""
    complete, cut = PtuReplyParser(LINE_BYTES), PtuReplyParser(LINE_BYTES)
    events = complete.feed(data, 1)
    require(
        events == [e for piece in split_pieces(data) for e in cut.feed(piece, 1)], "cuts matter"
    )
    require(complete.buffered_bytes <= LINE_BYTES, "more is kept than the limit")
    for event in events:
        if isinstance(event, Reply):
            for expects in AnswerKind:
                for text in ("PP", "CNT", "BT"):
                    read_value(PtuCommand(text, expects), event)


def board_frames(data: bytes) -> None:
    """Events do not depend on cuts, memory is bounded, and everything is counted."""
    complete, cut = FrameParser(), FrameParser()
    events = _placeless(complete.feed(data, 1))
    actual = _placeless([e for piece in split_pieces(data) for e in cut.feed(piece, 1)])
    require(events == actual, "cuts matter")
    require(complete.buffered_bytes <= MAX_STUFFED_BYTES, "more is kept than the limit")
    require(len(events) == complete.frames + sum(complete.faults.values()), "not all is counted")


def board_payloads(data: bytes) -> None:
    """A payload with a valid checksum is a frame that round-trips, or a fault cause."""
    frame = decode_payload(data)
    if isinstance(frame, FaultCause):
        return
    require(decode_payload(frame.encode_payload()) == frame, "what is read is not what is written")
    if len(data) <= MAX_PAYLOAD_BYTES:
        (event,) = FrameParser().feed(encode_frame(data), 1)
        require(isinstance(event, FrameEvent), "a frame with a right check is refused")


def board_text(data: bytes) -> None:
    """As `board_frames`, and no count is beyond its width."""
    for columns in MAPS:
        complete, cut = (TextLineParser(columns, False, LINE_BYTES) for _ in range(2))
        events = complete.feed(data, 1)
        actual = [e for piece in split_pieces(data) for e in cut.feed(piece, 1)]
        require(_placeless(events) == _placeless(actual), "cuts matter")
        require(complete.buffered_bytes <= LINE_BYTES, "more is kept than the limit")
        for event in events:
            if isinstance(event, FrameEvent) and isinstance(event.frame, Sample):
                require(max(map(abs, event.frame.gyro)) < 2**31, "a count is out of range")


def board_json(data: bytes) -> None:
    """As `board_text`, for JSON lines with counts and with units."""
    for options in (JsonOptions(), JsonOptions(gyro_unit="dps", time_unit="s")):
        complete, cut = JsonLineParser(options), JsonLineParser(options)
        events = complete.feed(data, 1)
        actual = [e for piece in split_pieces(data) for e in cut.feed(piece, 1)]
        require(_placeless(events) == _placeless(actual), "cuts matter")
        for event in events:
            if isinstance(event, FrameEvent) and isinstance(event.frame, Sample):
                require(max(map(abs, event.frame.gyro)) < 2**31, "a count is out of range")
                require(0 <= event.frame.sequence < 2**32, "a number is out of range")
                require(0 <= (event.frame.device_time or 0) < 2**64, "a time is out of range")


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


def _json_lines() -> list[bytes]:
    line = b'{"t": 1000, "n": 7, "gyro": [1, -2, 3], "accel": [0, 0, 256], "temp": 251}\n'
    huge = b'{"gyro": [1%s, 1e400, 0.5], "t": -1.5, "n": 4294967296}\n' % (b"0" * 400)
    return [line + line, b"\n" + line + huge, b"\n" + huge + line, b"\n" + b"[" * 300 + b"\n"]


TARGETS = (
    Target("ptu_replies", ptu_replies, lambda: _vectors("ptu_replies.json", "bytes_hex"), 512),
    Target("board_frames", board_frames, lambda: _vectors("board_frames.json", "wire_hex")),
    Target("board_payloads", board_payloads, _payloads, 300),
    Target("board_text", board_text, _lines, 512),
    Target("board_json", board_json, _json_lines, 1024),
)
