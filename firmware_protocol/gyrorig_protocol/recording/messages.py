"""The messages of a recording (package gyrorig_msgs, format 1).

What to use when: build a message and pass it to `RecordingWriter.write`; `decode` reads a payload.
To read many fixed-size messages, use `Recording.array` instead.

Every host time is an `int` of nanoseconds since the epoch on the capture clock (UTC anchored once
per session, then CLOCK_MONOTONIC_RAW). `clock_messages` has the messages about clocks.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import ClassVar, Protocol, Self

import msgspec

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.cdr_codec import (
    ENCAPSULATION,
    NS_PER_S,
    CdrDecoder,
    CdrEncoder,
    pack_fields,
    split_time,
    unpack_fields,
)

PTU_POSITION_TOPIC = "/ptu/position"
PTU_COMMAND_TOPIC = "/ptu/command"
SESSION_EVENT_TOPIC = "/session/event"
REFERENCE_ATTITUDE_TOPIC = "/reference/attitude"
DIAGNOSTICS_TOPIC = "/diagnostics"

Triple = tuple[int, int, int]


def imu_raw_topic(board_id: BoardId) -> str:
    """Return the topic of a board's raw samples."""
    return f"/board/{board_id}/imu_raw"


class Message(Protocol):
    """Interface of a message for `RecordingWriter.write`."""

    TYPE: ClassVar[str]

    def encode(self) -> bytes:
        """Return the CDR payload with its header of four bytes."""
        ...

    @property
    def capture_time_ns(self) -> int | None:
        """The log time in the payload, None if the payload has none."""
        ...


class ImuStatus(IntFlag):
    """Bits of `ImuRaw.status`."""

    OVERRUN = 1 << 0
    SATURATED = 1 << 1
    STAMPED_AT_DATA_READY = 1 << 2
    REPEATED = 1 << 3
    STAMP_FROM_FIFO = 1 << 4
    CONFIGURATION_CHANGED = 1 << 5
    FRAMES_DROPPED = 1 << 6
    CLOCK_DISCIPLINED = 1 << 7
    ACCEL_VALID = 1 << 8
    MAG_VALID = 1 << 9
    TEMPERATURE_VALID = 1 << 10


class PtuStatus(IntFlag):
    """Bits of `PtuPosition.status`."""

    PAN_ANSWERED = 1 << 0
    TILT_ANSWERED = 1 << 1
    SYNCHRONY_LOST = 1 << 2
    HOMING = 1 << 3


class CommandCode(IntEnum):
    """How an exchange with the pan-tilt unit ended."""

    OK = 0
    ERROR = 1
    TIMEOUT = 2
    LIMIT = 3


class EventKind(IntEnum):
    """The kind of a `SessionEvent`."""

    PHASE_BEGIN = 0
    PHASE_END = 1
    NOTE = 2
    FAULT = 3


class ImuRaw(msgspec.Struct, frozen=True, gc=False):
    """One sample of a board: counts as sent, in the sensor's axes.

    A msgspec structure is immutable like a frozen dataclass, and creating it is ten times faster.
    """

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/ImuRaw"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIQIHh9i")

    host_time_ns: int  # capture time of the frame's last byte
    device_time: int  # ticks as sent: not unwrapped, not scaled
    sequence: int  # the sensor's sample counter as sent
    status: int  # ImuStatus bits
    temperature: int  # raw
    gyro: Triple  # counts
    accel: Triple = (0, 0, 0)  # counts; zero and status bit clear if absent
    mag: Triple = (0, 0, 0)

    @property
    def capture_time_ns(self) -> int:
        """The time at which the frame's last byte was received."""
        return self.host_time_ns

    def encode(self) -> bytes:
        """Return the payload of 64 bytes."""
        sec, nanosec = divmod(self.host_time_ns, NS_PER_S)  # thousands per second: no calls
        try:
            return self._LAYOUT.pack(
                ENCAPSULATION,
                sec,
                nanosec,
                self.device_time,
                self.sequence,
                self.status,
                self.temperature,
                *self.gyro,
                *self.accel,
                *self.mag,
            )
        except struct.error as error:
            raise ValueError(f"a value does not fit its field: {error}") from error

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        values = unpack_fields(cls._LAYOUT, data, "ImuRaw")
        return cls(
            values[0] * NS_PER_S + values[1],
            values[2],
            values[3],
            values[4],
            values[5],
            values[6:9],
            values[9:12],
            values[12:15],
        )


class PtuPosition(msgspec.Struct, frozen=True, gc=False):
    """One position query of the pan-tilt unit; angles after the signs of the rig."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/PtuPosition"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIiIiIiiddQIH")

    request_time_ns: int  # just before the query's first byte is written
    first_byte_time_ns: int
    reply_time_ns: int  # the reply's last byte
    pan_steps: int
    tilt_steps: int
    pan_rad: float
    tilt_rad: float
    controller_time: int  # the controller's counter, 0 if it has none
    sequence: int
    status: int  # PtuStatus bits

    @property
    def capture_time_ns(self) -> int:
        """The time at which the reply's last byte was received."""
        return self.reply_time_ns

    def encode(self) -> bytes:
        """Return the payload of 66 bytes."""
        return pack_fields(
            self._LAYOUT,
            *split_time(self.request_time_ns),
            *split_time(self.first_byte_time_ns),
            *split_time(self.reply_time_ns),
            self.pan_steps,
            self.tilt_steps,
            self.pan_rad,
            self.tilt_rad,
            self.controller_time,
            self.sequence,
            self.status,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        values = unpack_fields(cls._LAYOUT, data, "PtuPosition")
        return cls(
            values[0] * NS_PER_S + values[1],
            values[2] * NS_PER_S + values[3],
            values[4] * NS_PER_S + values[5],
            *values[6:],
        )


@dataclass(frozen=True, slots=True)
class PtuCommandRecord:
    """One command to the pan-tilt unit and its reply, verbatim, except position polling."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/PtuCommand"

    request_time_ns: int
    first_byte_time_ns: int  # 0 without a reply
    reply_time_ns: int  # 0 without a reply
    sequence: int
    code: int  # CommandCode
    command: str
    reply: str

    @property
    def capture_time_ns(self) -> int | None:
        """The time at which the reply's last byte was received; None without a reply."""
        return self.reply_time_ns or None

    def encode(self) -> bytes:
        """Return the payload."""
        encoder = CdrEncoder()
        for time_ns in (self.request_time_ns, self.first_byte_time_ns, self.reply_time_ns):
            encoder.add_time(time_ns)
        encoder.add_number("I", self.sequence)
        encoder.add_number("B", self.code)
        encoder.add_string(self.command)
        encoder.add_string(self.reply)
        return encoder.to_payload()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        decoder = CdrDecoder(data)
        record = cls(
            decoder.read_time(),
            decoder.read_time(),
            decoder.read_time(),
            decoder.read_integer("I"),
            decoder.read_integer("B"),
            decoder.read_string(),
            decoder.read_string(),
        )
        decoder.check_end()
        return record


@dataclass(frozen=True, slots=True)
class SessionEvent:
    """The begin or end of a phase, an operator's note, or a fault."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/SessionEvent"

    host_time_ns: int
    kind: int  # EventKind
    phase: str  # program, static, sweep, dwell, home, turn
    text: str

    @property
    def capture_time_ns(self) -> int:
        """The time of the event."""
        return self.host_time_ns

    def encode(self) -> bytes:
        """Return the payload."""
        encoder = CdrEncoder()
        encoder.add_time(self.host_time_ns)
        encoder.add_number("B", self.kind)
        encoder.add_string(self.phase)
        encoder.add_string(self.text)
        return encoder.to_payload()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        decoder = CdrDecoder(data)
        event = cls(
            decoder.read_time(),
            decoder.read_integer("B"),
            decoder.read_string(),
            decoder.read_string(),
        )
        decoder.check_end()
        return event


@dataclass(frozen=True, slots=True)
class ReferenceAttitude:
    """The attitude of a rig without a pan-tilt unit; rotates body into world."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/ReferenceAttitude"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siI4ddH")

    host_time_ns: int
    orientation: tuple[float, float, float, float]  # x, y, z, w
    standard_deviation_rad: float  # per axis
    status: int

    @property
    def capture_time_ns(self) -> int:
        """The time at which the attitude was received."""
        return self.host_time_ns

    def encode(self) -> bytes:
        """Return the payload of 54 bytes."""
        return pack_fields(
            self._LAYOUT,
            *split_time(self.host_time_ns),
            *self.orientation,
            self.standard_deviation_rad,
            self.status,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        values = unpack_fields(cls._LAYOUT, data, "ReferenceAttitude")
        time_ns = int(values[0]) * NS_PER_S + int(values[1])
        return cls(time_ns, (values[2], values[3], values[4], values[5]), values[6], int(values[7]))
