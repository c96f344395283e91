"""Measured columns that stay counts until physical values are requested.

What to use when: `CountColumn` for counts with their scale; `PhysicalField` for a field of a frozen
dataclass that accepts values or a `CountColumn`, and returns values.

The reason is memory: 8 h at 800 Hz are 138 MB of 16-bit rates, and 553 MB of rad/s.
"""

from collections.abc import Callable
from typing import Any, Generic, TypeVar, cast, overload

import numpy as np
from numpy.typing import NDArray

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray

CountArray = NDArray[Any]  # integers of any width; floats if the source has no counts
MAX_CACHED_ROWS = 1 << 20  # the values of more rows are not cached

T = TypeVar("T", FloatArray, FloatArray | None)


class CountColumn:
    """Counts with scale and offset.

    Args:
        counts: shape (n,) or (n, 3), or a function that loads them at their first use.
        scale: physical units per count.
        offset: value of count zero.
        valid: mask of the rows with a value, shape (n,); None: all rows.
    """

    __slots__ = ("_counts", "_load", "offset", "scale", "valid")

    def __init__(
        self,
        counts: CountArray | Callable[[], CountArray],
        scale: float = 1.0,
        offset: float = 0.0,
        valid: BoolArray | None = None,
    ) -> None:
        self._load = counts if callable(counts) else None
        self._counts: CountArray | None = None if callable(counts) else counts
        self.scale, self.offset, self.valid = scale, offset, valid

    @property
    def counts(self) -> CountArray:
        """The counts as sent by the board."""
        if self._counts is None and self._load is not None:
            self._counts = self._load()
        return cast(CountArray, self._counts)

    def values(self, rows: slice | IntArray | BoolArray = slice(None)) -> FloatArray:
        """Return physical values of some rows, NaN for a missing value."""
        values: FloatArray = self.counts[rows] * self.scale
        if self.offset:
            values += self.offset
        if self.valid is not None:
            values[~self.valid[rows]] = np.nan
        return values


class PhysicalField(Generic[T]):
    """A field of a frozen dataclass that is given as values or as a `CountColumn`."""

    def __set_name__(self, owner: type, name: str) -> None:
        """Store the name of the field."""
        self._name = name

    def __set__(self, owner: object, value: T | CountColumn) -> None:
        """Store values or a column; a frozen dataclass does this once."""
        owner.__dict__[self._name] = value

    @overload
    def __get__(self, owner: None, kind: type) -> "PhysicalField[T]": ...

    @overload
    def __get__(self, owner: object, kind: type) -> T: ...

    def __get__(self, owner: object | None, kind: type) -> "PhysicalField[T] | T":
        """Return physical values."""
        if owner is None:
            raise AttributeError(self._name)  # shows dataclass that the field has no default
        stored = owner.__dict__[self._name]
        if not isinstance(stored, CountColumn):
            return cast(T, stored)
        cache_key = f"{self._name}, values"
        if cache_key in owner.__dict__:
            return cast(T, owner.__dict__[cache_key])
        values = stored.values()
        if len(values) <= MAX_CACHED_ROWS:
            owner.__dict__[cache_key] = values
        return values


def stored_column(owner: object, name: str) -> CountColumn | None:
    """Return a `PhysicalField` field as a column, None if it was given as None."""
    stored = owner.__dict__[name]
    return stored if stored is None or isinstance(stored, CountColumn) else CountColumn(stored)
