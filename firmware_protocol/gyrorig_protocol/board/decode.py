"""From a checked payload to its record; hostile payloads give a named fault.

What to use when: `FrameParser` for a stream. `decode_payload` alone only for payloads
that another carrier has checked already.
"""

import struct
from collections.abc import Callable
from typing import TypeVar

import msgspec

from gyrorig_protocol.board.events import BoardFrame, FaultCause
from gyrorig_protocol.board.frames import (
    BATCH_HEAD_LAYOUT,
    EDGE_LAYOUT,
    NO_AIR_TEMPERATURE,
    SAMPLE_LAYOUT,
    SLOW_LAYOUT,
    TIME_REPLY_LAYOUT,
    TIME_REQUEST_LAYOUT,
    Batch,
    Edge,
    HelloRequest,
    Sample,
    Slow,
    TimeReply,
    TimeRequest,
    Triple,
)
from gyrorig_protocol.board.hello import Ack, Hello, Set

_BATCH_ENDS = 2  # bytes of temperature behind the samples
_J = TypeVar("_J")


def decode_payload(payload: bytes) -> BoardFrame | FaultCause:
    """Return the record that a payload without its check is, or why it is none."""
    if not payload:
        return FaultCause.LENGTH
    decoder = _DECODERS.get(payload[0])
    return FaultCause.UNKNOWN_TYPE if decoder is None else decoder(payload)


def _sample(payload: bytes) -> Sample | FaultCause:
    if len(payload) != SAMPLE_LAYOUT.size:
        return FaultCause.LENGTH
    values = SAMPLE_LAYOUT.unpack(payload)
    return Sample(values[1], values[2], values[3], values[4:7], values[7:10], values[10])


def _batch(payload: bytes) -> Batch | FaultCause:
    at = BATCH_HEAD_LAYOUT.size
    room = len(payload) - at - _BATCH_ENDS
    if room < 0:
        return FaultCause.LENGTH
    _, flags, sequence, device_time, count = BATCH_HEAD_LAYOUT.unpack_from(payload)
    if not count or room not in (6 * count, 12 * count):
        return FaultCause.LENGTH
    *flat, temperature = struct.unpack_from(f"<{room // 2 + 1}h", payload, at)
    triples: list[Triple] = [(flat[i], flat[i + 1], flat[i + 2]) for i in range(0, len(flat), 3)]
    if room == 6 * count:
        return Batch(flags, sequence, device_time, tuple(triples), None, temperature)
    gyro, accel = tuple(triples[0::2]), tuple(triples[1::2])
    return Batch(flags, sequence, device_time, gyro, accel, temperature)


def _slow(payload: bytes) -> Slow | FaultCause:
    if len(payload) != SLOW_LAYOUT.size:
        return FaultCause.LENGTH
    values = SLOW_LAYOUT.unpack(payload)
    return Slow(
        device_time=values[1],
        boot=values[2],
        sequence=values[3],
        sensor_overruns=values[4],
        frames_dropped=values[5],
        bus_errors=values[6],
        saturations=values[7],
        temperature=values[8],
        air_temperature_decidegc=None if values[9] == NO_AIR_TEMPERATURE else values[9],
        supply_mv=values[10] or None,
    )


def _edge(payload: bytes) -> Edge | FaultCause:
    if len(payload) != EDGE_LAYOUT.size:
        return FaultCause.LENGTH
    _, device_time, pin, polarity = EDGE_LAYOUT.unpack(payload)
    return Edge(device_time, pin, polarity == 1) if polarity <= 1 else FaultCause.CONTENT


def _hello(payload: bytes) -> Hello | HelloRequest | FaultCause:
    if len(payload) == 1:
        return HelloRequest()
    return _json(payload, _HELLO)


def _time_request(payload: bytes) -> TimeRequest | FaultCause:
    if len(payload) != TIME_REQUEST_LAYOUT.size:
        return FaultCause.LENGTH
    return TimeRequest(*TIME_REQUEST_LAYOUT.unpack(payload)[1:])


def _time_reply(payload: bytes) -> TimeReply | FaultCause:
    if len(payload) != TIME_REPLY_LAYOUT.size:
        return FaultCause.LENGTH
    return TimeReply(*TIME_REPLY_LAYOUT.unpack(payload)[1:])


def _json(payload: bytes, decoder: msgspec.json.Decoder[_J]) -> _J | FaultCause:
    """Return what the JSON after the type byte says; any fault in it is one of content."""
    try:
        return decoder.decode(payload[1:])
    except (ValueError, RecursionError):  # msgspec's and Unicode's errors are ValueErrors
        return FaultCause.CONTENT


_HELLO = msgspec.json.Decoder(Hello)
_SET = msgspec.json.Decoder(Set)
_ACK = msgspec.json.Decoder(Ack)

_DECODERS: dict[int, Callable[[bytes], BoardFrame | FaultCause]] = {
    Sample.TYPE: _sample,
    Batch.TYPE: _batch,
    Slow.TYPE: _slow,
    Edge.TYPE: _edge,
    Hello.TYPE: _hello,
    TimeRequest.TYPE: _time_request,
    TimeReply.TYPE: _time_reply,
    Set.TYPE: lambda payload: _json(payload, _SET),
    Ack.TYPE: lambda payload: _json(payload, _ACK),
}
