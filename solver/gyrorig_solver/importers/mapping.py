"""The import map: which column of somebody's file is what, in which unit.

What to use when: `load_import_map` reads and checks a map file; the structures are its
shape, with unknown keys refused. Every map that this project ships is in config/imports.
"""

import math
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gyrorig_protocol.documents import parse_yaml, read_as
from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId

SCHEMA = "gyrorig/import/1"

Key = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Keys = Annotated[list[Key], msgspec.Meta(min_length=1, max_length=4)]


class _Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the map's parts: unknown keys are refused."""


class TimeBase(_Part, frozen=True):
    """Where a stream's times come from: a column, or a rate and the row number.

    `stamp: arrival` says that the column holds when a sample reached the host, in bursts
    maybe; then `rate_hz` is the sensor's nominal rate and the row number its clock.
    """

    key: Key | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    rate_hz: Positive | None = None
    rate_key: Key | None = None  # an array that holds the rate
    origin_s: float = 0.0  # added to every time
    stamp: Literal["sampled", "arrival"] = "sampled"


class GyroColumns(_Part, frozen=True):
    """The gyro: one array of three columns, or three columns."""

    keys: Keys
    unit: Literal["rad/s", "deg/s", "counts"]
    scale_rad_s: Positive | None = None  # a count's nominal worth, with unit counts
    offset_counts: int = 0  # the code of zero in offset binary, taken off
    full_scale_dps: Positive | None = None
    bandwidth_hz: Positive | None = None


class AccelColumns(_Part, frozen=True):
    """The accelerometer, with its own times if it has any."""

    keys: Keys
    unit: Literal["m/s2", "g", "counts"]
    scale_m_s2: Positive | None = None
    offset_counts: int = 0
    time: TimeBase | None = None


class TemperatureColumn(_Part, frozen=True):
    """The temperature in degrees Celsius, with its own times if it has any."""

    key: Key
    time: TimeBase | None = None


class AttitudeColumns(_Part, frozen=True):
    """A reference attitude, body into world; rows that are not finite are lost ones."""

    keys: Keys
    order: Literal["wxyz", "xyzw"]
    std_deg: Positive | None = None  # per axis, where the source says it
    time: TimeBase | None = None


class Span(_Part, frozen=True):
    """A stretch by row numbers [start, end), or by the source's times; open ends reach out."""

    start: Annotated[int, msgspec.Meta(ge=0)] | None = None
    end: Annotated[int, msgspec.Meta(ge=0)] | None = None
    begin_s: float | None = None
    end_s: float | None = None


class Turn(_Part, frozen=True):
    """A known turn: axis in the stage frame, signed angle, its standard deviation."""

    axis: Triple
    angle_deg: float
    std_deg: Positive
    over: Span = Span()


class SectionFile(_Part, frozen=True):
    """Sections listed in a JSON file beside the input: name -> {start, end} rows."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[^/\\]+\.json$")]
    static: list[Key] = []
    turns: dict[str, Turn] = {}


class StaticMask(_Part, frozen=True):
    """Rest is where a column has this value, for at least `shortest_s`."""

    key: Key
    value: float
    shortest_s: Positive = 1.0


class ImportMap(_Part, frozen=True):
    """How one kind of file becomes a recording."""

    schema: Literal["gyrorig/import/1"]
    board: Key
    sensor: str
    time: TimeBase
    gyro: GyroColumns
    uid: str = "unknown"
    model: str | None = None
    source: str | None = None  # where the data comes from, for the reader of a recording
    accel: AccelColumns | None = None
    temperature: TemperatureColumn | None = None
    attitude: AttitudeColumns | None = None
    static: list[Span] = []
    static_mask: StaticMask | None = None
    turns: list[Turn] = []
    sections: SectionFile | None = None
    gravity_m_s2: Positive | None = None


def load_import_map(path: Path) -> ImportMap:
    """Return the map in a YAML file.

    Raises:
        UsageError: the file cannot be read, or asks for what makes no sense.
    """
    try:
        text = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"cannot read the import map {path}, {error.strerror}",
            "name one with --map, such as those in config/imports",
        ) from error
    return check_import_map(read_as(parse_yaml(text, path.name), ImportMap, path.name), path.name)


def check_import_map(found: ImportMap, name: str) -> ImportMap:
    """Return the map if its parts agree with each other.

    Raises:
        UsageError: they do not; the text says which.
    """
    BoardId(found.board)
    for where, part in (
        ("time", found),
        ("accel: time", found.accel),
        ("temperature: time", found.temperature),
        ("attitude: time", found.attitude),
    ):
        if part is not None and part.time is not None:
            _check_time(part.time, f"{name}: {where}")
    if found.gyro.unit == "counts" and found.gyro.scale_rad_s is None:
        raise UsageError(
            f"{name}: gyro counts without scale_rad_s",
            "give what a count is worth by the data sheet, in rad/s",
        )
    if found.accel and found.accel.unit == "counts" and found.accel.scale_m_s2 is None:
        raise UsageError(
            f"{name}: accel counts without scale_m_s2",
            "give what a count is worth by the data sheet, in m/s^2",
        )
    for where, columns, width in (
        ("gyro", found.gyro, 3),
        ("accel", found.accel, 3),
        ("attitude", found.attitude, 4),
    ):
        if columns is not None and len(columns.keys) not in (1, width):
            raise UsageError(
                f"{name}: {where} has {len(columns.keys)} keys",
                f"give one array of {width} columns, or {width} keys",
            )
    turns = [*found.turns, *(found.sections.turns.values() if found.sections else ())]
    for turn in turns:
        if not math.isclose(math.hypot(*turn.axis), 1.0, abs_tol=1e-6):
            raise UsageError(
                f"{name}: the turn axis {turn.axis} has not the length 1",
                "divide it by its length, such as [0.0, 0.0, 1.0]",
            )
    return found


def _check_time(time: TimeBase, name: str) -> None:
    if time.stamp == "arrival":
        if time.key is None or time.rate_hz is None:
            raise UsageError(
                f"{name}: arrival times want key and rate_hz",
                "give the column of arrivals and the sensor's nominal rate",
            )
    elif sum(given is not None for given in (time.key, time.rate_hz, time.rate_key)) != 1:
        raise UsageError(
            f"{name} wants one of key, rate_hz, rate_key",
            "give one: a column of times, a rate, or an array that holds the rate",
        )
