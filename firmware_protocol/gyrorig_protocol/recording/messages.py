"""The messages of format 1 as frozen dataclasses.

What to use when: build one and hand it to `RecordingWriter.write`; `decode` turns a
payload back. In bulk, read fixed-size messages with `Recording.array` instead.

Every host time is an `int` of nanoseconds since the epoch on the capture clock, except
in `HostClock`, whose times are the host's own clocks.

Source: the recording contract, format 1.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import ClassVar, Protocol, Self

import msgspec

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.cdr_stream import (
    ENCAPSULATION,
    NS_PER_S,
    CdrDecoder,
    CdrEncoder,
    split_time,
)

PTU_POSITION_TOPIC = "/ptu/position"
PTU_COMMAND_TOPIC = "/ptu/command"
SESSION_EVENT_TOPIC = "/session/event"
HOST_CLOCK_TOPIC = "/host/clock"
REFERENCE_ATTITUDE_TOPIC = "/reference/attitude"
DIAGNOSTICS_TOPIC = "/diagnostics"
LOG_TOPIC = "/rosout"

Triple = tuple[int, int, int]


def imu_topic(board_id: BoardId) -> str:
    """The topic of a board's raw samples."""
    return f"/board/{board_id}/imu_raw"


def clock_topic(board_id: BoardId) -> str:
    """The topic of a board's clock exchanges."""
    return f"/board/{board_id}/clock"


class Message(Protocol):
    """What `RecordingWriter.write` takes."""

    TYPE: ClassVar[str]

    def encode(self) -> bytes:
        """The CDR payload with its four header bytes."""
        ...

    @property
    def capture_time_ns(self) -> int | None:
        """The payload's own log time, None where the payload holds none."""
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
    """What a `SessionEvent` tells."""

    PHASE_BEGIN = 0
    PHASE_END = 1
    NOTE = 2
    FAULT = 3


def _pack(layout: struct.Struct, *values: float) -> bytes:
    try:
        return layout.pack(ENCAPSULATION, *values)
    except struct.error as error:
        raise ValueError(f"a value does not fit its field: {error}") from error


def _unpack(layout: struct.Struct, data: bytes, name: str) -> list[int | float]:
    if len(data) != layout.size or data[:4] != ENCAPSULATION:
        raise InputError(
            f"{name}: {len(data)} bytes beginning {data[:4].hex()!r}, "
            f"not {layout.size} beginning '00010000'"
        )
    return list(layout.unpack(data)[1:])


class ImuRaw(msgspec.Struct, frozen=True, gc=False):
    """One sample of a board, counts as sent, in the sensor's own axes.

    A msgspec structure: frozen like a frozen dataclass, and made ten times as quickly.
    """

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/ImuRaw"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIQIHh9i")

    host_time_ns: int  # capture time of the frame's last byte
    device_time: int  # ticks as sent: not unwrapped, not scaled
    sequence: int  # the sensor's sample counter as sent
    status: int  # ImuStatus bits
    temperature: int  # raw
    gyro: Triple  # counts
    accel: Triple = (0, 0, 0)  # counts, zero and bit clear where absent
    mag: Triple = (0, 0, 0)

    @property
    def capture_time_ns(self) -> int:
        """When the frame's last byte was in the host's hands."""
        return self.host_time_ns

    def encode(self) -> bytes:
        """The 64-byte payload."""
        sec, nanosec = divmod(self.host_time_ns, NS_PER_S)  # thousands a second: no calls
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
        """Read a payload; raises InputError when it is not one."""
        v = [int(value) for value in _unpack(cls._LAYOUT, data, "ImuRaw")]
        gyro, accel, mag = ((v[i], v[i + 1], v[i + 2]) for i in (6, 9, 12))
        return cls(v[0] * NS_PER_S + v[1], v[2], v[3], v[4], v[5], gyro, accel, mag)


@dataclass(frozen=True, slots=True)
class PtuPosition:
    """One position exchange with the pan-tilt unit; angles after the rig's signs."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/PtuPosition"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIiIiIiiddQIH")

    request_time_ns: int  # just before the query's first byte is written
    first_byte_time_ns: int
    reply_time_ns: int  # the reply's last byte
    pan_steps: int
    tilt_steps: int
    pan_rad: float
    tilt_rad: float
    controller_time: int  # the controller's own counter, 0 where it has none
    sequence: int
    status: int  # PtuStatus bits

    @property
    def capture_time_ns(self) -> int:
        """When the reply's last byte was in the host's hands."""
        return self.reply_time_ns

    def encode(self) -> bytes:
        """The 66-byte payload."""
        return _pack(
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
        """Read a payload; raises InputError when it is not one."""
        v = _unpack(cls._LAYOUT, data, "PtuPosition")
        t = [int(v[i]) * NS_PER_S + int(v[i + 1]) for i in (0, 2, 4)]
        whole = [int(v[i]) for i in (6, 7, 10, 11, 12)]
        return cls(t[0], t[1], t[2], whole[0], whole[1], v[8], v[9], *whole[2:])


@dataclass(frozen=True, slots=True)
class PtuCommandRecord:
    """One exchange with the pan-tilt unit that is not a position poll, verbatim."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/PtuCommand"

    request_time_ns: int
    first_byte_time_ns: int  # 0 when nothing came
    reply_time_ns: int  # 0 when nothing came
    sequence: int
    code: int  # CommandCode
    command: str
    reply: str

    @property
    def capture_time_ns(self) -> int | None:
        """When the reply's last byte came; None without a reply."""
        return self.reply_time_ns or None

    def encode(self) -> bytes:
        """The payload."""
        out = CdrEncoder()
        for time_ns in (self.request_time_ns, self.first_byte_time_ns, self.reply_time_ns):
            out.time(time_ns)
        out.number("I", self.sequence)
        out.number("B", self.code)
        out.string(self.command)
        out.string(self.reply)
        return out.take()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        read = CdrDecoder(data)
        found = cls(
            read.time(),
            read.time(),
            read.time(),
            read.number("I"),
            read.number("B"),
            read.string(),
            read.string(),
        )
        read.end()
        return found


@dataclass(frozen=True, slots=True)
class SessionEvent:
    """A phase's begin or end, an operator's note, or a fault."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/SessionEvent"

    host_time_ns: int
    kind: int  # EventKind
    phase: str  # program, static, sweep, dwell, home, turn
    text: str

    @property
    def capture_time_ns(self) -> int:
        """When it happened."""
        return self.host_time_ns

    def encode(self) -> bytes:
        """The payload."""
        out = CdrEncoder()
        out.time(self.host_time_ns)
        out.number("B", self.kind)
        out.string(self.phase)
        out.string(self.text)
        return out.take()

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        read = CdrDecoder(data)
        found = cls(read.time(), read.number("B"), read.string(), read.string())
        read.end()
        return found


@dataclass(frozen=True, slots=True)
class ClockPing:
    """One two-way clock exchange with a board."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/ClockPing"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIiIQQIH")

    host_send_ns: int
    host_receive_ns: int
    device_receive: int  # ticks
    device_send: int  # ticks
    nonce: int
    status: int

    @property
    def capture_time_ns(self) -> int:
        """When the reply was in the host's hands."""
        return self.host_receive_ns

    def encode(self) -> bytes:
        """The 42-byte payload."""
        return _pack(
            self._LAYOUT,
            *split_time(self.host_send_ns),
            *split_time(self.host_receive_ns),
            self.device_receive,
            self.device_send,
            self.nonce,
            self.status,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        v = [int(value) for value in _unpack(cls._LAYOUT, data, "ClockPing")]
        return cls(v[0] * NS_PER_S + v[1], v[2] * NS_PER_S + v[3], *v[4:])


@dataclass(frozen=True, slots=True)
class HostClock:
    """The host's own clocks, read together once a second."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/HostClock"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIiIiIddI")

    monotonic_raw_ns: int
    monotonic_ns: int
    realtime_ns: int
    frequency_ppm: float
    estimated_error_s: float
    ntp_status: int

    @property
    def capture_time_ns(self) -> None:
        """None: the payload holds no capture time."""
        return

    def encode(self) -> bytes:
        """The 48-byte payload."""
        return _pack(
            self._LAYOUT,
            *split_time(self.monotonic_raw_ns),
            *split_time(self.monotonic_ns),
            *split_time(self.realtime_ns),
            self.frequency_ppm,
            self.estimated_error_s,
            self.ntp_status,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        v = _unpack(cls._LAYOUT, data, "HostClock")
        t = [int(v[i]) * NS_PER_S + int(v[i + 1]) for i in (0, 2, 4)]
        return cls(t[0], t[1], t[2], v[6], v[7], int(v[8]))


@dataclass(frozen=True, slots=True)
class ReferenceAttitude:
    """The attitude of a rig that is not a pan-tilt unit; rotates body into world."""

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/ReferenceAttitude"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siI4ddH")

    host_time_ns: int
    orientation: tuple[float, float, float, float]  # x, y, z, w
    standard_deviation_rad: float  # per axis
    status: int

    @property
    def capture_time_ns(self) -> int:
        """When it was in the host's hands."""
        return self.host_time_ns

    def encode(self) -> bytes:
        """The 54-byte payload."""
        return _pack(
            self._LAYOUT,
            *split_time(self.host_time_ns),
            *self.orientation,
            self.standard_deviation_rad,
            self.status,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Read a payload; raises InputError when it is not one."""
        v = _unpack(cls._LAYOUT, data, "ReferenceAttitude")
        time_ns = int(v[0]) * NS_PER_S + int(v[1])
        return cls(time_ns, (v[2], v[3], v[4], v[5]), v[6], int(v[7]))
