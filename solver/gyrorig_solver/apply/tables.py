"""A calibration applied to a text table: the same table, with the true rates beside it.

What to use when: `apply_to_table` for a CSV file, of any length. The table's own text stays
as it is, to the last digit; three columns are added behind it. It is worked through in
blocks, so memory does not grow with its length.
"""

import csv
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_solver.apply.calibration import Calibration, Unit
from gyrorig_solver.arrays import FloatArray

RATES = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
TIME = "time_of_motion_s"
ROWS_AT_A_TIME = 100_000
MAX_HEADER_CHARS = 100_000
_DIGITS = "%.9g"  # a rate of 10 rad/s to 1e-8: below the quantum of any gyro
TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, slots=True)
class TableColumns:
    """Which column is what."""

    gyro: tuple[str, str, str]
    unit: Unit = "counts"
    temperature: str | None = None  # degC
    time: str | None = None  # adds the time at which the motion was so
    time_unit: str = "s"

    @property
    def names(self) -> list[str]:
        """All that are read, in the order in which they are read."""
        return [*self.gyro, *(n for n in (self.temperature, self.time) if n is not None)]


@dataclass(frozen=True, slots=True)
class TableApplied:
    """What became of a table."""

    rows: int
    outside: int  # rates that the calibration's recordings did not cover
    without: int  # rows where a reading is no number: their rates are left empty


def apply_to_table(
    calibration: Calibration, source: Path, out: Path, columns: TableColumns
) -> TableApplied:
    """Write `source` to `out` with columns of the true rates, in rad/s.

    Raises:
        InputError: `source` is no such table, or a column is missing.
        UsageError: `out` exists, or the calibration asks for a column that is not given.
        MachineError: the disk refused; nothing is left.
    """
    if out.exists():
        raise UsageError(f"{out} exists", "name a file that does not, with -o")
    if calibration.correction.needs_force:
        raise UsageError(
            "this calibration depends on the specific force, which a table does not carry",
            "apply it to a recording, or solve without g_sensitivity",
        )
    if calibration.correction.needs_temperature and columns.temperature is None:
        raise UsageError(
            "this calibration depends on the temperature", "name its column with --temperature"
        )
    temporary: Path | None = None
    try:
        lines = source.open(encoding="utf-8", errors="surrogateescape", newline="")
    except OSError as fault:
        raise InputError(
            f"cannot read {source}, {fault.strerror}", "name a table (CSV) that can be read"
        ) from fault
    with lines:
        try:
            handle, name = tempfile.mkstemp(prefix=f".{out.name}.", dir=out.parent)
            temporary = Path(name)
            with os.fdopen(
                handle, "w", encoding="utf-8", errors="surrogateescape", newline=""
            ) as target:
                done = _Table(calibration, source.name, columns).copied(lines, target)
                os.fchmod(target.fileno(), 0o644)
            temporary.replace(out)
        except OSError as fault:
            raise MachineError(
                f"cannot write {out}, {fault.strerror}", "make space, or name another with -o"
            ) from fault
        finally:
            if temporary is not None:
                with suppress(FileNotFoundError):
                    temporary.unlink()
    return done


class _Table:
    """One table on its way."""

    def __init__(self, calibration: Calibration, name: str, columns: TableColumns) -> None:
        self._calibration, self._name, self._columns = calibration, name, columns
        low, high = calibration.document.validity.rate_rad_s
        self._limit_rad_s = max(abs(low), abs(high))

    def copied(self, lines: TextIO, target: TextIO) -> TableApplied:
        """Copy header and rows, each with its rates."""
        header = lines.readline(MAX_HEADER_CHARS)
        delimiter = max(",;\t", key=header.count)
        names = [n.strip() for n in next(csv.reader(StringIO(header), delimiter=delimiter), [])]
        places = self._places(names)
        added = [*RATES, *([TIME] if self._columns.time else [])]
        taken = [name for name in added if name in names]
        if taken:
            raise InputError(
                f"{self._name} has a column {taken[0]} already: a calibration was applied to it",
                "apply to the table that it was made of",
            )
        target.write(header.rstrip("\r\n") + delimiter + delimiter.join(added) + "\n")
        rows = outside = without = 0
        row_text = delimiter.join([_DIGITS] * 3 + (["%.9f"] if self._columns.time else []))
        empty = delimiter * (len(added) - 1)
        for block in _blocks(lines):
            values = self._numbers(block, delimiter, places, rows)
            found = self._found(values)
            bad = ~np.isfinite(found).all(axis=1)
            outside += int(np.sum(np.abs(found[~bad, :3]).max(axis=1) > self._limit_rad_s))
            without += int(bad.sum())
            told = [row_text % tuple(row) for row in found.tolist()]
            for at in np.flatnonzero(bad).tolist():
                told[at] = empty
            target.write(
                "".join(
                    f"{line}{delimiter}{text}\n" for line, text in zip(block, told, strict=True)
                )
            )
            rows += len(block)
        if not rows:
            raise InputError(f"{self._name} has a header and no rows", "name a table with readings")
        return TableApplied(rows, outside, without)

    def _places(self, names: Sequence[str]) -> list[int]:
        """Return where the wanted columns are."""
        for name in self._columns.names:
            if name not in names:
                some = ", ".join(n[:40] for n in names[:12]) or "nothing"
                raise InputError(
                    f"{self._name} has no column {name!r}", f"name one that it has: {some}"
                )
        return [names.index(name) for name in self._columns.names]

    def _numbers(
        self, block: Sequence[str], delimiter: str, places: Sequence[int], before: int
    ) -> FloatArray:
        """Return the wanted columns of some rows, shape (n, k); nan where a cell is empty."""
        try:
            return np.loadtxt(
                block, delimiter=delimiter, usecols=places, ndmin=2, comments=None, quotechar='"'
            )
        except (ValueError, IndexError):  # an empty cell, or a row that is cut
            return np.array(
                [self._row(line, delimiter, places, before + k) for k, line in enumerate(block)]
            )

    def _row(self, line: str, delimiter: str, places: Sequence[int], number: int) -> list[float]:
        cells = next(csv.reader([line], delimiter=delimiter), [])
        if max(places) >= len(cells):
            raise InputError(
                f"{self._name}: row {number + 1} has {len(cells)} columns",
                "it may be cut off: correct it or remove it",
            )
        return [
            self._cell(cells[at], name, number)
            for at, name in zip(places, self._columns.names, strict=True)
        ]

    def _cell(self, text: str, column: str, number: int) -> float:
        try:
            return float(text) if text.strip() else float("nan")
        except ValueError as error:
            raise InputError(
                f"{self._name}: row {number + 1}: {text[:40]!r} in column {column} is no number",
                "correct it or leave it empty",
            ) from error

    def _found(self, values: FloatArray) -> FloatArray:
        """Return rates, and times where they are asked for, of rows of numbers."""
        columns = self._columns
        warmth = values[:, 3] if columns.temperature is not None else None
        rates = self._calibration.rates(values[:, :3], columns.unit, temperature_degc=warmth)
        if columns.time is None:
            return rates
        times = self._calibration.times(values[:, -1] * TIME_UNITS_S[columns.time_unit])
        return np.column_stack([rates, times])


def _blocks(lines: TextIO) -> Iterator[list[str]]:
    """Yield rows without their ends, some at a time; empty ones are left out."""
    while block := list(islice(lines, ROWS_AT_A_TIME)):
        yield [line.rstrip("\r\n") for line in block if line.strip()]
