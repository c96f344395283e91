"""Losses of a recording: data that the reader could not return, by cause.

What to use when: `Recording.losses` has them; test `cause`, print `text`.
"""

from dataclasses import dataclass
from enum import StrEnum


class LossCause(StrEnum):
    """Why data of a recording are missing."""

    UNFINISHED = "unfinished"  # the writer never closed the file; no data need be missing
    TRUNCATED = "truncated"  # the file ends inside a record
    DAMAGED = "damaged"  # bytes that are not a record, or a record with a wrong checksum
    REFUSED = "refused"  # a chunk that declares more unpacked bytes than allowed
    MESSAGE = "message"  # a valid record whose bytes are not a message of its type
    SUMMARY = "summary"  # the summary at the end; no message is lost
    METADATA = "metadata"  # a metadata record differs from its checksummed copy
    MISSING = "missing"  # the file counts more messages than could be read


@dataclass(frozen=True, slots=True)
class Loss:
    """One loss."""

    cause: LossCause
    offset: int  # where it begins in the file
    bytes: int  # of the file that could not be used
    messages: int | None  # None: unknown
    text: str  # one line for people
