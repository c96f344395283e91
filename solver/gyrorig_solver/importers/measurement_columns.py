"""Columns of numbers from text tables and NumPy archives.

What to use when: `open_columns` selects the reader by the file name; `matrix` returns float64
arrays. The size of the input is checked before it is loaded, nothing in it is executed, and
every defect is an `InputError` of one line.
"""

import csv
import warnings
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from itertools import islice
from pathlib import Path
from typing import Protocol

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.text_table import check_text_table

# A row takes about 200 bytes (measured on 2 million rows): ten million rows take 2 GB.
MAX_ROWS = 10_000_000
MAX_ARCHIVE_BYTES = 4_000_000_000
ROWS_AT_A_TIME = 200_000
MAX_HEADER_CHARS = 100_000
MAX_LISTED_NAMES = 12  # names listed in an error
_ARRAY_REMEDY = "save the array with numpy.savez as floats or integers"


class MeasurementColumns(Protocol):
    """The named columns of a file."""

    def matrix(self, keys: Sequence[str], width: int) -> FloatArray:
        """Return one array of `width` columns, or `width` single columns joined."""
        ...


def open_columns(path: Path, wanted: Sequence[str]) -> MeasurementColumns:
    """Open a table for the columns that a map asks for.

    Raises:
        InputError: the file cannot be read, lacks a column, or is too large.
    """
    if not path.is_file():
        problem = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(
            f"the file of measurements {path} {problem}",
            "give the path of one file with measurements",
        )
    if path.stat().st_size == 0:
        raise InputError(f"the file {path.name} is empty", "give a file with measurements")
    try:
        if path.suffix == ".npz":
            return _ArchiveColumns(path, wanted)
        check_text_table(path)
        return _TableColumns(path, wanted)
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, MemoryError) as error:
        raise InputError(
            f"the file {path.name} cannot be read ({_one_line(error)})",
            "copy the file again from its source",
        ) from error


class _ArchiveColumns:
    """A NumPy archive; only the requested arrays are loaded."""

    def __init__(self, path: Path, wanted: Sequence[str]) -> None:
        with zipfile.ZipFile(path) as archive:
            size = {i.filename.removesuffix(".npy"): i.file_size for i in archive.infolist()}
        missing = [key for key in wanted if key not in size]
        if missing:
            raise InputError(
                f"the file {path.name} contains no array {missing[0]!r}",
                f"in the import map, choose one of the arrays {_list_names(size)}",
            )
        if sum(size[key] for key in set(wanted)) > MAX_ARCHIVE_BYTES:
            raise InputError(
                f"the arrays in the file {path.name} need more than 4 GB of memory",
                "split the file, and import each part",
            )
        self._arrays: dict[str, FloatArray] = {}
        with np.load(path, allow_pickle=False) as loaded:
            for key in dict.fromkeys(wanted):
                try:
                    values = loaded[key]
                except ValueError as error:  # objects; pickles are never opened
                    raise InputError(
                        f"in the file {path.name}, the array {key} contains objects instead "
                        "of numbers",
                        _ARRAY_REMEDY,
                    ) from error
                if values.dtype.kind not in "biuf":
                    raise InputError(
                        f"in the file {path.name}, the array {key} contains {values.dtype} "
                        "values instead of real numbers",
                        _ARRAY_REMEDY,
                    )
                self._arrays[key] = values.astype(np.float64)
        self._name = path.name

    def matrix(self, keys: Sequence[str], width: int) -> FloatArray:
        parts = [self._arrays[key] for key in keys]
        columns = [part.reshape(-1, 1) if part.ndim < 2 else part for part in parts]
        if len({part.shape[0] for part in columns}) != 1 or any(p.ndim != 2 for p in columns):
            sizes = " and ".join(str(part.shape[0]) for part in columns)
            raise InputError(
                f"in the file {self._name}, the columns {_list_names(keys)} have different "
                f"lengths ({sizes} rows)",
                "name columns of equal length in the import map",
            )
        return _check_matrix(np.concatenate(columns, axis=1), keys, width, self._name)


class _TableColumns:
    """A text table, read in blocks; only the requested columns are kept."""

    def __init__(self, path: Path, wanted: Sequence[str]) -> None:
        self._name = path.name
        with path.open(encoding="utf-8", errors="replace", newline="") as lines:
            header = lines.readline(MAX_HEADER_CHARS)
            delimiter = max(",;\t", key=header.count)
            names = [
                name.strip() for name in next(csv.reader(StringIO(header), delimiter=delimiter), [])
            ]
            missing = [key for key in wanted if key not in names]
            if missing:
                raise InputError(
                    f"the table {path.name} has no column {missing[0]!r}",
                    f"in the import map, choose one of the columns {_list_names(names)}",
                )
            unique = list(dict.fromkeys(wanted))
            column_indices = [names.index(key) for key in unique]
            blocks = []
            rows = 0
            while block := list(islice(lines, ROWS_AT_A_TIME)):
                try:
                    blocks.append(_parse_rows(block, delimiter, column_indices))
                except (ValueError, IndexError) as error:
                    cells = {at: key for key, at in zip(unique, column_indices, strict=True)}
                    raise _bad_cell_error(path.name, block, delimiter, cells, rows) from error
                rows += len(block)
                if rows > MAX_ROWS:
                    raise InputError(
                        f"the file {path.name} has more than {MAX_ROWS} rows",
                        "split the file, and import each part",
                    )
        if not sum(len(block) for block in blocks):
            raise InputError(
                f"the table {path.name} has a header, but no rows", "give a file with measurements"
            )
        data = np.concatenate(blocks)
        self._columns = {key: data[:, i] for i, key in enumerate(unique)}

    def matrix(self, keys: Sequence[str], width: int) -> FloatArray:
        data = np.stack([self._columns[key] for key in keys], axis=1)
        return _check_matrix(data, keys, width, self._name)


def _parse_rows(rows: Sequence[str], delimiter: str, column_indices: Sequence[int]) -> FloatArray:
    """Return the requested columns of some rows, shape (n, k); empty rows are left out.

    Raises:
        ValueError: a cell is not a number.
        IndexError: a row is too short.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # loadtxt warns if all rows are empty
        values = np.loadtxt(
            rows,
            delimiter=delimiter,
            usecols=column_indices,
            ndmin=2,
            comments=None,
            quotechar='"',
            dtype=np.float64,
        )
    return values.reshape(-1, len(column_indices))


def _bad_cell_error(
    name: str, rows: Sequence[str], delimiter: str, cells: Mapping[int, str], rows_before: int
) -> InputError:
    """Return the error of the first cell that is not a number."""
    for number, line in enumerate(rows, start=rows_before + 1):
        try:
            row = next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error:
            return InputError(
                f"row {number} of the table {name} is not valid", "correct or remove the row"
            )
        if row and max(cells) >= len(row):
            return InputError(
                f"row {number} of the table {name} has only {len(row)} columns",
                "correct or remove the row, which may be incomplete",
            )
        for at, column in cells.items():
            try:
                float(row[at] if row else "nan")
            except ValueError:
                return InputError(
                    f"row {number} of the table {name} has {row[at][:40]!r} in the column "
                    f"{column[:40]}, which is not a number",
                    "correct the cell, or write nan for a missing value",
                )
    return InputError(
        f"the table {name} contains text instead of numbers",
        "write the numbers in the form 0.25 or -2.5e-3",
    )


def _check_matrix(data: FloatArray, keys: Sequence[str], width: int, name: str) -> FloatArray:
    if data.shape[1] != width:
        raise InputError(
            f"in the file {name}, {_list_names(keys)} has {data.shape[1]} columns, but "
            f"{width} columns are needed",
            f"name one array with {width} columns, or {width} single columns, in the import map",
        )
    if data.shape[0] > MAX_ROWS:
        raise InputError(
            f"the file {name} has more than {MAX_ROWS} rows", "split the file, and import each part"
        )
    return np.ascontiguousarray(data, dtype=np.float64)


def _list_names(names: Iterable[str]) -> str:
    shortened = [name[:40] for name in names]
    more = (
        f" and {len(shortened) - MAX_LISTED_NAMES} more"
        if len(shortened) > MAX_LISTED_NAMES
        else ""
    )
    return (", ".join(shortened[:MAX_LISTED_NAMES]) or "nothing") + more


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
