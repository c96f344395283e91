"""Exports of the app Sensor Logger: a zip archive or a folder with one table per sensor.

Source: tszheichoi/awesome-sensor-logger, README and UNITS: the columns are `time` (Unix
time in ns), `seconds_elapsed`, `z`, `y` and `x`; rates are in rad/s; `TotalAcceleration` includes
gravity and exists on Android only; `AccelerometerUncalibrated` of iOS is in g, unless the units
are standardised. `Metadata.csv` names the platform. An uncalibrated accelerometer of iOS has the
opposite sign of Android's (COORDINATES there).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.measured_streams import (
    STANDARD_GRAVITY_M_S2,
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
from gyrorig_solver.importers.source_tables import SourceTables

_GYROS = ("GyroscopeUncalibrated.csv", "Gyroscope.csv")
_ACCELS = ("TotalAcceleration.csv", "AccelerometerUncalibrated.csv")


@dataclass(frozen=True, slots=True)
class SensorLogger:
    """All sensors of one recording of the app."""

    name: str = "sensor-logger"
    title: str = "export of Sensor Logger (zip or folder)"
    extra: str = ""
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for a table of a gyroscope with the app's columns."""
        try:
            tables = _open(source)
        except InputError:
            return None
        if tables is None or not any(_is_sensor(tables, name) for name in tables.names):
            return None
        return FormatMatch("a recording of Sensor Logger")

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return the rates and accelerations; `--topic Gyroscope` selects a table."""
        tables = _open(source)
        if tables is None:
            raise InputError(
                f"{source.name} is not an export of Sensor Logger",
                "export the recording as zip, and give this file",
            )
        gyro = _choose_gyro(tables, options.topics)
        time = tables.columns(gyro, ["time", "seconds_elapsed"])
        elapsed_s = time.matrix(["seconds_elapsed"], 1)[:, 0]
        if elapsed_s.size < 3:
            raise InputError(
                f"the table {gyro} in {source.name} has only {elapsed_s.size} samples",
                "record a session of at least a minute",
            )
        first_s = float(elapsed_s[0])
        properties = _properties(tables)
        notes = []
        if "Uncalibrated" not in gyro:
            notes.append(
                "the rates may contain a bias correction by the phone that changes during the "
                "log; log the uncalibrated gyroscope if the app can"
            )
        if "Orientation.csv" in tables.names:
            notes.append(
                "Orientation.csv is not used as a reference, because the phone computes it from "
                "the same gyroscope"
            )
        board = MeasuredBoard(
            options.board or "PHONE",
            GyroStream(elapsed_s - first_s, _sensor_rows(tables, gyro)),
            _accel(tables, first_s, properties, notes),
            metadata={"sensor": options.sensor or "unknown"}
            | ({"model": properties["device name"]} if "device name" in properties else {}),
        )
        first_ns = time.matrix(["time"], 1)[0, 0]
        return MeasuredStreams(
            f"imported from {source.name}: {gyro} of Sensor Logger",
            (board,),
            origin_ns=int(first_ns) if 0.0 <= first_ns < 2e18 else 0,
            notes=tuple(notes),
        )


def _open(source: Path) -> SourceTables | None:
    is_zip = read_head(source, 2) == b"PK"
    return SourceTables(source) if source.is_dir() or is_zip else None


def _is_sensor(tables: SourceTables, name: str) -> bool:
    if not name.endswith(".csv"):
        return False
    columns = tables.header(name).split(",")
    return columns[:2] == ["time", "seconds_elapsed"]


def _choose_gyro(tables: SourceTables, topics: tuple[str, ...]) -> str:
    wanted = tuple(f"{topic.removesuffix('.csv')}.csv" for topic in topics) if topics else _GYROS
    for name in wanted:
        if name in tables.names:
            return name
    listed = ", ".join(name for name in tables.names if name.endswith(".csv"))[:200]
    raise InputError(
        f"the recording {tables.source.name} has no table {' or '.join(wanted)[:80]}, but only "
        f"{listed or 'other files'}",
        "log the gyroscope, if possible uncalibrated",
    )


def _sensor_rows(tables: SourceTables, name: str) -> np.ndarray:
    return tables.columns(name, ["x", "y", "z"]).matrix(["x", "y", "z"], 3)


def _properties(tables: SourceTables) -> dict[str, str]:
    rows = tables.text_rows("Metadata.csv")
    return dict(zip(rows[0], rows[1], strict=False)) if len(rows) >= 2 else {}


def _accel(
    tables: SourceTables, first_s: float, properties: dict[str, str], notes: list[str]
) -> AccelStream | None:
    name = next((name for name in _ACCELS if name in tables.names), None)
    if name is None:
        if "Accelerometer.csv" in tables.names:
            notes.append("Accelerometer.csv is not used, because it is without gravity")
        return None
    elapsed_s = tables.columns(name, ["seconds_elapsed"]).matrix(["seconds_elapsed"], 1)[:, 0]
    is_ios = properties.get("platform", "").lower() == "ios"
    is_standard = properties.get("standardisation", "").lower() == "true"
    in_g = name == _ACCELS[1] and is_ios and not is_standard
    unit = -STANDARD_GRAVITY_M_S2 if in_g else 1.0
    return AccelStream(unit * _sensor_rows(tables, name), elapsed_s - first_s)


FORMAT = SensorLogger()
