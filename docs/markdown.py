"""Tables, numbers and matrices as Markdown."""

from collections.abc import Iterable, Mapping
from typing import Protocol

import numpy as np

from gyrorig_solver.data import FloatArray


class Block(Protocol):
    """A function without arguments that returns a generated part of a document as Markdown."""

    def __call__(self) -> str: ...


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table of texts."""
    titles = list(head)
    lines = [titles, ["---"] * len(titles), *(list(row) for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def number(value: float, digits: int = 4) -> str:
    """Return a number with fixed digits, without a minus sign before zero."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def numbers(values: FloatArray | Iterable[float], digits: int = 4) -> str:
    """Return several numbers, separated by commas."""
    return ", ".join(number(float(value), digits) for value in values)


def matrix(values: FloatArray, digits: int = 4) -> str:
    """Return a matrix with its rows separated by semicolons, for example `[1 0; 0 1]`."""
    rows = (" ".join(number(float(v), digits) for v in row) for row in np.atleast_2d(values))
    return "[" + "; ".join(rows) + "]"


def show(blocks: Mapping[str, Block]) -> None:
    """Print every block of a script under its name."""
    for name, block in blocks.items():
        print(f"## {name}\n\n{block()}\n")
