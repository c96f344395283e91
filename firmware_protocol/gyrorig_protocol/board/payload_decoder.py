"""Frame decoder: from a payload with a valid checksum to its frame, or the cause of a fault.

What to use when: `FrameParser` for a stream; `decode_payload` only for payloads whose checksum
another protocol has verified.
"""

import struct
from collections.abc import Callable
from typing import TypeVar

import msgspec

from gyrorig_protocol.board.board_events import BoardFrame, FaultCause
from gyrorig_protocol.board.board_frames import (
    BATCH_HEAD_LAYOUT,
    EDGE_LAYOUT,
    NO_AIR_TEMPERATURE_DECIDEGC,
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
from gyrorig_protocol.board.json_frames import Ack, Hello, Set

_BATCH_TAIL_BYTES = 2  # temperature after the samples
_Record = TypeVar("_Record")


def decode_payload(payload: bytes) -> BoardFrame | FaultCause:
    """Decode a payload without its checksum; return the cause of the fault if it is invalid."""
    if not payload:
        return FaultCause.LENGTH
    decoder = _DECODERS.get(payload[0])
    return FaultCause.UNKNOWN_TYPE if decoder is None else decoder(payload)


def _decode_sample(payload: bytes) -> Sample | FaultCause:
    if len(payload) != SAMPLE_LAYOUT.size:
        return FaultCause.LENGTH
    values = SAMPLE_LAYOUT.unpack(payload)
    return Sample(values[1], values[2], values[3], values[4:7], values[7:10], values[10])


def _decode_batch(payload: bytes) -> Batch | FaultCause:
    samples_offset = BATCH_HEAD_LAYOUT.size
    samples_bytes = len(payload) - samples_offset - _BATCH_TAIL_BYTES
    if samples_bytes < 0:
        return FaultCause.LENGTH
    _, flags, sequence, device_time, count = BATCH_HEAD_LAYOUT.unpack_from(payload)
    if not count or samples_bytes not in (6 * count, 12 * count):
        return FaultCause.LENGTH
    *values, temperature = struct.unpack_from(
        f"<{samples_bytes // 2 + 1}h", payload, samples_offset
    )
    triples: list[Triple] = [
        (values[first], values[first + 1], values[first + 2]) for first in range(0, len(values), 3)
    ]
    if samples_bytes == 6 * count:
        return Batch(flags, sequence, device_time, tuple(triples), None, temperature)
    gyro, accel = tuple(triples[0::2]), tuple(triples[1::2])
    return Batch(flags, sequence, device_time, gyro, accel, temperature)


def _decode_slow(payload: bytes) -> Slow | FaultCause:
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
        air_temperature_decidegc=None if values[9] == NO_AIR_TEMPERATURE_DECIDEGC else values[9],
        supply_mv=values[10] or None,
    )


def _decode_edge(payload: bytes) -> Edge | FaultCause:
    if len(payload) != EDGE_LAYOUT.size:
        return FaultCause.LENGTH
    _, device_time, pin, polarity = EDGE_LAYOUT.unpack(payload)
    return Edge(device_time, pin, polarity == 1) if polarity <= 1 else FaultCause.CONTENT


def _decode_hello(payload: bytes) -> Hello | HelloRequest | FaultCause:
    if len(payload) == 1:
        return HelloRequest()
    return _decode_json(payload, _HELLO_DECODER)


def _decode_time_request(payload: bytes) -> TimeRequest | FaultCause:
    if len(payload) != TIME_REQUEST_LAYOUT.size:
        return FaultCause.LENGTH
    return TimeRequest(*TIME_REQUEST_LAYOUT.unpack(payload)[1:])


def _decode_time_reply(payload: bytes) -> TimeReply | FaultCause:
    if len(payload) != TIME_REPLY_LAYOUT.size:
        return FaultCause.LENGTH
    return TimeReply(*TIME_REPLY_LAYOUT.unpack(payload)[1:])


def _decode_json(payload: bytes, decoder: msgspec.json.Decoder[_Record]) -> _Record | FaultCause:
    try:
        return decoder.decode(payload[1:])
    except (ValueError, RecursionError):  # msgspec's and Unicode's errors are ValueErrors
        return FaultCause.CONTENT


_HELLO_DECODER = msgspec.json.Decoder(Hello)
_SET_DECODER = msgspec.json.Decoder(Set)
_ACK_DECODER = msgspec.json.Decoder(Ack)

_DECODERS: dict[int, Callable[[bytes], BoardFrame | FaultCause]] = {
    Sample.TYPE: _decode_sample,
    Batch.TYPE: _decode_batch,
    Slow.TYPE: _decode_slow,
    Edge.TYPE: _decode_edge,
    Hello.TYPE: _decode_hello,
    TimeRequest.TYPE: _decode_time_request,
    TimeReply.TYPE: _decode_time_reply,
    Set.TYPE: lambda payload: _decode_json(payload, _SET_DECODER),
    Ack.TYPE: lambda payload: _decode_json(payload, _ACK_DECODER),
}
