"""What passes between the daemon and a unit, and what goes wrong meanwhile, as values."""

from dataclasses import dataclass, field

from gyrorig_protocol.ptu import PtuCommand, Reply


@dataclass(frozen=True, slots=True)
class Exchange:
    """One command and what came back, with stamps on the raw monotonic clock."""

    command: PtuCommand
    request_ns: int  # just before the first byte is written
    sent_ns: int  # the last byte handed over
    first_byte_ns: int  # equal to reply_ns where nothing came
    reply_ns: int
    reply: Reply | None  # None: no answer in time, or garbage
    raw: bytes  # everything received meanwhile
    limit_hit: bool


@dataclass(frozen=True, slots=True)
class Position:
    """What one poll answered; an axis that was not asked keeps its last answer."""

    exchange: Exchange
    pan_steps: int
    tilt_steps: int
    has_pan: bool
    has_tilt: bool
    still: bool | None  # what BT says of the speeds; None where the answer has none
    counter: int | None
    earliest_ns: int  # the answer was taken after this
    latest_ns: int  # and before this
    synchrony_lost: bool


@dataclass(slots=True)
class Counts:
    """What went wrong on the unit's line, by cause."""

    timeouts: int = 0
    garbled: int = 0
    stale: int = 0
    frame_errors: int = 0
    refused: int = 0
    limit_flags: int = 0
    hung_up: int = 0
    implausible: int = 0  # positions that no order can have brought about
    exchanges: int = 0
    polls: int = 0
    reply_wait_max_ns: int = field(default=0)  # of all: a homing answers when it is done
    poll_wait_max_ns: int = field(default=0)  # of polls alone: the line and the unit's program
