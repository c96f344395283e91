"""What a pan-tilt unit's byte stream can hold, one frozen record each.

What to use when: `match` on these in whatever drives `PtuReplyParser`. A `Reply` is
the only event that answers a command; a `LimitFlag` outside a reset means that steps
were lost; everything else is for the log and the counters.
"""

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TypeAlias


class Axis(StrEnum):
    """An axis of the unit; the value is its letter in commands and flags."""

    PAN = "P"
    TILT = "T"

    @property
    def word(self) -> str:
        """The axis as verbose replies name it, in lower case."""
        return "pan" if self is Axis.PAN else "tilt"


class FrameReason(Enum):
    """Why bytes were no reply; the value says it in words."""

    OVERSIZE = "the line is longer than the limit"
    NOT_ASCII = "the line holds bytes that are not printable ASCII"
    NO_STATUS = "the line has neither * nor !, and is no banner"
    FOREIGN_PREFIX = "what stands before * or ! is neither an echo nor a banner"
    OTHER_ECHO = "the echo is not of the command that was sent"
    TWO_REPLIES = "two status marks in one line: a line end was lost"


@dataclass(frozen=True, slots=True)
class Reply:
    """One answer: `*` and what follows, or `!` and the error's text.

    `first_byte_ns` belongs to the status mark, not to the echo before it: the mark is
    the first byte that the controller sends because of the command.
    """

    ok: bool
    text: str  # after the mark, without spaces around it
    echo: str  # the echoed command, "" with echo off
    raw: bytes  # the whole line with its line end, limit flags taken out
    first_byte_ns: int
    last_byte_ns: int


@dataclass(frozen=True, slots=True)
class LimitFlag:
    """`!P` or `!T`: an axis met its limit. It may stand anywhere, without a line end."""

    axis: Axis
    received_ns: int


@dataclass(frozen=True, slots=True)
class CableFlag:
    """`!D`: the head's cable came off."""

    received_ns: int


@dataclass(frozen=True, slots=True)
class Echo:
    """A line that holds only an echoed command, as a CR delimiter produces it."""

    text: str
    last_byte_ns: int


@dataclass(frozen=True, slots=True)
class Banner:
    """A line of the power-up greeting, the menu, or a version that wraps."""

    text: str
    last_byte_ns: int


@dataclass(frozen=True, slots=True)
class FrameError:
    """Bytes that are none of the above. `raw` is at most `max_line_bytes` long."""

    reason: FrameReason
    raw: bytes
    last_byte_ns: int


PtuEvent: TypeAlias = Reply | LimitFlag | CableFlag | Echo | Banner | FrameError
