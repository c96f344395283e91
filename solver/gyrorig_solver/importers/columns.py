"""Columns of numbers out of files that others wrote: text tables and NumPy archives.

What to use when: `open_columns` picks the reader by the file's name; `column` and
`matrix` return float64 arrays. Input is bounded before it is loaded, nothing in it is
executed, and whatever is wrong with it is an `InputError` of one line.
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
from gyrorig_solver.arrays import FloatArray

# About 200 bytes a row are held (measured on 2 million rows): ten million take 2 GB.
MAX_ROWS = 10_000_000
MAX_ARCHIVE_BYTES = 4_000_000_000
ROWS_AT_A_TIME = 200_000
MAX_HEADER_CHARS = 100_000
MANY = 12  # names that an error lists
_NUMBERS = "save it as an array of numbers: numpy.savez with float or integer arrays"


class Columns(Protocol):
    """A file's named numbers."""

    def matrix(self, keys: Sequence[str], width: int) -> FloatArray:
        """Return one array of `width` columns, or `width` single ones, side by side."""
        ...


def open_columns(path: Path, wanted: Sequence[str]) -> Columns:
    """Open a table for the columns that a map asks for.

    Args:
        path: `.npz`, or a text table with a header line (`.csv`, `.tsv`, `.txt`).
        wanted: names of all columns that will be asked for.

    Raises:
        InputError: not such a file, a column is missing, or it is too large.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(f"{path} {what}", "name one file of measurements")
    if path.stat().st_size == 0:
        raise InputError(f"{path.name} is empty", "name a file with measurements")
    try:
        if path.suffix == ".npz":
            return _Archive(path, wanted)
        return _Table(path, wanted)
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, MemoryError) as error:
        raise InputError(
            f"cannot read {path.name}, {_line(error)}", "copy it again from where it was made"
        ) from error


class _Archive:
    """A NumPy archive; only the wanted arrays are loaded."""

    def __init__(self, path: Path, wanted: Sequence[str]) -> None:
        with zipfile.ZipFile(path) as archive:
            size = {i.filename.removesuffix(".npy"): i.file_size for i in archive.infolist()}
        missing = [key for key in wanted if key not in size]
        if missing:
            raise InputError(
                f"{path.name} has no {missing[0]!r}",
                f"name one in the map that it has: {_some(size)}",
            )
        if sum(size[key] for key in set(wanted)) > MAX_ARCHIVE_BYTES:
            raise InputError(
                f"{path.name} unpacks to more than 4 GB", "split it, and import each part"
            )
        self._arrays: dict[str, FloatArray] = {}
        with np.load(path, allow_pickle=False) as loaded:
            for key in dict.fromkeys(wanted):
                try:
                    found = loaded[key]
                except ValueError as error:  # objects: pickles are never opened
                    raise InputError(
                        f"{path.name}: {key} holds no numbers but objects", _NUMBERS
                    ) from error
                if found.dtype.kind not in "biuf":
                    raise InputError(
                        f"{path.name}: {key} holds no numbers but {found.dtype}", _NUMBERS
                    )
                self._arrays[key] = found.astype(np.float64)
        self._name = path.name

    def matrix(self, keys: Sequence[str], width: int) -> FloatArray:
        parts = [self._arrays[key] for key in keys]
        columns = [part.reshape(-1, 1) if part.ndim < 2 else part for part in parts]
        if len({part.shape[0] for part in columns}) != 1 or any(p.ndim != 2 for p in columns):
            sizes = " and ".join(str(part.shape[0]) for part in columns)
            raise InputError(
                f"{self._name}: {_some(keys)} differ in length ({sizes}), or are no columns",
                "name columns of one length in the map",
            )
        return _checked(np.concatenate(columns, axis=1), keys, width, self._name)


class _Table:
    """A text table; read in blocks, so that only the wanted columns are held."""

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
                    f"{path.name} has no column {missing[0]!r}",
                    f"name one in the map that it has: {_some(names)}",
                )
            unique = list(dict.fromkeys(wanted))
            use = [names.index(key) for key in unique]
            blocks = []
            rows = 0
            while block := list(islice(lines, ROWS_AT_A_TIME)):
                try:
                    blocks.append(_numbers(block, delimiter, use))
                except (ValueError, IndexError) as error:
                    cells = {at: key for key, at in zip(unique, use, strict=True)}
                    raise _no_number(path.name, block, delimiter, cells, rows) from error
                rows += len(block)
                if rows > MAX_ROWS:
                    raise InputError(
                        f"{path.name} has more than {MAX_ROWS} rows",
                        "split it, and import each part",
                    )
        if not sum(len(block) for block in blocks):
            raise InputError(
                f"{path.name} has a header and no rows", "name a file with measurements"
            )
        data = np.concatenate(blocks)
        self._columns = {key: data[:, i] for i, key in enumerate(unique)}

    def matrix(self, keys: Sequence[str], width: int) -> FloatArray:
        data = np.stack([self._columns[key] for key in keys], axis=1)
        return _checked(data, keys, width, self._name)


def _numbers(rows: Sequence[str], delimiter: str, use: Sequence[int]) -> FloatArray:
    """Return the wanted columns of some rows, shape (n, k); empty rows are left out.

    Raises:
        ValueError: a cell is no number.
        IndexError: a row is cut.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # loadtxt warns where all rows are empty
        found = np.loadtxt(
            rows,
            delimiter=delimiter,
            usecols=use,
            ndmin=2,
            comments=None,
            quotechar='"',
            dtype=np.float64,
        )
    return found.reshape(-1, len(use))


def _no_number(
    name: str, rows: Sequence[str], delimiter: str, cells: Mapping[int, str], before: int
) -> InputError:
    """Return the error of the first cell that is no number.

    Args:
        name: of the file.
        rows: in which it is.
        delimiter: between cells.
        cells: place and name of each wanted column.
        before: rows between the header and these.
    """
    for number, line in enumerate(rows, start=before + 1):
        try:
            row = next(csv.reader([line], delimiter=delimiter), [])
        except csv.Error:
            return InputError(f"{name}: row {number} is no row of a table", "correct or remove it")
        if row and max(cells) >= len(row):
            return InputError(
                f"{name}: row {number} has {len(row)} columns",
                "it may be cut off: correct it or remove it",
            )
        for at, column in cells.items():
            try:
                float(row[at] if row else "nan")
            except ValueError:
                return InputError(
                    f"{name}: row {number}: {row[at][:40]!r} in column {column[:40]} is no number",
                    "correct it, or write nan where there is none",
                )
    return InputError(f"{name} holds something else than numbers", "write them as 0.25 or -2.5e-3")


def _checked(data: FloatArray, keys: Sequence[str], width: int, name: str) -> FloatArray:
    if data.shape[1] != width:
        raise InputError(
            f"{name}: {_some(keys)} has {data.shape[1]} columns, not {width}",
            f"name an array of {width} columns, or {width} of one, in the map's keys",
        )
    if data.shape[0] > MAX_ROWS:
        raise InputError(f"{name} has more than {MAX_ROWS} rows", "split it, and import each part")
    return np.ascontiguousarray(data, dtype=np.float64)


def _some(names: Iterable[str]) -> str:
    found = [name[:40] for name in names]
    more = f" and {len(found) - MANY} more" if len(found) > MANY else ""
    return (", ".join(found[:MANY]) or "nothing") + more


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
