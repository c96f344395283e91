"""The import map: meaning and unit of the columns of a measurement file.

What to use when: `load_import_map` reads and checks a map file. The structures define its keys;
unknown keys are errors. The maps that this project ships are in config/imports.
"""

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import convert_document, parse_yaml
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId

SCHEMA = "gyrorig/import/1"

ColumnKey = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
ColumnKeys = Annotated[list[ColumnKey], msgspec.Meta(min_length=1, max_length=4)]


class _MapPart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the parts of a map; unknown keys are errors."""


class TimeBase(_MapPart, frozen=True):
    """Source of the times of a stream: a column, or a rate and the row number.

    With `stamp: arrival` the column contains the arrival times at the host, possibly in
    bursts. Then `rate_hz` is the nominal rate of the sensor, and the row number is its clock.
    """

    key: ColumnKey | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Positive | None = None
    rate_key: ColumnKey | None = None  # an array with the rate
    origin_s: float = 0.0  # added to every time
    stamp: Literal["sampled", "arrival"] = "sampled"


class GyroColumns(_MapPart, frozen=True):
    """The gyroscope: one array of three columns, or three columns."""

    keys: ColumnKeys
    unit: Literal["rad/s", "deg/s", "counts"]
    scale_rad_s: Positive | None = None  # nominal scale of a count, with unit counts
    offset_counts: int = 0  # the code of zero in offset binary, subtracted
    full_scale_dps: Positive | None = None
    bandwidth_hz: Positive | None = None


class AccelColumns(_MapPart, frozen=True):
    """The accelerometer, with separate times if it has them."""

    keys: ColumnKeys
    unit: Literal["m/s2", "g", "counts"]
    scale_m_s2: Positive | None = None
    offset_counts: int = 0
    time: TimeBase | None = None


class TemperatureColumn(_MapPart, frozen=True):
    """The temperature in degrees Celsius, with separate times if it has them."""

    key: ColumnKey
    time: TimeBase | None = None


class AttitudeColumns(_MapPart, frozen=True):
    """A reference attitude; rows that are not finite are gaps.

    With `stamp: arrival` under `time` the attitudes are late by a delay that changes; the
    solver then finds the times of the frames. There `rate_hz` is not needed.
    """

    keys: ColumnKeys
    order: Literal["wxyz", "xyzw"]
    maps: Literal["body_to_world", "world_to_body"] = "body_to_world"
    std_deg: Positive | None = None  # per axis, if the source specifies it
    time: TimeBase | None = None


class SectionSpan(_MapPart, frozen=True):
    """A section by row numbers [start, end) or by times; a missing bound is open."""

    start: Annotated[int, msgspec.Meta(ge=0)] | None = None
    end: Annotated[int, msgspec.Meta(ge=0)] | None = None
    begin_s: float | None = None
    end_s: float | None = None


class MappedTurn(_MapPart, frozen=True):
    """A known turn: axis in the stage frame, signed angle, its standard deviation."""

    axis: Triple
    angle_deg: float
    std_deg: Positive
    over: SectionSpan = SectionSpan()


class SectionFile(_MapPart, frozen=True):
    """Sections listed in a JSON file next to the input: name -> {start, end} rows."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[^/\\]+\.json$")]
    static: list[ColumnKey] = []
    turns: dict[str, MappedTurn] = {}


class StaticMask(_MapPart, frozen=True):
    """Rests are the sections in which a column has this value for at least `shortest_s`."""

    key: ColumnKey
    value: float
    shortest_s: Positive = 1.0


class ImportMap(_MapPart, frozen=True):
    """How to convert one kind of file to a recording."""

    schema: Literal["gyrorig/import/1"]
    board: ColumnKey
    sensor: str
    time: TimeBase
    gyro: GyroColumns
    uid: str = "unknown"
    model: str | None = None
    source: str | None = None  # origin of the data, for readers of the recording
    accel: AccelColumns | None = None
    temperature: TemperatureColumn | None = None
    attitude: AttitudeColumns | None = None
    static: list[SectionSpan] = []
    static_mask: StaticMask | None = None
    turns: list[MappedTurn] = []
    sections: SectionFile | None = None
    gravity_m_s2: Positive | None = None


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
    for where, columns, width in (
        ("gyro", import_map.gyro, 3),
        ("accel", import_map.accel, 3),
        ("attitude", import_map.attitude, 4),
    ):
        if columns is not None and len(columns.keys) not in (1, width):
            raise UsageError(
                f"in the import map {name}, `keys` under `{where}` has {len(columns.keys)} "
                f"entries instead of 1 or {width}",
                f"give the name of one array with {width} columns, or {width} names of columns",
            )
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
