"""Reading a file of columns with an import map, for every format of columns.

What to use when: `MappedFormat` for a format whose columns a map describes. Without a map,
`MissingMapError` has one to complete: names suggest what a column is, but a unit is never guessed,
so that map is invalid until a person fills it in.
"""

import csv
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.importers.array_files import find_array_reader
from gyrorig_solver.importers.bag_limits import parsing_errors
from gyrorig_solver.importers.import_map import check_import_map
from gyrorig_solver.importers.import_streams import read_mapped_streams
from gyrorig_solver.importers.map_columns import open_map_columns
from gyrorig_solver.importers.measured_streams import MeasuredStreams
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.text_columns import list_names

MAP_OPTIONS = BOARD_OPTIONS | {"mapping"}
MAX_LISTED_COLUMNS = 200
MAX_NAME_CHARS = 60
_GYRO = r"gyr|omega|angular|rotation ?rate|^w_|^w[xyz]$|^g[xyz]$"
_ACCEL = r"acc|^a_|^a[xyz]$|force"
_QUATERNION = r"quat|orient|^q|att"
_TIME = r"time|^t$|stamp|^ts"
_TEMPERATURE = r"temp"


class MissingMapError(UsageError):
    """A file of columns was given without a map.

    Attributes:
        sketch: a column map (YAML) for a person to complete.
    """

    def __init__(self, problem: str, remedy: str, sketch: str) -> None:
        super().__init__(problem, remedy)
        self.sketch = sketch


@dataclass(frozen=True, slots=True)
class MappedFormat:
    """Columns of a table, or arrays; an import map says what they are."""

    name: str
    title: str
    describe: Callable[[Path], str | None]  # what a file is; None: it has another format
    extra: str = ""
    used_options: frozenset[str] = MAP_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match by the content of the file."""
        description = self.describe(source)
        return None if description is None else FormatMatch(description, is_complete=False)

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the streams that the map describes."""
        return read_with_map(source, options)


def read_with_map(source: Path, options: ImportOptions) -> MeasuredStreams:
    """Return the streams of a file of columns that the map describes.

    Raises:
        InputError: the file does not agree with the map.
        MissingMapError: there is no map.
        UsageError: the map contradicts itself.
    """
    if options.mapping is None:
        with parsing_errors(source.name, "copy the file again from its source"):
            names = _column_names(source)
        raise MissingMapError(
            f"{source.name} needs a column map, because it does not specify what its columns "
            f"measure: {list_names(names)}",
            f"run `gyrorig import {source.name} > map.yaml`, complete this map, and give it with "
            "--map",
            _sketch_map(names),
        )
    chosen = {"board": options.board, "sensor": options.sensor}
    mapping = msgspec.structs.replace(
        options.mapping, **{key: value for key, value in chosen.items() if value is not None}
    )
    mapping = check_import_map(mapping, "import map")
    return read_mapped_streams(open_map_columns(source, mapping), mapping, source)


def _column_names(source: Path) -> list[str]:
    """Return the names of the columns or arrays of a file of any mapped format.

    Raises:
        InputError: the file is damaged.
    """
    reader = find_array_reader(source)
    if reader is not None:
        names = reader.names()
    elif read_head(source).startswith(b"PK"):
        with np.load(source, allow_pickle=False) as archive:
            names = list(archive.files)
    else:
        first = read_head(source).partition(b"\n")[0].decode("utf-8-sig", errors="replace")
        delimiter = max(",;\t", key=first.count)
        names = [name.strip() for name in _split_header(first, delimiter)]
    return [" ".join(name.split()) for name in names[:MAX_LISTED_COLUMNS]]


def _split_header(line: str, delimiter: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:  # for example, a name with more than 131072 characters
        return line.split(delimiter)


def _sketch_map(names: Sequence[str]) -> str:
    """Return a column map whose parts in capital letters a person completes."""
    time = _matching(names, _TIME)
    lines = [
        "# Complete the words in capital letters: the names of columns suggest them, units do not.",
        f"# The columns are: {', '.join(_short(name) for name in names)}",
        "schema: gyrorig/import/1",
        "board: BOARD  # a name of your choice",
        "sensor: SENSOR  # for example MPU-6050",
        f"time: {{key: {_quoted(time[:1])}, unit: UNIT}}  # s, ms, us or ns; or {{rate_hz: RATE}}",
        f"gyro: {{keys: {_keys(names, _GYRO)}, unit: UNIT}}  # rad/s, deg/s or counts",
    ]
    if _matching(names, _ACCEL):
        lines.append(f"accel: {{keys: {_keys(names, _ACCEL)}, unit: UNIT}}  # m/s2, g or counts")
    if temperature := _matching(names, _TEMPERATURE):
        lines.append(f"temperature: {{key: {_quoted(temperature[:1])}}}  # in degC")
    if _matching(names, _QUATERNION):
        quaternion = _keys(names, _QUATERNION, most=4)
        lines.append(
            f"attitude: {{keys: {quaternion}, order: ORDER}}  # wxyz or xyzw, to the world"
        )
    return "\n".join(lines) + "\n"


def _matching(names: Sequence[str], pattern: str) -> list[str]:
    return [name for name in names if re.search(pattern, name.rpartition(".")[2].lower())]


def _keys(names: Sequence[str], pattern: str, most: int = 3) -> str:
    matching = _matching(names, pattern)
    array = len(matching) < most
    return (
        f"[{', '.join(_quoted([name]) for name in matching[: 1 if array else most]) or 'COLUMNS'}]"
    )


def _quoted(names: Sequence[str]) -> str:
    return (
        '"' + _short(names[0]).replace("\\", "\\\\").replace('"', '\\"') + '"'
        if names
        else "COLUMN"
    )


def _short(name: str) -> str:
    return "".join(c for c in name[:MAX_NAME_CHARS] if c.isprintable())
