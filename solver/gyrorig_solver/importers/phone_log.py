"""Phone logs of the common Android loggers.

What to use when: `read_phone_log`. Two layouts are supported. The first is a table with a
header line (Sensor Logger, phyphox, MARS logger); the columns are found by their names. In the
second every line begins with a sensor's tag, the time of the app and the time of the sensor
(GetSensorData, GnssLogger, Sensei): `TAG;app time;sensor time;x;y;z;...`.

The timestamps of a phone are those of a separate clock. Android documents them as nanoseconds
since the start; some phones write Unix time or a clock that runs twice as fast
(ros-android/android_sensors_driver #24). They are never used as the time of day. Rates are in
rad/s. Android's `TYPE_GYROSCOPE` contains a drift correction, `TYPE_GYROSCOPE_UNCALIBRATED`
does not; if a log has both, the uncalibrated rates are used.

Source of the units: Android's SensorEvent (rad/s, m/s^2, axes of the phone: x to the right, y
up, z out of the screen).
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.text_table import check_text_table
from gyrorig_solver.importers.header_units import accel_factor, rate_factor
from gyrorig_solver.importers.import_times import order_by_time
from gyrorig_solver.importers.measurement_columns import open_columns
from gyrorig_solver.importers.text_columns import MAX_ROWS

NS = 1_000_000_000
MAX_LINE_CHARS = 10_000
MAX_TAG_LINES = 1000  # before the first line with a tag
MAX_STAMP_NS = 2**62
# Sample periods of a phone's sensor, 4 to 2000 Hz. Time units differ by a factor of 1000.
PERIOD_RANGE_S = (0.0005, 0.25)
TIME_UNITS = (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("s", 1.0))

UNCALIBRATED_GYRO_TAGS = (
    "gyru",
    "uncalgyro",
    "uncalibrated gyroscope sensor",
    "gyroscope uncalibrated",
)
GYRO_TAGS = ("gyro", "gyr", "gyroscope", "gyroscope sensor", "rawgyro")
ACCEL_TAGS = (
    "acce",
    "acc",
    "accelerometer",
    "acceleration sensor",
    "accelerometer sensor",
    "rawaccel",
)
UNCALIBRATED_ACCEL_TAGS = ("accu", "uncalaccel", "uncalibrated acceleration sensor")


@dataclass(frozen=True, slots=True, eq=False)
class PhoneLog:
    """The gyroscope samples of a log, and those of the accelerometer if present."""

    stamp_ns: IntArray  # (n,), the phone's clock, increasing
    rate_rad_s: FloatArray  # (n, 3)
    accel_stamp_ns: IntArray | None
    accel_m_s2: FloatArray | None
    layout: str  # the recognised layout
    notes: tuple[str, ...]


@dataclass(slots=True)
class _SensorLines:
    """Timestamps as written, and three values each."""

    stamps: list[float] = field(default_factory=list)
    values: list[tuple[float, float, float]] = field(default_factory=list)


def read_phone_log(path: Path) -> PhoneLog:
    """Return the samples of a phone's log.

    Raises:
        InputError: the file is missing, has an unknown layout, or has no gyroscope.
    """
    if not path.is_file():
        problem = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(f"the phone's log {path} {problem}", "give the path of one log file")
    check_text_table(path)
    notes: list[str] = []
    first = _first_line(path)
    if has_sensor_tags(_lines(path)):
        layout, gyro, accel = _read_tagged(path, notes)
    elif re.search(r"[A-Za-z]", first):
        layout, gyro, accel = _read_table(path, first, notes)
    else:
        raise InputError(
            f"the file {path.name} is not a log of a phone, because it has neither a header "
            "nor sensor tags",
            "if it is a table, import it with `gyrorig import csv` and a column map (--map)",
        )
    stamp_ns, rate = _sort_by_stamp(*gyro, "gyroscope", notes)
    accel_pair: tuple[IntArray | None, FloatArray | None] = (None, None)
    if accel is not None:
        accel_pair = _sort_by_stamp(*accel, "accelerometer", notes)
    return PhoneLog(stamp_ns, rate, *accel_pair, layout, tuple(notes))


_StampedValues = tuple[IntArray, FloatArray]


def _first_line(path: Path) -> str:
    with path.open(encoding="utf-8", errors="replace") as lines:
        return lines.readline(MAX_LINE_CHARS)


def _lines(path: Path) -> Iterator[str]:
    with path.open(encoding="utf-8", errors="replace") as lines:
        for count in range(8 * MAX_ROWS):
            line = lines.readline(MAX_LINE_CHARS)
            if not line:
                return
            yield line
            if count == 4 * MAX_ROWS:
                raise InputError(
                    f"the phone's log {path.name} has more than {count} lines",
                    "split the file, and import each part",
                )


def has_sensor_tags(lines: Iterable[str]) -> bool:
    """Return whether one of the first lines begins with a sensor's tag and has its values."""
    known = {*GYRO_TAGS, *UNCALIBRATED_GYRO_TAGS, *ACCEL_TAGS, *UNCALIBRATED_ACCEL_TAGS}
    for line in islice(lines, MAX_TAG_LINES):
        fields = _fields(line)
        if len(fields) >= 6 and fields[0].lower() in known and _number(fields[2]) is not None:
            return True
    return False


def _fields(line: str) -> list[str]:
    if ";" not in line:
        return [part.strip() for part in re.sub(r"[\[\]]", "", line).split(",")]
    # Sensei has "name;ms;ns;[x, y, z]"; any other comma is a decimal comma
    flat = re.sub(r"\[([^\]]*)\]", lambda match: _split_list(match[1]), line)
    return [part.strip().replace(",", ".") for part in flat.split(";")]


def _split_list(text: str) -> str:
    return re.sub(r",\s+" if re.search(r",\s", text) else ",", ";", text)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


_PART = re.compile(r"0\d+")  # the decimals of a number that a comma divides


def _read_tagged(path: Path, notes: list[str]) -> tuple[str, _StampedValues, _StampedValues | None]:
    streams: dict[str, _SensorLines] = {}
    unread = 0
    has_point = has_leading_zero = False
    for line in _lines(path):
        fields = _fields(line)
        tag = fields[0].lower()
        if tag not in (*GYRO_TAGS, *UNCALIBRATED_GYRO_TAGS, *ACCEL_TAGS, *UNCALIBRATED_ACCEL_TAGS):
            continue
        has_point = has_point or any("." in text for text in fields[1:6])
        has_leading_zero = has_leading_zero or any(_PART.fullmatch(text) for text in fields[1:])
        numbers = [_number(text) for text in fields[2:6]]
        if len(numbers) < 4 or any(number is None for number in numbers):
            unread += 1
            continue
        stamp, x, y, z = (number or 0.0 for number in numbers)
        stream = streams.setdefault(tag, _SensorLines())
        stream.stamps.append(stamp)
        stream.values.append((x, y, z))
    if has_leading_zero and not has_point:
        raise InputError(
            f"the numbers in the phone's log {path.name} have decimal commas, and commas are also "
            "between the numbers, so they cannot be read",
            "log again with a language of the phone that has decimal points, for example English",
        )
    if unread:
        notes.append(f"{unread} lines with a sensor tag could not be read")
    gyro = _choose_stream(streams, UNCALIBRATED_GYRO_TAGS, GYRO_TAGS, notes)
    if gyro is None:
        raise InputError(
            f"the phone's log {path.name} contains no gyroscope data, but only "
            f"{', '.join(streams)[:120]}",
            "also log the gyroscope, if possible uncalibrated",
        )
    accel = _choose_stream(streams, UNCALIBRATED_ACCEL_TAGS, ACCEL_TAGS, [])
    return "tagged lines", gyro, accel


def _choose_stream(
    streams: dict[str, _SensorLines],
    uncalibrated_tags: Sequence[str],
    calibrated_tags: Sequence[str],
    notes: list[str],
) -> _StampedValues | None:
    for tags, corrected in ((uncalibrated_tags, False), (calibrated_tags, True)):
        for tag in tags:
            stream = streams.get(tag)
            if stream is None or len(stream.stamps) < 3:
                continue
            if corrected:
                notes.append(_CORRECTED_NOTE)
            stamps = np.array(stream.stamps, dtype=np.float64)
            return _stamps_in_ns(stamps, "", "the log"), np.array(stream.values, dtype=np.float64)
    return None


_CORRECTED_NOTE = (
    "the rates may contain a bias correction by Android that changes during the log; log "
    "TYPE_GYROSCOPE_UNCALIBRATED if the app can"
)


def _read_table(
    path: Path, header: str, notes: list[str]
) -> tuple[str, _StampedValues, _StampedValues | None]:
    delimiter = max(",;\t", key=header.count)
    names = [name.strip().strip('"').strip("\ufeff") for name in header.split(delimiter)]
    time = _time_column(names)
    gyro = _axis_columns(names, r"gyr|omega|angular|rotation ?rate|^w|^g(?=[ _]?[xyz]\b)")
    if gyro is None and re.search(r"gyr", path.stem, re.IGNORECASE):
        # one file per sensor, with the columns x, y, z
        gyro = _axis_columns(names, r"^(?!.*(?:acc|mag))")
    if time is None or gyro is None:
        raise InputError(
            f"the phone's log {path.name} has no columns for the time and the gyroscope's x, "
            f"y and z, but only {', '.join(names)[:120]}",
            "import the file with `gyrorig import csv` and a column map (--map)",
        )
    if not re.search(r"uncal", path.stem + header, re.IGNORECASE):
        notes.append(_CORRECTED_NOTE)
    accel = _axis_columns(names, r"acc|^a(?=[ _]?[xyz]\b)")
    # the names as in the header: the reader strips blanks only
    columns = open_columns(path, [time, *gyro, *(accel or ())])
    stamps = columns.matrix([time], 1)[:, 0]
    stamp_ns = _stamps_in_ns(stamps, time, path.name)
    rates = rate_factor(gyro, notes) * columns.matrix(gyro, 3)
    accel_pair = None
    if accel is not None:
        accel_pair = (stamp_ns, accel_factor(accel, notes) * columns.matrix(accel, 3))
    return "a table", (stamp_ns, rates), accel_pair


def _time_column(names: Sequence[str]) -> str | None:
    """Return the column of the sensor's clock, never one with the time of day."""
    for wanted in (
        r"sensor.?(time|stamp)", r"seconds_elapsed", r"elapsed", r"^timestamp", r"^time\b",
        r"^t\b", r"timestamp", r"time",
    ):  # fmt: skip
        for name in names:
            if re.search(wanted, name.lower()) and not re.search(r"unix|utc|epoch", name.lower()):
                return name
    return None


_AXIS = re.compile(
    r"(?:^|[^a-z]|(?<=[agw])|(?<=gyr)|(?<=gyro)|(?<=acc)|(?<=accel)|(?<=omega))([xyz])(?:$|[^a-z])"
)


def _axis_columns(names: Sequence[str], sensor_pattern: str) -> list[str] | None:
    """Return the columns x, y and z of one sensor, without those of a corrected copy.

    Raises:
        InputError: two sensors of this kind have such columns.
    """
    columns: dict[str, list[str]] = {}
    for name in names:
        bare_name = re.sub(r"[\[(].*?[\])]", "", name.lower()).strip()
        axis = _AXIS.search(bare_name)
        if axis and re.search(sensor_pattern, bare_name) and "linear" not in bare_name:
            columns.setdefault(axis[1], []).append(name)
    if len(columns) != 3:
        return None
    chosen = []
    for axis_name in "xyz":
        raw = [name for name in columns[axis_name] if "uncal" in name.lower()]
        candidates = raw or columns[axis_name]
        if len(set(candidates)) > 1:
            raise InputError(
                f"the columns {candidates[0][:40]} and {candidates[1][:40]} of the phone's log "
                "both seem to be the same axis of a sensor",
                "import the log with `gyrorig import csv` and a column map (--map)",
            )
        chosen.append(candidates[0])
    return chosen


def _stamps_in_ns(timestamps: FloatArray, name: str, where: str) -> IntArray:
    """Return timestamps in ns; the unit follows from the column's name or from the period."""
    if timestamps.size < 3:
        raise InputError(
            f"the phone's log {where} has only {timestamps.size} samples of the gyroscope",
            "record a log of at least a minute",
        )
    steps = np.diff(timestamps)
    steps = steps[steps > 0.0]
    step = float(np.median(steps)) if steps.size else 0.0
    named_unit = re.search(
        r"[\[(_ ]\s*(nano\w*|micro\w*|milli\w*|sec\w*|ns|us|ms|s)\s*[\])]?$", name.lower()
    )
    for unit, seconds in TIME_UNITS:
        if named_unit and _unit_of_word(named_unit[1]) != unit:
            continue
        if named_unit or PERIOD_RANGE_S[0] <= step * seconds < PERIOD_RANGE_S[1]:
            times = timestamps * (seconds * NS)
            if np.any(~np.isfinite(times)) or np.abs(times).max() > MAX_STAMP_NS:
                raise InputError(
                    f"a timestamp in {where} is outside the valid range of times",
                    "correct the time column, or record the log again",
                )
            return np.asarray(np.rint(times), dtype=np.int64)
    raise InputError(
        f"the unit of the timestamps in {where} is unknown: they increase by {step:g} per sample, "
        "and in ns, us, ms and s this is not a sample rate of 4 to 2000 Hz",
        "write a column map with the unit of the timestamps, and import the log with the format "
        "csv",
    )


def _unit_of_word(word: str) -> str:
    return {"n": "ns", "u": "us", "s": "s"}.get(word[0]) or ("us" if word[:3] == "mic" else "ms")


def _sort_by_stamp(
    stamp_ns: IntArray, values: FloatArray, sensor: str, notes: list[str]
) -> _StampedValues:
    """Return the samples sorted by timestamp, each timestamp once."""
    stamp_ns, values = order_by_time(stamp_ns, values, sensor, notes)
    if stamp_ns.size < 3:
        raise InputError(
            f"the {sensor} samples in the phone's log have only {stamp_ns.size} "
            "different timestamps",
            "record a log of at least a minute, with an app that writes the time of every sample",
        )
    return stamp_ns, values
