"""Our own boards on a CAN bus: which frames there are, and what they hold.

An 11-bit identifier is type << 7 | node, node 1 to 127. Lower types go first on the bus.
Numbers are little-endian (struct notation).

    type  name     from   data
    1     SYNC     host   B counter; node 0, so 0x080 as in CANopen: the edge for all boards
    2     LATCH    board  B counter as heard, B low bits of boot, 6 bytes clock at the edge
    3     ACCEL    board  3h accel, H time; before the GYRO of the same time
    4     GYRO     board  3h gyro, H time of data-ready
    5     STATUS   board  I time of the newest sample, H its number, H boot; ten times a second,
                          and before the first sample after a start
    6     HEALTH   board  h temperature, h air temperature in 0.1 degC (-32768 absent), 4B
                          counters' low bits: overruns, frames dropped, bus errors, saturations
    7     HELLO    board  B segment (bit 7: the last), 7s text: JSON as in `board.hello` and its
                          CRC-16, low byte first; after a start and when asked
    8     REQUEST  host   B what; node 0 asks all. 1: say HELLO

Times count the board's microseconds: LATCH 48 bits, STATUS 32, samples 16 bits of 4 us,
which STATUS makes whole: they wrap after 262 ms. Every board latches its clock in the
interrupt that receives SYNC, which all of them get within a bit's time: one common edge,
whatever the host's latency was (reference: boards.md section 3).

What to use when: the `*_frame` functions to send; `board_parser.BoardFrameParser` to receive.
"""

import struct
from enum import IntEnum

from gyrorig_protocol.board.crc import crc16
from gyrorig_protocol.board.frames import NO_AIR_TEMPERATURE, Triple
from gyrorig_protocol.can.frame import CanFrame
from gyrorig_protocol.errors import UsageError

NODE_BITS = 7
MAX_NODE = (1 << NODE_BITS) - 1
TICK_HZ = 1e6
SAMPLE_UNIT_TICKS = 4
SAMPLE_WRAP_TICKS = SAMPLE_UNIT_TICKS << 16
SAY_HELLO = 1

SAMPLE_LAYOUT = struct.Struct("<3hH")
STATUS_LAYOUT = struct.Struct("<IHH")
HEALTH_LAYOUT = struct.Struct("<hh4B")
LATCH_BYTES = 8
SEGMENT_BYTES = 7
LAST_SEGMENT = 0x80
MAX_SEGMENTS = 64  # 448 bytes: a HELLO on a serial line has 247
MAX_CLOCK = (1 << 48) - 1


class FrameType(IntEnum):
    """What an identifier says of its frame."""

    SYNC = 1
    LATCH = 2
    ACCEL = 3
    GYRO = 4
    STATUS = 5
    HEALTH = 6
    HELLO = 7
    REQUEST = 8


def identifier(kind: FrameType, node: int) -> int:
    """Return the identifier of a type and a node.

    Raises:
        UsageError: there is no such node.
    """
    if not 0 <= node <= MAX_NODE:
        raise UsageError(f"there is no CAN node {node}", f"give one from 1 to {MAX_NODE}")
    return int(kind) << NODE_BITS | node


SYNC_IDENTIFIER = identifier(FrameType.SYNC, 0)


def sync_frame(counter: int) -> CanFrame:
    """Return the host's edge; the counter takes its low 8 bits."""
    return CanFrame(SYNC_IDENTIFIER, bytes([counter & 0xFF]))


def hello_request_frame(node: int = 0) -> CanFrame:
    """Return the host's question who is there; node 0 asks all."""
    return CanFrame(identifier(FrameType.REQUEST, node), bytes([SAY_HELLO]))


def latch_frame(node: int, counter: int, boot: int, clock: int) -> CanFrame:
    """Return a board's clock at an edge."""
    data = bytes([counter & 0xFF, boot & 0xFF]) + (clock & MAX_CLOCK).to_bytes(6, "little")
    return CanFrame(identifier(FrameType.LATCH, node), data)


def accel_frame(node: int, accel: Triple, time: int) -> CanFrame:
    """Return the acceleration that belongs to the next GYRO; `time` in ticks."""
    return _sample(FrameType.ACCEL, node, accel, time)


def gyro_frame(node: int, gyro: Triple, time: int) -> CanFrame:
    """Return one sample's rates; `time` in ticks."""
    return _sample(FrameType.GYRO, node, gyro, time)


def status_frame(node: int, time: int, sequence: int, boot: int) -> CanFrame:
    """Return what numbers and dates the samples: the newest one's time and number."""
    data = STATUS_LAYOUT.pack(time & 0xFFFF_FFFF, sequence & 0xFFFF, boot & 0xFFFF)
    return CanFrame(identifier(FrameType.STATUS, node), data)


def health_frame(
    node: int,
    temperature: int,
    air_temperature_decidegc: int | None = None,
    counters: tuple[int, int, int, int] = (0, 0, 0, 0),
) -> CanFrame:
    """Return temperatures and what went wrong so far.

    Args:
        node: the board.
        temperature: as the sensor gives it.
        air_temperature_decidegc: of another sensor, None where there is none.
        counters: overruns, frames dropped, bus errors, saturations; low 8 bits are sent.
    """
    air = NO_AIR_TEMPERATURE if air_temperature_decidegc is None else air_temperature_decidegc
    data = HEALTH_LAYOUT.pack(temperature, air, *(count & 0xFF for count in counters))
    return CanFrame(identifier(FrameType.HEALTH, node), data)


def hello_frames(node: int, text: bytes) -> list[CanFrame]:
    """Return a HELLO's JSON in segments.

    Raises:
        UsageError: it is longer than 446 bytes.
    """
    checked = text + crc16(text).to_bytes(2, "little")
    pieces = [checked[at : at + SEGMENT_BYTES] for at in range(0, len(checked), SEGMENT_BYTES)]
    if len(pieces) > MAX_SEGMENTS:
        raise UsageError(f"a HELLO of {len(text)} bytes", f"{MAX_SEGMENTS * SEGMENT_BYTES - 2} fit")
    last = len(pieces) - 1
    return [
        CanFrame(
            identifier(FrameType.HELLO, node),
            bytes([number | (LAST_SEGMENT if number == last else 0)]) + piece,
        )
        for number, piece in enumerate(pieces)
    ]


def _sample(kind: FrameType, node: int, counts: Triple, time: int) -> CanFrame:
    data = SAMPLE_LAYOUT.pack(*counts, time // SAMPLE_UNIT_TICKS & 0xFFFF)
    return CanFrame(identifier(kind, node), data)
