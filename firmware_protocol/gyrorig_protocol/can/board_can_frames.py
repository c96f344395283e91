"""The CAN frames of our own boards and their fields.

An 11-bit identifier is type << 7 | node, node 1 to 127. Frames with lower types have priority on
the bus. Numbers are little-endian (struct notation).

    type  name     from   data
    1     SYNC     host   B counter; node 0, therefore 0x080 as in CANopen: the common edge
    2     LATCH    board  B counter as received, B low bits of boot, 6 bytes clock at the edge
    3     ACCEL    board  3h accel, H time; before the GYRO of the same time
    4     GYRO     board  3h gyro, H time of data-ready
    5     STATUS   board  I time of the newest sample, H its number, H boot; ten times per second,
                          and before the first sample after a start
    6     HEALTH   board  h temperature, h air temperature in 0.1 degC (-32768 absent), 4B
                          counters' low bits: overruns, frames dropped, bus errors, saturations
    7     HELLO    board  B segment (bit 7: the last), 7s text: JSON as in `json_frames` and its
                          CRC-16, low byte first; after a start and on request
    8     REQUEST  host   B requested frame, 1: HELLO; node 0 addresses all boards

Times count the board's microseconds. LATCH has 48 bits and STATUS has 32. Samples have 16 bits of
4 us, which wrap after 262 ms and are completed by STATUS. Every board latches its clock in the
interrupt that receives SYNC. All boards receive it within the time of one bit, so that it is one
common edge, independent of the host's latency (docs/can.md).

What to use when: the `*_frame` functions to send; `can_board_parser.CanBoardParser` to receive.
"""

import struct
from enum import IntEnum

from gyrorig_protocol.board.board_frames import NO_AIR_TEMPERATURE_DECIDEGC, Triple
from gyrorig_protocol.board.crc import compute_crc16
from gyrorig_protocol.can.can_frame import CanFrame
from gyrorig_protocol.errors import UsageError

NODE_BITS = 7
MAX_NODE = (1 << NODE_BITS) - 1
SAMPLE_UNIT_TICKS = 4
SAMPLE_WRAP_TICKS = SAMPLE_UNIT_TICKS << 16
REQUEST_HELLO = 1

SAMPLE_LAYOUT = struct.Struct("<3hH")
STATUS_LAYOUT = struct.Struct("<IHH")
HEALTH_LAYOUT = struct.Struct("<hh4B")
LATCH_BYTES = 8
SEGMENT_BYTES = 7
LAST_SEGMENT = 0x80
MAX_SEGMENTS = 64  # 448 bytes; a HELLO on a serial line has 247
MAX_CLOCK_TICKS = (1 << 48) - 1


class FrameType(IntEnum):
    """The frame type in an identifier."""

    SYNC = 1
    LATCH = 2
    ACCEL = 3
    GYRO = 4
    STATUS = 5
    HEALTH = 6
    HELLO = 7
    REQUEST = 8


def frame_identifier(frame_type: FrameType, node: int) -> int:
    """Return the identifier of a frame type and a node.

    Raises:
        UsageError: the node number is out of range.
    """
    if not 0 <= node <= MAX_NODE:
        raise UsageError(
            f"the number {node} is not a valid CAN node number",
            f"give a node number from 1 to {MAX_NODE}",
        )
    return int(frame_type) << NODE_BITS | node


SYNC_IDENTIFIER = frame_identifier(FrameType.SYNC, 0)


def sync_frame(counter: int) -> CanFrame:
    """Return the host's SYNC frame; the low 8 bits of the counter are sent."""
    return CanFrame(SYNC_IDENTIFIER, bytes([counter & 0xFF]))


def hello_request_frame(node: int = 0) -> CanFrame:
    """Return the host's request for HELLO; node 0 addresses all boards."""
    return CanFrame(frame_identifier(FrameType.REQUEST, node), bytes([REQUEST_HELLO]))


def latch_frame(node: int, counter: int, boot: int, clock_ticks: int) -> CanFrame:
    """Return a LATCH frame: a board's clock at the edge of a SYNC."""
    data = bytes([counter & 0xFF, boot & 0xFF]) + (clock_ticks & MAX_CLOCK_TICKS).to_bytes(
        6, "little"
    )
    return CanFrame(frame_identifier(FrameType.LATCH, node), data)


def accel_frame(node: int, accel: Triple, time_ticks: int) -> CanFrame:
    """Return an ACCEL frame, the acceleration of the next GYRO frame."""
    return _sample_frame(FrameType.ACCEL, node, accel, time_ticks)


def gyro_frame(node: int, gyro: Triple, time_ticks: int) -> CanFrame:
    """Return a GYRO frame, the rates of one sample."""
    return _sample_frame(FrameType.GYRO, node, gyro, time_ticks)


def status_frame(node: int, time_ticks: int, sequence: int, boot: int) -> CanFrame:
    """Return a STATUS frame: the time and number of the newest sample."""
    data = STATUS_LAYOUT.pack(time_ticks & 0xFFFF_FFFF, sequence & 0xFFFF, boot & 0xFFFF)
    return CanFrame(frame_identifier(FrameType.STATUS, node), data)


def health_frame(
    node: int,
    temperature: int,
    air_temperature_decidegc: int | None = None,
    counters: tuple[int, int, int, int] = (0, 0, 0, 0),
) -> CanFrame:
    """Return a HEALTH frame: temperatures and error counters.

    Args:
        node: the board.
        temperature: raw.
        air_temperature_decidegc: of another sensor, None if there is none.
        counters: overruns, frames dropped, bus errors, saturations; low 8 bits are sent.
    """
    air_field = (
        NO_AIR_TEMPERATURE_DECIDEGC
        if air_temperature_decidegc is None
        else air_temperature_decidegc
    )
    data = HEALTH_LAYOUT.pack(temperature, air_field, *(count & 0xFF for count in counters))
    return CanFrame(frame_identifier(FrameType.HEALTH, node), data)


def hello_frames(node: int, text: bytes) -> list[CanFrame]:
    """Return the HELLO frames that contain a JSON text in segments.

    Raises:
        UsageError: it is longer than 446 bytes.
    """
    text_with_crc = text + compute_crc16(text).to_bytes(2, "little")
    segments = [
        text_with_crc[start : start + SEGMENT_BYTES]
        for start in range(0, len(text_with_crc), SEGMENT_BYTES)
    ]
    if len(segments) > MAX_SEGMENTS:
        raise UsageError(
            f"the HELLO message of the CAN board is too long: it has {len(text)} bytes",
            f"send at most {MAX_SEGMENTS * SEGMENT_BYTES - 2} bytes",
        )
    last_number = len(segments) - 1
    return [
        CanFrame(
            frame_identifier(FrameType.HELLO, node),
            bytes([number | (LAST_SEGMENT if number == last_number else 0)]) + segment,
        )
        for number, segment in enumerate(segments)
    ]


def _sample_frame(frame_type: FrameType, node: int, counts: Triple, time_ticks: int) -> CanFrame:
    data = SAMPLE_LAYOUT.pack(*counts, time_ticks // SAMPLE_UNIT_TICKS & 0xFFFF)
    return CanFrame(frame_identifier(frame_type, node), data)
