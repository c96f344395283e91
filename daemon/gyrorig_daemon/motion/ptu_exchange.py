"""Values that pass between the daemon and a pan-tilt unit, and counters of faults."""

from dataclasses import dataclass, field

import msgspec

from gyrorig_protocol.motion_orders import AxisOrder
from gyrorig_protocol.ptu import PtuCommand, Reading, Reply


def is_accepted(reply: Reply | None, limit_hit: bool) -> bool:
    """Return whether the unit executes a command with this reply."""
    return reply is not None and reply.ok and not limit_hit


class Exchange(msgspec.Struct, frozen=True, gc=False):
    """One command and its reply, with times on the raw monotonic clock.

    A msgspec structure is immutable like a frozen dataclass, and creating it is ten times faster.
    """

    command: PtuCommand
    request_ns: int  # just before the first byte is written
    sent_ns: int  # after the last byte was written
    first_byte_ns: int  # equal to reply_ns without a reply
    reply_ns: int
    reply: Reply | None  # None: no reply in time, or an invalid one
    raw: bytes  # everything received meanwhile
    limit_hit: bool
    orders: tuple[AxisOrder, ...] = ()  # what the command means; none if it moves nothing
    reading: Reading | None = None  # of the reply, if the driver's commands have values

    @property
    def accepted(self) -> bool:
        """Whether the unit has acknowledged the command, and reached no limit meanwhile."""
        return is_accepted(self.reply, self.limit_hit)


class Position(msgspec.Struct, frozen=True, gc=False):
    """The result of one poll; an axis that was not polled keeps its last position."""

    exchange: Exchange
    pan_steps: int
    tilt_steps: int
    has_pan: bool
    has_tilt: bool
    is_still: bool | None  # both speeds 0 according to BT; None if the reply has no speeds
    counter: int | None
    earliest_ns: int  # the unit read its position after this
    latest_ns: int  # and before this
    synchrony_lost: bool


@dataclass(slots=True)
class PtuLineCounts:
    """Faults of the unit's line by cause."""

    timeouts: int = 0
    garbled: int = 0
    stale: int = 0
    frame_errors: int = 0
    refused: int = 0
    limit_flags: int = 0
    hung_up: int = 0
    implausible: int = 0  # positions that no command can explain
    exchanges: int = 0
    polls: int = 0
    reply_wait_max_ns: int = field(default=0)  # of all commands; homing replies when it is done
    poll_wait_max_ns: int = field(default=0)  # of polls only: the line and the unit's firmware
