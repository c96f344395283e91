"""Messages about clocks: a board's replies to time requests, and the host's own clocks.

What to use when: as in `messages`. The times of `HostClock` are on the host's own clocks.
"""

import struct
from dataclasses import dataclass
from typing import ClassVar, Self

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.encoding.cdr_codec import (
    NS_PER_S,
    pack_fields,
    split_time,
    unpack_fields,
)

HOST_CLOCK_TOPIC = "/host/clock"


def clock_ping_topic(board_id: BoardId) -> str:
    """Return the topic of a board's clock exchanges."""
    return f"/board/{board_id}/clock"


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
        """The time at which the reply was received."""
        return self.host_receive_ns

    def encode(self) -> bytes:
        """Return the payload of 42 bytes."""
        return pack_fields(
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
        """Decode a payload; raises InputError if it is invalid."""
        values = [int(value) for value in unpack_fields(cls._LAYOUT, data, "ClockPing")]
        return cls(values[0] * NS_PER_S + values[1], values[2] * NS_PER_S + values[3], *values[4:])


@dataclass(frozen=True, slots=True)
class HostClock:
    """The host's clocks, read together once per second."""

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
        """None: the payload has no capture time."""
        return

    def encode(self) -> bytes:
        """Return the payload of 48 bytes."""
        return pack_fields(
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
        """Decode a payload; raises InputError if it is invalid."""
        values = unpack_fields(cls._LAYOUT, data, "HostClock")
        times_ns = [int(values[index]) * NS_PER_S + int(values[index + 1]) for index in (0, 2, 4)]
        return cls(times_ns[0], times_ns[1], times_ns[2], values[6], values[7], int(values[8]))
