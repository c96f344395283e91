"""What a fuzz target is, and what it means that one fails."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from gyrorig_protocol.errors import GyrorigError

LONGEST_ERROR = 2000


class BrokenError(AssertionError):
    """A promise of a parser's docstring does not hold."""


@dataclass(frozen=True, slots=True)
class Target:
    """One entrance for bytes of strangers.

    `run` returns for every input; it raises where the parser raised what it may not, or
    `BrokenError`. `seeds` are inputs to begin with, made when they are wanted.
    """

    name: str
    run: Callable[[bytes], None]
    seeds: Callable[[], Sequence[bytes]]
    max_bytes: int = 2048


def promise(holds: bool, what: str) -> None:
    """Raise where something that was promised does not hold."""
    if not holds:
        raise BrokenError(what)


def refused(parse: Callable[[bytes], object], error: type[GyrorigError], data: bytes) -> None:
    """See that `parse` returns, or raises the one error, in one line."""
    try:
        parse(data)
    except error as fault:
        one_line(fault)


def one_line(fault: GyrorigError) -> None:
    """See that an error's text is one line with an end."""
    promise("\n" not in str(fault), "an error of several lines")
    promise(len(str(fault)) < LONGEST_ERROR, "an error without end")


def pieces(data: bytes) -> Iterator[bytes]:
    """Cut `data` where its own bytes say, so that the fuzzer finds the cuts that matter."""
    at = 0
    while at < len(data):
        end = at + 1 + data[at] % 7
        yield data[at:end]
        at = end
