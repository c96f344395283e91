"""Exports of the app phyphox: a zip archive or a folder with one table per sensor.

Source: phyphox experiments gyroscope.phyphox and acceleration.phyphox: the columns are `Time (s)`,
`Gyroscope x (rad/s)`, `Acceleration x (m/s^2)`. The time is that of the experiment, which stands
still in a pause. `meta/time.csv` gives the system time of each START and PAUSE in the columns
"event", "experiment time", "system time", "system time text". The export has comma, semicolon or
tab between columns, and with the last two also decimal commas, in all its tables.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.map_keys import Column, TableLayout
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
)
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.source_tables import SourceTables, find_delimiter

_GYRO = re.compile(r"(?<!linear )gyroscope ([xyz]) \(rad/s\)|^rotation rate ([xyz]) \(rad/s\)")
_ACCEL = re.compile(r"^acceleration ([xyz]) \(m/s(?:\^2|²)\)")


@dataclass(frozen=True, slots=True)
class Phyphox:
    """The gyroscope and the accelerometer of one experiment."""

    name: str = "phyphox"
    title: str = "export of phyphox (zip or folder of tables)"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for a table with the columns of phyphox's gyroscope."""
        if not source.is_dir() and not read_head(source, 2).startswith(b"PK"):
            return None
        try:
            tables = SourceTables(source)
        except InputError:
            return None
        if _find_table(tables, _GYRO) is None:
            return None
        return FormatMatch("an export of phyphox")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the rates and accelerations, on the phone's time of day."""
        tables = SourceTables(source)
        name = _find_table(tables, _GYRO)
        if name is None:
            listed = ", ".join(tables.names)[:200]
            raise InputError(
                f"{source.name} contains no table with a gyroscope, but only {listed}",
                "use an experiment that records the gyroscope, for example Gyroscope",
            )
        notes = ["the rates may contain a bias correction by the phone that changes during the log"]
        time_s, rate_rad_s = _read_sensor(tables, name, _GYRO)
        accel_name = _find_table(tables, _ACCEL)
        accel = None
        if accel_name is not None:
            accel_s, values = _read_sensor(tables, accel_name, _ACCEL)
            accel = accel_s, values
        origin_ns, blocks = _time_blocks(tables)
        if not blocks and "time.csv" in tables.names:
            notes.append(
                "meta/time.csv gives no valid start, so pauses and the time of day are not known"
            )
        if len(blocks) > 1:
            notes.append(f"the experiment was paused {len(blocks) - 1} times")
        board = MeasuredBoard(
            options.board or "PHONE",
            GyroStream(_system_time(time_s, blocks), rate_rad_s),
            None if accel is None else AccelStream(accel[1], _system_time(accel[0], blocks)),
            metadata={"sensor": options.sensor or "unknown"} | _model(tables),
        )
        source_text = f"imported from {source.name}: {name} of phyphox"
        return MeasuredStreams(source_text, (board,), origin_ns=origin_ns, notes=tuple(notes))


def _cells(header: str) -> list[str]:
    return [cell.strip().strip('"').lower() for cell in header.split(find_delimiter(header))]


def _axis_columns(header: str, pattern: re.Pattern[str]) -> list[Column]:
    """Return the column numbers of x, y and z; an empty list if not all exist once."""
    places: dict[str, list[int]] = {}
    for number, cell in enumerate(_cells(header), start=1):
        match = pattern.search(cell)
        if match is not None:
            axis = next(group for group in match.groups() if group)
            places.setdefault(axis, []).append(number)
    if sorted(places) != ["x", "y", "z"] or any(len(numbers) > 1 for numbers in places.values()):
        return []
    return [places[axis][0] for axis in "xyz"]


def _find_table(tables: SourceTables, pattern: re.Pattern[str]) -> str | None:
    for name in tables.names:
        if not name.endswith(".csv"):
            continue
        header = tables.header(name)
        if _axis_columns(header, pattern) and _cells(header)[0].endswith("(s)"):
            return name
    return None


def _read_sensor(
    tables: SourceTables, name: str, pattern: re.Pattern[str]
) -> tuple[FloatArray, FloatArray]:
    """Return the experiment time in s, and the values."""
    header = tables.header(name)
    keys = _axis_columns(header, pattern)
    wanted: list[Column] = [1, *keys]
    # a comma that is not between cells is a decimal comma
    layout = TableLayout() if find_delimiter(header) == "," else TableLayout(decimal="comma")
    columns = tables.columns(name, wanted, layout)
    time_s = columns.matrix([1], 1)[:, 0]
    finite = np.isfinite(time_s)
    return time_s[finite], columns.matrix(keys, 3)[finite]


def _time_blocks(tables: SourceTables) -> tuple[int, list[tuple[float, float]]]:
    """Return the Unix time of the first start in ns, and each start.

    A start is the experiment time and the time since the first start, both in s.
    """
    starts = []
    for row in tables.text_rows("time.csv")[1:]:
        if len(row) >= 3 and row[0] == "START":
            try:
                experiment_s, system_s = (float(cell.replace(",", ".")) for cell in row[1:3])
                starts.append((experiment_s, system_s))
            except ValueError:
                return 0, []
    if not starts or not all(np.isfinite(time) for start in starts for time in start):
        return 0, []
    first_s = starts[0][1]
    if not 0.0 <= first_s < 2e9:
        return 0, []
    return round(first_s * 1e9), [(begin_s, at_s - first_s) for begin_s, at_s in starts]


def _system_time(experiment_s: FloatArray, blocks: list[tuple[float, float]]) -> FloatArray:
    """Return the time since the first start: pauses are counted."""
    if len(blocks) < 2:
        return experiment_s
    begin_s = np.array([begin for begin, _ in blocks])
    since_s = np.array([since for _, since in blocks])
    block = np.maximum(np.searchsorted(begin_s, experiment_s, side="right") - 1, 0)
    return np.asarray(experiment_s - begin_s[block] + since_s[block], dtype=np.float64)


def _model(tables: SourceTables) -> dict[str, str]:
    for row in tables.text_rows("device.csv"):
        if row[0] == "deviceModel" and len(row) > 1:
            return {"model": row[1][:100]}
    return {}


FORMAT = Phyphox()
