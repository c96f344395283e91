"""The message about orders of motion, without the words of any maker.

What to use when: `MotionOrder` on `MOTION_ORDER_TOPIC`. A unit's driver makes the orders, see
`motion_orders`. The verbatim text of the same exchange is a `PtuCommandRecord`.
"""

import struct
from dataclasses import dataclass
from typing import ClassVar, Self

from gyrorig_protocol.recording.encoding.cdr_codec import (
    NS_PER_S,
    pack_fields,
    split_time,
    unpack_fields,
)

MOTION_ORDER_TOPIC = "/unit/motion"


@dataclass(frozen=True, slots=True)
class MotionOrder:
    """One order of an exchange with the unit.

    An exchange can contain several orders. They have the same times and consecutive numbers.
    """

    TYPE: ClassVar[str] = "gyrorig_msgs/msg/MotionOrder"
    _LAYOUT: ClassVar[struct.Struct] = struct.Struct("<4siIiIiIdddIHBBB")

    request_time_ns: int  # just before the first byte is written
    first_byte_time_ns: int  # of the reply; 0 without a reply
    reply_time_ns: int  # last byte of the reply; 0 without a reply
    value: float  # rad, rad/s or rad/s^2 in the rig's sense of rotation; NaN if not known
    steps: float  # the same in steps, steps/s or steps/s^2 of the driver
    speed_steps_s: float  # speed that belongs to a target; NaN without one
    sequence: int
    command_bytes: int  # bytes that the unit must receive before it can act
    axis: int  # OrderAxis
    kind: int  # OrderKind
    accepted: int  # 1: the unit acknowledged the order

    @property
    def capture_time_ns(self) -> int | None:
        """The time at which the reply's last byte was received; None without a reply."""
        return self.reply_time_ns or None

    def encode(self) -> bytes:
        """Return the payload of 61 bytes."""
        return pack_fields(
            self._LAYOUT,
            *split_time(self.request_time_ns),
            *split_time(self.first_byte_time_ns),
            *split_time(self.reply_time_ns),
            self.value,
            self.steps,
            self.speed_steps_s,
            self.sequence,
            self.command_bytes,
            self.axis,
            self.kind,
            self.accepted,
        )

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Decode a payload; raises InputError if it is invalid."""
        values = unpack_fields(cls._LAYOUT, data, "MotionOrder")
        times_ns = [int(values[index]) * NS_PER_S + int(values[index + 1]) for index in (0, 2, 4)]
        return cls(
            times_ns[0],
            times_ns[1],
            times_ns[2],
            values[6],
            values[7],
            values[8],
            *(int(value) for value in values[9:]),
        )
