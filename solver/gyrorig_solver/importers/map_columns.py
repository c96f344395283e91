"""The columns of a map, from one file or from several files."""

from collections import defaultdict
from pathlib import Path

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.importers.map_keys import Column, ImportMap, TableLayout
from gyrorig_solver.importers.measurement_columns import MeasurementColumns, open_columns

STREAMS = ("gyro", "accel", "temperature", "attitude")


class MapColumns:
    """The columns of every stream of a map."""

    def __init__(self, columns: dict[str, MeasurementColumns]) -> None:
        self._columns = columns

    def of(self, stream: str) -> MeasurementColumns:
        """Return the columns of the file that contains a stream: "gyro", "accel", ..."""
        return self._columns[stream]


def open_map_columns(source: Path, mapping: ImportMap) -> MapColumns:
    """Open the input, and the other files that a map names, in the folder of the input.

    Raises:
        InputError: a file cannot be read, lacks a column, or is too large.
        UsageError: one file has two layouts.
    """
    wanted: dict[str | None, list[Column]] = defaultdict(list)
    layouts: dict[str | None, TableLayout | None] = {None: mapping.table}
    files: dict[str, str | None] = {}
    for stream in STREAMS:
        part = getattr(mapping, stream)
        if part is None:
            continue
        file = None if stream == "gyro" else part.file
        files[stream] = file
        wanted[file] += [part.key] if stream == "temperature" else part.keys
        time = mapping.time if stream == "gyro" else part.time
        if time is not None:
            wanted[file] += [key for key in (time.key, time.rate_key) if key is not None]
        if file is not None and layouts.setdefault(file, part.table) != part.table:
            raise UsageError(
                f"the import map gives the file {file} with two different layouts",
                "give the same keys under `table` each time",
            )
    if mapping.static_mask:
        wanted[None].append(mapping.static_mask.key)
    opened = {
        file: open_columns(source if file is None else source.parent / file, keys, layouts[file])
        for file, keys in wanted.items()
    }
    return MapColumns({stream: opened[file] for stream, file in files.items()})
