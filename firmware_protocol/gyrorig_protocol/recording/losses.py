"""What a reader could not give back, by cause.

What to use when: `Recording.losses` holds them; branch on `cause`, print `text`.
"""

from dataclasses import dataclass
from enum import StrEnum


class LossCause(StrEnum):
    """Why something of a recording is missing."""

    UNFINISHED = "unfinished"  # the writer never closed the file; nothing else is implied
    TRUNCATED = "truncated"  # the file ends inside a record
    DAMAGED = "damaged"  # bytes that are no record, or a record with a wrong checksum
    REFUSED = "refused"  # a chunk that claims to unpack to more than is allowed
    MESSAGE = "message"  # sound bytes that are no message of their type
    SUMMARY = "summary"  # the index at the end; no message is lost by it
    METADATA = "metadata"  # a metadata record differs from its checksummed copy
    MISSING = "missing"  # the file's own count says that there was more


@dataclass(frozen=True, slots=True)
class Loss:
    """One piece that is missing."""

    cause: LossCause
    offset: int  # byte of the file where it begins
    bytes: int  # of the file that could not be used
    messages: int | None  # None: nobody can tell
    text: str  # one line for people
