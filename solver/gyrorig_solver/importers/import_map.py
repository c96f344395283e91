"""Reading and checking of import maps.

What to use when: `load_import_map` reads and checks a map file; `check_import_map` checks a map
made in a program. The keys are in `map_keys`. The maps that this project ships are in
config/imports.
"""

import math
from pathlib import Path

import numpy as np

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.importers.map_keys import SCHEMA, ImportMap, TimeBase


def load_import_map(path: Path) -> ImportMap:
    """Return the map in a YAML file.

    Raises:
        UsageError: the file cannot be read, or its parts contradict each other.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"the import map {path} cannot be read ({error.strerror})",
            "give an import map with --map, for example a file in config/imports",
        ) from error
    document = parse_yaml(text, path.name, schema=SCHEMA)
    return check_import_map(convert_document(document, ImportMap, path.name), path.name)


def check_import_map(import_map: ImportMap, name: str) -> ImportMap:
    """Return the map if its parts do not contradict each other.

    Raises:
        UsageError: parts contradict each other.
    """
    BoardId(import_map.board)
    for where, part in (
        ("time", import_map),
        ("accel: time", import_map.accel),
        ("temperature: time", import_map.temperature),
        ("attitude: time", import_map.attitude),
    ):
        if part is not None and part.time is not None:
            _check_time(part.time, f"{name}: {where}", where == "attitude: time")
    if import_map.gyro.unit == "counts" and import_map.gyro.scale_rad_s is None:
        raise UsageError(
            f"the import map {name} gives the gyro in counts, but not its scale factor "
            "`scale_rad_s`",
            "add `scale_rad_s` under `gyro`, with the value of one count in rad/s from the "
            "data sheet",
        )
    if (
        import_map.accel
        and import_map.accel.unit == "counts"
        and import_map.accel.scale_m_s2 is None
    ):
        raise UsageError(
            f"the import map {name} gives the accelerometer in counts, but not its scale "
            "factor `scale_m_s2`",
            "add `scale_m_s2` under `accel`, with the value of one count in m/s^2 from the "
            "data sheet",
        )
    _check_columns(import_map, name)
    _check_files(import_map, name)
    turns = [
        *import_map.turns,
        *(import_map.sections.turns.values() if import_map.sections else ()),
    ]
    for turn in turns:
        if not math.isclose(math.hypot(*turn.axis), 1.0, abs_tol=1e-6):
            raise UsageError(
                f"in the import map {name}, the axis {turn.axis} of a turn does not have the "
                "length 1",
                "give the axis as a unit vector, for example [0.0, 0.0, 1.0]",
            )
    return import_map


def _check_columns(import_map: ImportMap, name: str) -> None:
    """Check the numbers of columns, and that the zeros have the unit of the columns."""
    attitude = import_map.attitude
    matrices = attitude is not None and attitude.order == "matrix"
    for where, columns, width in (
        ("gyro", import_map.gyro, 3),
        ("accel", import_map.accel, 3),
        ("attitude", attitude, 9 if matrices else 4),
    ):
        if columns is not None and len(columns.keys) not in (1, width):
            raise UsageError(
                f"in the import map {name}, `keys` under `{where}` has {len(columns.keys)} "
                f"entries instead of 1 or {width}",
                f"give the name of one array with {width} columns, or {width} names of columns",
            )
    for where, sensor in (("gyro", import_map.gyro), ("accel", import_map.accel)):
        if sensor is None:
            continue
        wrong = "zero" if sensor.unit == "counts" else "offset_counts"
        if np.any(np.asarray(getattr(sensor, wrong)) != 0):
            right = "offset_counts" if sensor.unit == "counts" else "zero"
            raise UsageError(
                f"in the import map {name}, `{wrong}` under `{where}` does not apply to the unit "
                f"{sensor.unit}",
                f"use the key `{right}`",
            )


def _check_files(import_map: ImportMap, name: str) -> None:
    """Check that streams in other files have times, and that the layouts are possible."""
    layouts = [("table", import_map.table)]
    for where in ("accel", "temperature", "attitude"):
        part = getattr(import_map, where)
        if part is None:
            continue
        if part.file is not None and part.time is None:
            raise UsageError(
                f"in the import map {name}, `{where}` is in another file, but has no times",
                f"give the times in this file with the key `time` under `{where}`",
            )
        if part.table is not None and part.file is None:
            raise UsageError(
                f"in the import map {name}, `{where}` has the key `table`, but no key `file`",
                "give the layout of the input with the key `table` at the top of the map",
            )
        layouts.append((f"{where}: table", part.table))
    for where, layout in layouts:
        if layout is not None and layout.decimal == "comma" and layout.delimiter == "comma":
            raise UsageError(
                f"in the import map {name}, `{where}` has the comma both between columns and in "
                "numbers",
                "export the table again with another delimiter or with decimal points",
            )


def _check_time(time: TimeBase, name: str, is_attitude: bool) -> None:
    if time.stamp == "arrival":
        if is_attitude and time.key is not None:
            return
        if time.key is None or time.rate_hz is None:
            raise UsageError(
                f"{name}: `stamp: arrival` needs both the key `key` and the key `rate_hz`",
                "give the column of arrival times as `key`, and the nominal sample rate of "
                "the sensor as `rate_hz`",
            )
    elif sum(given is not None for given in (time.key, time.rate_hz, time.rate_key)) != 1:
        raise UsageError(
            f"{name} must contain one of the keys `key`, `rate_hz` and `rate_key`, and only one",
            "give a column of times (`key`), a sample rate in Hz (`rate_hz`), or an array "
            "that contains the rate (`rate_key`)",
        )
