"""Applying a calibration to a text table: a copy with columns of the true rates.

What to use when: `apply_to_table` for a CSV file of any length. The text of the table is
copied unchanged; three columns are added on the right. Rows are processed in blocks, so that
memory does not grow with the length.
"""

import csv
import errno
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import BinaryIO, TextIO

import numpy as np

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_solver.apply.board_calibration import Calibration, ReadingUnit
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.text_table import (
    check_column_names,
    check_row_width,
    check_text_table,
)

RATE_COLUMNS = ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s")
TIME_COLUMN = "time_of_motion_s"
ROWS_PER_BLOCK = 100_000
MAX_HEADER_CHARS = 100_000
_RATE_FORMAT = "%.9g"  # a rate of 10 rad/s to 1e-8: below the quantum of any gyro
TIME_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


@dataclass(frozen=True, slots=True)
class TableColumns:
    """The names of the columns to read."""

    gyro: tuple[str, str, str]
    unit: ReadingUnit = "counts"
    temperature: str | None = None  # degC
    time: str | None = None  # adds a column with the time of the motion
    time_unit: str = "s"

    @property
    def names(self) -> list[str]:
        """All columns to read, in reading order."""
        return [*self.gyro, *(n for n in (self.temperature, self.time) if n is not None)]


@dataclass(frozen=True, slots=True)
class TableSummary:
    """Counts of what was written."""

    rows: int
    outside: int  # rates above the range of the calibration's recordings
    without: int  # rows with a reading that is not a number; their rates stay empty
    outside_range: int = 0  # rows at temperatures outside the valid range; their rates stay empty
    outside_warmth: int = 0  # rows at temperatures outside that of a constant bias
    without_time: int = (
        0  # rows with rates and without a time; their time of the motion stays empty
    )


def apply_to_table(
    calibration: Calibration, source: Path, out: Path, columns: TableColumns
) -> TableSummary:
    """Write `source` to `out` with columns of the true rates, in rad/s.

    Raises:
        InputError: `source` is not a table, or a column is missing or occurs more than once.
        UsageError: `out` exists, or a needed column is not given.
        MachineError: the disk cannot be written; no file remains.
    """
    if out.exists():
        raise UsageError(f"the output file {out} already exists", "choose another file with -o")
    if calibration.correction.needs_force:
        raise UsageError(
            "the calibration contains g_sensitivity, which needs accelerometer data, but a "
            "table cannot provide these data",
            "apply the calibration to a recording, or solve the board again with `--extend none`",
        )
    if calibration.correction.needs_temperature and columns.temperature is None:
        raise UsageError(
            "the calibration depends on the temperature, but no column of the table is "
            "named as the temperature",
            "give the column of the temperature with --temperature",
        )
    temporary: Path | None = None
    with open_table(source) as lines:
        try:
            handle, name = tempfile.mkstemp(prefix=f".{out.name}.", dir=out.parent)
            temporary = Path(name)
            with os.fdopen(
                handle, "w", encoding="utf-8", errors="surrogateescape", newline=""
            ) as target:
                summary = _TableWriter(calibration, source.name, columns).copy(lines, target)
                os.fchmod(target.fileno(), 0o644)
            temporary.replace(out)
        except OSError as fault:
            raise MachineError(
                f"the output file {out} cannot be written ({fault.strerror})",
                _write_remedy(fault),
            ) from fault
        finally:
            if temporary is not None:
                with suppress(FileNotFoundError):
                    temporary.unlink()
    return summary


def print_table(
    calibration: Calibration, source: Path, target: BinaryIO, columns: TableColumns
) -> TableSummary:
    """Write `source` with columns of the true rates to an open stream.

    Nothing is written if the table is refused.

    Raises:
        InputError, UsageError, MachineError: as `apply_to_table`.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "table.csv"
        summary = apply_to_table(calibration, source, copy, columns)
        with copy.open("rb") as file:
            shutil.copyfileobj(file, target)
        target.flush()
    return summary


def open_table(source: Path) -> TextIO:
    """Return an open text table.

    Raises:
        InputError: the file cannot be read, or is of another kind.
    """
    try:
        check_text_table(source)
        return source.open(encoding="utf-8-sig", errors="surrogateescape", newline="")
    except OSError as fault:
        raise InputError(
            f"the table {source} cannot be read ({fault.strerror})",
            "give the path of a readable table (CSV)",
        ) from fault


def _write_remedy(fault: OSError) -> str:
    if fault.errno in (errno.ENOSPC, errno.EDQUOT):
        return "free some disk space, or choose another file with -o"
    return "choose another file with -o, in a folder that exists and that you can write"


class _TableWriter:
    """Copies one table and adds the corrected columns."""

    def __init__(self, calibration: Calibration, name: str, columns: TableColumns) -> None:
        self._calibration, self._name, self._columns = calibration, name, columns
        low, high = calibration.document.validity.rate_rad_s
        self._limit_rad_s = max(abs(low), abs(high))

    def copy(self, lines: TextIO, target: TextIO) -> TableSummary:
        """Copy the header and the rows, and append the rates."""
        header = lines.readline(MAX_HEADER_CHARS)
        delimiter = max(",;\t", key=header.count)
        names = [name.strip() for name in self._split(header, delimiter, 1)]
        column_indices = self._column_indices(names)
        added = [*RATE_COLUMNS, *([TIME_COLUMN] if self._columns.time else [])]
        existing = [name for name in added if name in names]
        if existing:
            raise InputError(
                f"the table {self._name} already contains calibrated data (column {existing[0]})",
                "apply the calibration to the original table",
            )
        target.write(header.rstrip("\r\n") + delimiter + delimiter.join(added) + "\n")
        rows = outside = without = outside_range = outside_warmth = without_time = 0
        row_text = delimiter.join([_RATE_FORMAT] * 3 + (["%.9f"] if self._columns.time else []))
        rate_text = delimiter.join([_RATE_FORMAT] * 3)
        empty = delimiter * (len(added) - 1)
        for block in _blocks(lines):
            values = self._parse_block(block, delimiter, column_indices, rows)
            self._check_widths(block, delimiter, len(names), rows)
            corrected = self._corrected(values)
            is_invalid = ~np.isfinite(corrected[:, :3]).all(axis=1)
            has_no_time = ~is_invalid & ~np.isfinite(corrected).all(axis=1)
            outside += int(
                np.sum(np.abs(corrected[~is_invalid, :3]).max(axis=1) > self._limit_rad_s)
            )
            is_outside = self._is_outside_range(values)
            outside_range += int(is_outside.sum())
            outside_warmth += self._count_outside_warmth(values)
            without += int((is_invalid & ~is_outside).sum())
            cells = [row_text % tuple(row) for row in corrected.tolist()]
            for at in np.flatnonzero(is_invalid).tolist():
                cells[at] = empty
            for at in np.flatnonzero(has_no_time).tolist():
                cells[at] = rate_text % tuple(corrected[at, :3].tolist()) + delimiter
            without_time += int(has_no_time.sum())
            target.write(
                "".join(
                    f"{line}{delimiter}{text}\n" for line, text in zip(block, cells, strict=True)
                )
            )
            rows += len(block)
        if not rows:
            raise InputError(
                f"the table {self._name} has a header, but no rows",
                "give a table that contains readings",
            )
        if outside_range == rows:
            low, high = self._calibration.correction.temperature_range_degc or (np.nan, np.nan)
            raise InputError(
                f"all temperatures in the table {self._name} are outside {low:.1f} to {high:.1f} "
                "degC, the valid range of the calibration",
                "record the board at rest at these temperatures, and solve again",
            )
        return TableSummary(rows, outside, without, outside_range, outside_warmth, without_time)

    def _is_outside_range(self, values: FloatArray) -> BoolArray:
        """Return the rows at temperatures outside the valid range, (n,)."""
        if self._columns.temperature is None:
            return np.zeros(len(values), dtype=np.bool_)
        covered = self._calibration.correction.covers(values[:, 3])
        return np.asarray(np.isfinite(values[:, 3]) & ~covered, dtype=np.bool_)

    def _count_outside_warmth(self, values: FloatArray) -> int:
        """Return how many rows are outside the temperatures of a constant bias."""
        low_high = self._calibration.document.validity.temperature_degc
        is_constant = not self._calibration.correction.needs_temperature
        if self._columns.temperature is None or low_high is None or not is_constant:
            return 0
        degc = values[:, 3]
        return int(np.sum((degc < low_high[0]) | (degc > low_high[1])))

    def _column_indices(self, names: Sequence[str]) -> list[int]:
        for name in self._columns.names:
            if name not in names:
                column_names = ", ".join(n[:40] for n in names[:12]) or "nothing"
                raise InputError(
                    f"the table {self._name} has no column {name!r}",
                    f"choose one of the columns {column_names}",
                )
        check_column_names(names, self._columns.names, self._name)
        return [names.index(name) for name in self._columns.names]

    def _split(self, line: str, delimiter: str, number: int) -> list[str]:
        try:
            return next(csv.reader(StringIO(line), delimiter=delimiter), [])
        except csv.Error as fault:
            raise InputError(
                f"row {number} of the table {self._name} cannot be read ({fault})",
                "correct or remove the row",
            ) from fault

    def _check_widths(
        self, block: Sequence[str], delimiter: str, width: int, rows_before: int
    ) -> None:
        """Check that each row has the cells of the header; count the delimiters first."""
        for number, line in enumerate(block, start=rows_before + 1):
            if line.count(delimiter) == width - 1:
                continue
            cells = self._split(line, delimiter, number)
            check_row_width(len(cells), width, number, self._name)

    def _parse_block(
        self, block: Sequence[str], delimiter: str, column_indices: Sequence[int], rows_before: int
    ) -> FloatArray:
        """Return the columns of some rows, shape (n, k); nan for an empty cell."""
        try:
            return np.loadtxt(
                block,
                delimiter=delimiter,
                usecols=column_indices,
                ndmin=2,
                comments=None,
                quotechar='"',
            )
        except (ValueError, IndexError):  # an empty cell, or a row that is cut
            return np.array(
                [
                    self._parse_row(line, delimiter, column_indices, rows_before + k)
                    for k, line in enumerate(block)
                ]
            )

    def _parse_row(
        self, line: str, delimiter: str, column_indices: Sequence[int], number: int
    ) -> list[float]:
        cells = self._split(line, delimiter, number + 1)
        if max(column_indices) >= len(cells):
            raise InputError(
                f"row {number + 1} of the table {self._name} has only {len(cells)} columns",
                "correct or remove the row, which may be incomplete",
            )
        return [
            self._parse_cell(cells[at], name, number)
            for at, name in zip(column_indices, self._columns.names, strict=True)
        ]

    def _parse_cell(self, text: str, column: str, number: int) -> float:
        try:
            return float(text) if text.strip() else float("nan")
        except ValueError as error:
            raise InputError(
                f"row {number + 1} of the table {self._name} has {text[:40]!r} in the column "
                f"{column}, which is not a number",
                "correct the cell, or leave it empty",
            ) from error

    def _corrected(self, values: FloatArray) -> FloatArray:
        """Return the rates, and the times if requested, shape (n, 3) or (n, 4)."""
        columns = self._columns
        temperature = values[:, 3] if columns.temperature is not None else None
        rates = self._calibration.rates(
            values[:, :3], columns.unit, temperature_degc=temperature, outside="nan"
        )
        if columns.time is None:
            return rates
        times = self._calibration.times(values[:, -1] * TIME_UNITS_S[columns.time_unit])
        return np.column_stack([rates, times])


def _blocks(lines: TextIO) -> Iterator[list[str]]:
    """Yield blocks of rows without line ends and without empty rows."""
    while block := list(islice(lines, ROWS_PER_BLOCK)):
        if rows := [line.rstrip("\r\n") for line in block if line.strip()]:
            yield rows
