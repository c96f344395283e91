"""Tables of biases and scale factors at temperatures.

What to use when: `read_table_rows` for the values of a table.
"""

import csv
import math
from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data.text_table import (
    check_column_names,
    check_row_width,
    check_text_table,
)

AXES = ("x", "y", "z")
TEMPERATURE_RANGE_DEGC = (-100.0, 250.0)  # of electronics, with a margin
MAX_BIAS_RAD_S = 100.0  # larger than the full scale of any gyroscope
MIN_SCALE, MAX_SCALE = 0.1, 10.0  # relative to the nominal scale factor
TABLE_REMEDY = (
    "give a table (CSV) with the columns temperature_degc, bias_x, bias_y, bias_z, and optionally "
    "bias_std_x, ..., scale_x, ..., scale_std_x, ..."
)
_TABLE_COLUMNS = frozenset(
    ["temperature_degc"]
    + [f"{name}_{axis}" for name in ("bias", "bias_std", "scale", "scale_std") for axis in AXES]
)


def read_table_rows(path: Path, unit: float) -> list[dict[str, float]]:
    """Return the values of each row by column, with those of `rounding_key`.

    Args:
        path: the table.
        unit: of the bias, in rad/s.

    Raises:
        InputError: the table cannot be read, lacks a column, or has a value that is not possible.
    """
    try:
        check_text_table(path)
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as fault:
        raise InputError(
            f"the table {path} cannot be read ({fault.strerror})", TABLE_REMEDY
        ) from fault
    delimiter = max(",;\t", key=(lines[0] if lines else "").count)
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    try:
        names = [name.strip() for name in next(reader, [])]
        rows = [cells for cells in reader if cells]
    except csv.Error as fault:
        raise InputError(f"the table {path.name} cannot be read ({fault})", TABLE_REMEDY) from fault
    missing = [
        name for name in ("temperature_degc", *(f"bias_{a}" for a in AXES)) if name not in names
    ]
    if missing:
        raise InputError(f"the table {path.name} has no column {missing[0]!r}", TABLE_REMEDY)
    check_column_names(names, sorted(_TABLE_COLUMNS), path.name)
    for number, cells in enumerate(rows, start=1):
        check_row_width(len(cells), len(names), number, path.name)
    cells_by_name = [dict(zip(names, cells, strict=True)) for cells in rows]
    values = [
        _table_row(row, number, path.name, unit) for number, row in enumerate(cells_by_name, 1)
    ]
    rounding = {}
    for quantity, factor in (("bias", unit), ("scale", 1.0)):
        columns = [column for axis in AXES if (column := f"{quantity}_{axis}") in names]
        texts = [row[column] for row in cells_by_name for column in columns]
        rounding[rounding_key(quantity)] = factor * _rounding_std(texts)
    return [row | rounding for row in values]


def _table_row(row: dict[str, str], number: int, name: str, unit: float) -> dict[str, float]:
    values = {}
    for key, text in row.items():
        if key not in _TABLE_COLUMNS:
            continue
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(
                f"row {number} of the table {name} has "
                f"{'nothing' if not text else repr(text[:40])} in the column {key}, which is not a "
                "number",
                "correct the cell, or remove the row",
            )
        values[key] = value * (unit if key.startswith("bias_") else 1.0)
        limits = _limits(key)
        if not limits[0] <= values[key] <= limits[1]:
            raise InputError(
                f"row {number} of the table {name} has {text.strip()[:40]} in the column {key}, "
                "which is not possible",
                "correct the cell, or give the unit of the bias with --unit"
                if key.startswith("bias_")
                else "correct the cell, or remove the row",
            )
    return values


def _limits(column: str) -> tuple[float, float]:
    """Return the smallest and the largest possible value of a column, in SI units."""
    if column == "temperature_degc":
        return TEMPERATURE_RANGE_DEGC
    if "_std_" in column:
        return 0.0, MAX_BIAS_RAD_S
    return (
        (-MAX_BIAS_RAD_S, MAX_BIAS_RAD_S) if column.startswith("bias_") else (MIN_SCALE, MAX_SCALE)
    )


def rounding_key(name: str) -> str:
    """Return the key of the standard uncertainty of rounding of `bias` or `scale`."""
    return f"{name}_rounding_std"


def _rounding_std(texts: Iterable[str]) -> float:
    """Return the standard uncertainty of rounding to the finest digit of numbers, as text.

    Without it, the scatter of an axis whose values are all equal would be zero.
    """
    exponents = [Decimal(text.strip()).as_tuple().exponent for text in texts]
    finest = min((power for power in exponents if isinstance(power, int)), default=0)
    return float(10.0 ** min(finest, 0)) / math.sqrt(12.0)
