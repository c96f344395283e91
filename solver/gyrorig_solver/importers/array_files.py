"""Files of named arrays: MATLAB (v5 and v7.3), HDF5 and Parquet.

What to use when: `find_array_reader` for the reader of a file, by its content; `names` and `load`
of the reader. Every size is checked before it is allocated, and links out of the file and objects
are refused.
"""

import functools
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.bag_limits import parsing_errors

MAX_ARRAY_BYTES = 4_000_000_000
MAX_NAMES = 2000
MAX_DEPTH = 4  # groups in groups
MATLAB5_TEXT, MATLAB73_TEXT = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
HDF5_MAGIC, PARQUET_MAGIC = b"\x89HDF\r\n\x1a\n", b"PAR1"
_MATLAB_HEADER_BYTES, _MATLAB73_USER_BLOCK = 128, 512
_COMPRESSED_ELEMENT = 15  # miCOMPRESSED, MATLAB "MAT-File Format", R2024a, table 1-1
_REMEDY = "copy the file again from its source"


class ArrayReader(Protocol):
    """The arrays of one file."""

    def names(self) -> list[str]:
        """Return the names of all arrays."""
        ...

    def load(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        """Return some arrays as float64, one row per sample."""
        ...


def find_array_reader(path: Path) -> ArrayReader | None:
    """Return the reader of a file of arrays by its content, None if it is another file.

    Raises:
        InputError: the file is damaged or too large.
    """
    kind = array_file_kind(path)
    if kind is None:
        return None
    with parsing_errors(path.name, _REMEDY):
        if kind == "matlab5":
            return _Matlab5Arrays(path)
        return _ParquetArrays(path) if kind == "parquet" else _Hdf5Arrays(path)


def array_file_kind(path: Path) -> str | None:
    """Return "matlab5", "matlab73", "hdf5" or "parquet" by the first bytes, None if none."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        head = file.read(_MATLAB73_USER_BLOCK + len(HDF5_MAGIC))
    if head.startswith(MATLAB73_TEXT) and head[_MATLAB73_USER_BLOCK:] == HDF5_MAGIC:
        return "matlab73"
    if head.startswith(MATLAB5_TEXT):
        return "matlab5"
    if head.startswith(HDF5_MAGIC):
        return "hdf5"
    return "parquet" if head.startswith(PARQUET_MAGIC) else None


def too_large(path: Path) -> InputError:
    """Return the error of arrays that do not fit."""
    return InputError(
        f"the arrays in the file {path.name} need more than {MAX_ARRAY_BYTES // 10**9} GB of "
        "memory",
        "split the file, and import each part",
    )


class _Matlab5Arrays:
    """Variables of a MATLAB file of version 5 to 7, and the fields of its structures."""

    def __init__(self, path: Path) -> None:
        from scipy.io import whosmat  # noqa: PLC0415 - slow to load

        self._path = path
        self._check_size()
        self._variables = [
            (name, kind) for name, _, kind in whosmat(path) if kind not in {"cell", "function"}
        ]
        self._arrays: dict[str, Any] = {}
        for name, kind in self._variables:
            if kind == "struct":
                self._arrays |= dict(_fields(name, self._load(name), 0))

    def _check_size(self) -> None:
        """Unpack every element without keeping it."""
        total = 0
        with self._path.open("rb") as file:
            file.seek(_MATLAB_HEADER_BYTES - 2)
            order: Literal["big", "little"] = "big" if file.read(2) == b"MI" else "little"
            while len(tag := file.read(8)) == 8:
                kind = int.from_bytes(tag[:4], order)
                length = int.from_bytes(tag[4:], order)
                start = file.tell()
                if kind == _COMPRESSED_ELEMENT:
                    unpacker = zlib.decompressobj()
                    left = length
                    while left > 0 and (packed := file.read(min(left, 1 << 16))):
                        left -= len(packed)
                        total += len(unpacker.decompress(packed))  # at most 64 MB at once
                        if total > MAX_ARRAY_BYTES:
                            raise too_large(self._path)
                total += length
                file.seek(start + length)
        if total > MAX_ARRAY_BYTES:
            raise too_large(self._path)

    def _load(self, name: str) -> Any:
        from scipy.io import loadmat  # noqa: PLC0415 - slow to load

        loaded = loadmat(self._path, variable_names=[name], squeeze_me=True, simplify_cells=True)
        return loaded[name]

    def names(self) -> list[str]:
        return [name for name, kind in self._variables if kind != "struct"] + list(self._arrays)

    def load(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        with parsing_errors(self._path.name, _REMEDY):
            return {
                name: _as_rows(
                    self._arrays[name] if name in self._arrays else self._load(name),
                    f"in the file {self._path.name}, the array {name}",
                )
                for name in wanted
            }


def _fields(name: str, value: object, depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the arrays in the fields of a structure with names like `imu.gyr`."""
    if isinstance(value, dict):
        if depth < MAX_DEPTH:
            for key, inner in value.items():
                yield from _fields(f"{name}.{key}", inner, depth + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.ndim:
        yield name, value


class _Hdf5Arrays:
    """Datasets of an HDF5 file, with names like `imu.gyr`; MATLAB v7.3 is HDF5."""

    def __init__(self, path: Path) -> None:
        import h5py  # type: ignore[import-untyped] # noqa: PLC0415 - an extra

        self._path = path
        self._is_matlab = array_file_kind(path) == "matlab73"
        with h5py.File(path, "r") as file:
            self._names = [name for name, _ in self._datasets(file, "", 0)][:MAX_NAMES]

    def _datasets(self, group: Any, prefix: str, depth: int) -> Iterator[tuple[str, Any]]:
        """Yield the datasets of numbers that are in the file itself."""
        import h5py  # noqa: PLC0415 - an extra

        for key in group:
            name = f"{prefix}{key}"
            if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue  # MATLAB's own references, and links to other files
            value = group[key]
            if isinstance(value, h5py.Group) and depth < MAX_DEPTH:
                yield from self._datasets(value, f"{name}.", depth + 1)
            elif isinstance(value, h5py.Dataset) and _is_readable(value):
                yield name, value

    def names(self) -> list[str]:
        return self._names

    def load(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        import h5py  # noqa: PLC0415 - an extra

        arrays = {}
        with parsing_errors(self._path.name, _REMEDY), h5py.File(self._path, "r") as file:
            datasets = {n: value for n, value in self._datasets(file, "", 0) if n in wanted}
            if sum(8 * int(value.size) for value in datasets.values()) > MAX_ARRAY_BYTES:
                raise too_large(self._path)
            for name, dataset in datasets.items():
                values = dataset[...]
                # MATLAB stores columns first: what MATLAB shows as (n, 3) is (3, n) in the file
                arrays[name] = _as_rows(
                    values.T if self._is_matlab else values,
                    f"in the file {self._path.name}, the array {name}",
                )
        return arrays


def _is_readable(dataset: Any) -> bool:
    """Return whether a dataset has numbers that are in the file itself."""
    if dataset.is_virtual or dataset.external:
        return False
    return dataset.dtype.kind in "biuf" and dataset.ndim > 0


class _ParquetArrays:
    """Columns of a Parquet file; columns of lists of equal length are arrays."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._types: dict[str, str] = {}
        with _database().cursor() as database:
            rows = database.execute(
                "SELECT name, column_type FROM (DESCRIBE SELECT * FROM read_parquet(?)) "
                "AS columns(name, column_type, a, b, c, d)",
                [_literal(path)],
            ).fetchall()
            self._rows: int
            (self._rows,) = database.execute(
                "SELECT count(*) FROM read_parquet(?)", [_literal(path)]
            ).fetchone() or (0,)
        self._types = {str(name): str(kind) for name, kind in rows[:MAX_NAMES]}

    def names(self) -> list[str]:
        return list(self._types)

    def load(self, wanted: Sequence[str]) -> dict[str, FloatArray]:
        if 8 * self._rows * len(wanted) > MAX_ARRAY_BYTES:
            raise too_large(self._path)
        arrays = {}
        with parsing_errors(self._path.name, _REMEDY), _database().cursor() as db:
            for name in wanted:
                quoted = '"' + name.replace('"', '""') + '"'
                result = db.execute(
                    f"SELECT {quoted} AS value FROM read_parquet(?)",  # noqa: S608 - a quoted name
                    [_literal(self._path)],
                ).fetchnumpy()["value"]
                values = (
                    np.ma.filled(result.astype(np.float64), np.nan)
                    if np.ma.isMaskedArray(result)
                    else result
                )
                arrays[name] = _as_rows(
                    _stack(values), f"in the file {self._path.name}, the column {name}"
                )
        return arrays


@functools.cache
def _database() -> Any:
    """Return a database in memory with limits; a connection takes 50 ms to open."""
    import duckdb  # noqa: PLC0415 - an extra

    return duckdb.connect(
        config={"memory_limit": "4GB", "threads": 2, "autoinstall_known_extensions": False}
    )


def _literal(path: Path) -> str:
    """Return a path in which DuckDB sees no pattern."""
    text = str(path.resolve())
    return "".join(f"[{c}]" if c in "*?[" else c for c in text)


def _stack(values: Any) -> Any:
    """Return lists of equal length as an array (n, k)."""
    if getattr(values, "dtype", np.dtype(float)).kind == "O" and len(values):
        return np.array([np.asarray(row, dtype=np.float64) for row in values])
    return values


def _as_rows(values: Any, what: str) -> FloatArray:
    """Return an array of real numbers with a row per sample.

    Raises:
        InputError: it contains something else.
    """
    array = np.asarray(values)
    if array.dtype.kind == "M":  # times of day
        array = array.astype("datetime64[ns]").astype(np.int64)
    if array.dtype.kind not in "biuf":
        raise InputError(
            f"{what} contains {array.dtype} values instead of real numbers",
            "export the array as floats or integers",
        )
    if array.ndim == 2 and array.shape[0] < array.shape[1] and array.shape[0] in (1, 3, 4, 9):
        array = array.T  # MATLAB users often store a column per sample
    if array.ndim == 2 and array.shape[1] == 1:
        array = array[:, 0]
    return np.ascontiguousarray(array, dtype=np.float64)
