"""Columns of numbers from text tables and NumPy archives.

What to use when: `open_columns` selects the reader by the content of the file; `matrix` returns
float64 arrays. The size of the input is checked before it is loaded, nothing in it is executed,
and every defect is an `InputError` of one line.
"""

import lzma
import re
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from tokenize import TokenError
from typing import IO, Protocol

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.text_table import check_text_table
from gyrorig_solver.importers.array_files import (
    MAX_ARRAY_BYTES,
    ArrayReader,
    find_array_reader,
    too_large,
)
from gyrorig_solver.importers.map_keys import Column, TableLayout
from gyrorig_solver.importers.text_columns import (
    TextColumns,
    check_matrix,
    list_names,
    open_text,
)

_ARRAY_REMEDY = "save the array with numpy.savez as floats or integers"
# RuntimeError: the archive has a password, or (NotImplementedError) an unknown compression
_ARCHIVE_ERRORS = (
    OSError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, MemoryError, RuntimeError,
    UnicodeDecodeError,
)  # fmt: skip
_ELEMENT = re.compile(r"(.+)\[(\d{1,3})\]")  # one column of an array: key[0]


class MeasurementColumns(Protocol):
    """The named columns of a file."""

    def matrix(self, keys: Sequence[Column], width: int) -> FloatArray:
        """Return one array of `width` columns, or `width` single columns joined."""
        ...


def open_columns(
    path: Path, wanted: Sequence[Column], layout: TableLayout | None = None
) -> MeasurementColumns:
    """Open a table or an archive for the columns that a map asks for.

    Args:
        path: the file.
        wanted: the columns by name or by number from 1.
        layout: how a text table is written.

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
        reader = find_array_reader(path)
        if reader is not None:
            return ArrayColumns(path.name, wanted, reader)
        with path.open("rb") as file:
            is_archive = file.read(2) == b"PK"
        if is_archive or path.suffix == ".npz":
            return ArrayColumns(path.name, wanted, _NumpyArrays(path))
        check_text_table(path)
        with open_text(path.open("rb")) as lines:
            return TextColumns(lines, path.name, wanted, layout or TableLayout())
    except _ARCHIVE_ERRORS as error:
        raise InputError(
            f"the file {path.name} cannot be read ({_one_line(error)})",
            "copy the file again from its source",
        ) from error


class _NumpyArrays:
    """The arrays of a NumPy archive."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with zipfile.ZipFile(path) as archive:
            self._members = archive.infolist()

    def names(self) -> list[str]:
        """Return the names of all arrays."""
        return [member.filename.removesuffix(".npy") for member in self._members]

    def load(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        """Return some arrays."""
        names = self.names()
        sizes = [self._members[names.index(array)].file_size for array in wanted]
        if sum(sizes) > MAX_ARRAY_BYTES:
            raise too_large(self._path)
        arrays = {}
        with zipfile.ZipFile(self._path) as archive:
            for array, size in zip(wanted, sizes, strict=True):
                what = f"in the file {self._path.name}, the array {array}"
                with archive.open(self._members[names.index(array)]) as content:
                    arrays[array] = _read_array(content, size, what)
        return arrays


class ArrayColumns:
    """Named arrays of a file; only the requested arrays are loaded."""

    def __init__(self, name: str, wanted: Sequence[Column], reader: ArrayReader) -> None:
        self._name = name
        names = reader.names()
        self._element = {key: self._find_array(key, names) for key in dict.fromkeys(wanted)}
        self._arrays = reader.load(sorted({array for array, _ in self._element.values()}))

    def _find_array(self, key: Column, names: Sequence[str]) -> tuple[str, int | None]:
        """Return the array of a key, and the number of its column if the key has one."""
        element = None if isinstance(key, int) or key in names else _ELEMENT.fullmatch(key)
        array = element[1] if element is not None else key
        if isinstance(array, int):
            raise InputError(
                f"the file {self._name} has arrays with names, so {array} is not a column of it",
                f"in the import map, choose one of the arrays {list_names(names)}",
            )
        if names.count(array) != 1:
            problem = f"{names.count(array)} arrays" if array in names else "no array"
            raise InputError(
                f"the file {self._name} contains {problem} {array!r}",
                did_you_mean(array, {" ".join(name.split()) for name in names if name != array})
                or f"in the import map, choose one of the arrays {list_names(names)}",
            )
        return array, int(element[2]) if element is not None else None

    def matrix(self, keys: Sequence[Column], width: int) -> FloatArray:
        """Return one array of `width` columns, or `width` single columns joined."""
        columns = [self._column(key, width) for key in keys]
        if len({part.shape[0] for part in columns}) != 1 or any(p.ndim != 2 for p in columns):
            sizes = " and ".join(str(part.shape[0]) for part in columns)
            raise InputError(
                f"in the file {self._name}, the columns {list_names(keys)} have different "
                f"lengths ({sizes} rows)",
                "name columns of equal length in the import map",
            )
        return check_matrix(np.concatenate(columns, axis=1), keys, width, self._name)

    def _column(self, key: Column, width: int) -> FloatArray:
        array, element = self._element[key]
        values = self._arrays[array]
        if element is not None:
            if values.ndim != 2 or element >= values.shape[1]:
                raise InputError(
                    f"in the file {self._name}, the array {array} has the shape {values.shape}, "
                    f"so it has no column {element}",
                    "count the columns of an array from 0 in the import map",
                )
            return values[:, element : element + 1]
        if width == 9 and values.ndim == 3 and values.shape[1:] == (3, 3):
            return values.reshape(-1, 9)
        return values.reshape(-1, 1) if values.ndim < 2 else values


def _read_array(content: IO[bytes], size: int, what: str) -> FloatArray:
    """Return one array as float64; its declared size is checked, and pickles are never opened.

    Args:
        content: the bytes of the array.
        size: the number of these bytes.
        what: the array, for errors.
    """
    try:
        version = np.lib.format.read_magic(content)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, fortran_order, dtype = read_header(content)
    except (ValueError, KeyError, SyntaxError, TokenError, TypeError, RecursionError) as error:
        raise InputError(f"{what} is damaged or not an array", _ARRAY_REMEDY) from error
    if dtype.hasobject:
        raise InputError(f"{what} contains objects instead of numbers", _ARRAY_REMEDY)
    if dtype.kind not in "biuf":
        raise InputError(f"{what} contains {dtype} values instead of real numbers", _ARRAY_REMEDY)
    count = 1
    for length in shape:
        count *= int(length)
    if not 0 <= count * dtype.itemsize <= size:
        raise InputError(f"{what} is shorter than its header states", _ARRAY_REMEDY)
    data = content.read(count * dtype.itemsize)
    if len(data) != count * dtype.itemsize:
        raise InputError(f"{what} is shorter than its header states", _ARRAY_REMEDY)
    values = np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran_order else "C")
    return np.ascontiguousarray(values, dtype=np.float64)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
