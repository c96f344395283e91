"""Parser events of a pan-tilt unit's byte stream.

What to use when: `match` on these classes after `PtuReplyParser.feed`. Only a `Reply` answers a
command. A `LimitFlag` outside a reset means that steps were lost. The other events are for the log
and the counters.
"""

from dataclasses import dataclass
from enum import Enum, StrEnum
from typing import TypeAlias


class Axis(StrEnum):
    """An axis of the pan-tilt unit; the value is its letter in commands and flags."""

    PAN = "P"
    TILT = "T"

    @property
    def label(self) -> str:
        """The name of the axis in verbose replies, in lower case."""
        return "pan" if self is Axis.PAN else "tilt"


class InvalidLineReason(Enum):
    """Why bytes are not a reply; the value is the text for people."""

    OVERSIZE = "the line is longer than the limit"
    NOT_ASCII = "the line contains bytes that are not printable ASCII"
    NO_STATUS = "the line has neither * nor !, and is not a banner"
    FOREIGN_PREFIX = "the text before * or ! is neither an echo nor a banner"
    OTHER_ECHO = "the echo is of another command"
    TWO_REPLIES = "the line contains two status marks, because a line end was lost"


@dataclass(frozen=True, slots=True)
class Reply:
    """One answer: `*` and a value, or `!` and the text of an error.

    `first_byte_ns` is the time of the status mark, not of the echo before it. The mark is the first
    byte that the controller sends because of the command.
    """

    ok: bool
    text: str  # after the mark, without spaces around it
    echo: str  # the echoed command, "" with echo off
    raw: bytes  # the whole line with its line end, limit flags taken out
    first_byte_ns: int
    last_byte_ns: int


@dataclass(frozen=True, slots=True)
class LimitFlag:
    """`!P` or `!T`: an axis reached its limit. It can be anywhere and has no line end."""

    axis: Axis
    received_ns: int


@dataclass(frozen=True, slots=True)
class CableFlag:
    """`!D`: the cable of the head is disconnected."""

    received_ns: int


@dataclass(frozen=True, slots=True)
class Echo:
    """A line with only an echoed command, as after a CR delimiter."""

    text: str
    last_byte_ns: int


@dataclass(frozen=True, slots=True)
class Banner:
    """A line of the power-up message, of the menu, or of a long version text."""

    text: str
    last_byte_ns: int


@dataclass(frozen=True, slots=True)
class InvalidLine:
    """A line that is none of the above. `raw` has at most `max_line_bytes`."""

    reason: InvalidLineReason
    raw: bytes
    last_byte_ns: int


PtuEvent: TypeAlias = Reply | LimitFlag | CableFlag | Echo | Banner | InvalidLine
