"""Fuzz targets, and the guarantees that they check."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from gyrorig_protocol.errors import GyrorigError

MAX_ERROR_CHARS = 2000


class GuaranteeError(AssertionError):
    """A guarantee in a parser's docstring is violated."""


@dataclass(frozen=True, slots=True)
class Target:
    """One input for untrusted bytes.

    `run` returns for every input. It raises an error if the parser raised an unexpected error, or
    `GuaranteeError`. `seeds` returns the first inputs.
    """

    name: str
    run: Callable[[bytes], None]
    seeds: Callable[[], Sequence[bytes]]
    max_bytes: int = 2048


def require(holds: bool, guarantee: str) -> None:
    """Raise `GuaranteeError` if a guarantee is violated."""
    if not holds:
        raise GuaranteeError(guarantee)


def expect_rejection(
    parse: Callable[[bytes], object], error: type[GyrorigError], data: bytes
) -> None:
    """Check that `parse` returns, or raises this error with a text of one line."""
    try:
        parse(data)
    except error as fault:
        check_single_line(fault)


def check_single_line(fault: GyrorigError) -> None:
    """Check that the text of an error is one line of limited length."""
    require("\n" not in str(fault), "an error of several lines")
    require(len(str(fault)) < MAX_ERROR_CHARS, "an error without end")


def split_pieces(data: bytes) -> Iterator[bytes]:
    """Split `data` at positions given by its bytes, so that the fuzzer finds relevant splits."""
    index = 0
    while index < len(data):
        end = index + 1 + data[index] % 7
        yield data[index:end]
        index = end
