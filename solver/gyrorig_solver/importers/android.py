"""A phone's log: what the common Android loggers write, recognised by its own words.

What to use when: `read_log`. Two shapes are known. A table with a header line (Sensor
Logger, phyphox, MARS logger): the columns are found by their names. Lines that begin with a
sensor's tag and two times, the app's and the sensor's own (GetSensorData, GnssLogger,
Sensei): `TAG;app time;sensor time;x;y;z;...`.

A phone's stamp is a clock of its own: documented as nanoseconds since the start, met as Unix
time, or running twice as fast (ros-android/android_sensors_driver #24); it is never taken
for the time of day. Rates come in rad/s, from Android's `TYPE_GYROSCOPE` after a drift
correction of the system's own, from `TYPE_GYROSCOPE_UNCALIBRATED` without it: where a log has
both, that without is taken.

Source of the units: Android's SensorEvent (rad/s, m/s^2, axes of the phone: x to the right, y
up, z out of the screen).
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.importers.columns import MAX_ROWS, open_columns

NS = 1_000_000_000
MAX_LINE_CHARS = 10_000
MAX_STAMP_NS = 2**62
# Steps between samples that a phone's sensor can have: 4 to 2000 Hz. Units are 1000 apart.
STEP_S = (0.0005, 0.25)
UNITS = (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("s", 1.0))

UNCALIBRATED = ("gyru", "uncalgyro", "uncalibrated gyroscope sensor", "gyroscope uncalibrated")
GYRO = ("gyro", "gyr", "gyroscope", "gyroscope sensor", "rawgyro")
ACCEL = ("acce", "acc", "accelerometer", "acceleration sensor", "accelerometer sensor", "rawaccel")
UNCALIBRATED_ACCEL = ("accu", "uncalaccel", "uncalibrated acceleration sensor")


@dataclass(frozen=True, slots=True, eq=False)
class PhoneLog:
    """What a log holds of the gyroscope, and of the accelerometer if there is one."""

    stamp_ns: IntArray  # (n,), the phone's own, growing
    rate_rad_s: FloatArray  # (n, 3)
    accel_stamp_ns: IntArray | None
    accel_m_s2: FloatArray | None
    shape: str  # what was recognised
    notes: tuple[str, ...]


@dataclass(slots=True)
class _Stream:
    """Stamps as written, in nanoseconds where they are whole numbers, and three values."""

    stamps: list[float] = field(default_factory=list)
    values: list[tuple[float, float, float]] = field(default_factory=list)


def read_log(path: Path) -> PhoneLog:
    """Return what a phone's log holds.

    Raises:
        InputError: no file, no log that is known, or no gyroscope in it.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(f"{path} {what}", "name one log of a phone")
    notes: list[str] = []
    first = _first_line(path)
    if _is_tagged(path):
        shape, gyro, accel = _tagged(path, notes)
    elif re.search(r"[A-Za-z]", first):
        shape, gyro, accel = _table(path, first, notes)
    else:
        raise InputError(
            f"{path.name} is no log of a phone: neither a header nor tags",
            "import it as csv with a column map",
        )
    stamp_ns, rate = _sorted(*gyro, "gyroscope", notes)
    moment: tuple[IntArray | None, FloatArray | None] = (None, None)
    if accel is not None:
        moment = _sorted(*accel, "accelerometer", notes)
    return PhoneLog(stamp_ns, rate, *moment, shape, tuple(notes))


_Pair = tuple[IntArray, FloatArray]


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
                    f"{path.name} has more than {count} lines", "split it, and import each part"
                )


def _is_tagged(path: Path) -> bool:
    known = {*GYRO, *UNCALIBRATED, *ACCEL, *UNCALIBRATED_ACCEL}
    for count, line in enumerate(_lines(path)):
        fields = _fields(line)
        if len(fields) >= 6 and fields[0].lower() in known and _number(fields[2]) is not None:
            return True
        if count > 1000:
            break
    return False


def _fields(line: str) -> list[str]:
    separator = ";" if ";" in line else ","
    flat = line.replace("[", "").replace("]", "")
    if separator == ";":  # Sensei has "name;ms;ns;[x, y, z]"
        flat = flat.replace(",", ";")
    return [part.strip() for part in flat.split(separator)]


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _tagged(path: Path, notes: list[str]) -> tuple[str, _Pair, _Pair | None]:
    streams: dict[str, _Stream] = {}
    unread = 0
    for line in _lines(path):
        fields = _fields(line)
        tag = fields[0].lower()
        if tag not in (*GYRO, *UNCALIBRATED, *ACCEL, *UNCALIBRATED_ACCEL):
            continue
        numbers = [_number(text) for text in fields[2:6]]
        if len(numbers) < 4 or any(number is None for number in numbers):
            unread += 1
            continue
        stamp, x, y, z = (number or 0.0 for number in numbers)
        stream = streams.setdefault(tag, _Stream())
        stream.stamps.append(stamp)
        stream.values.append((x, y, z))
    if unread:
        notes.append(f"{unread} lines with a sensor's tag could not be read")
    gyro = _chosen(streams, UNCALIBRATED, GYRO, notes)
    if gyro is None:
        raise InputError(
            f"{path.name} holds no gyroscope, only {', '.join(streams)[:120]}",
            "have the app log the gyroscope, uncalibrated if it can",
        )
    accel = _chosen(streams, UNCALIBRATED_ACCEL, ACCEL, [])
    return "tagged lines", gyro, accel


def _chosen(
    streams: dict[str, _Stream], better: Sequence[str], usual: Sequence[str], notes: list[str]
) -> _Pair | None:
    for tags, corrected in ((better, False), (usual, True)):
        for tag in tags:
            stream = streams.get(tag)
            if stream is None or len(stream.stamps) < 3:
                continue
            if corrected:
                notes.append(_CORRECTED)
            stamps = np.array(stream.stamps, dtype=np.float64)
            return _as_ns(stamps, "", "the log"), np.array(stream.values, dtype=np.float64)
    return None


_CORRECTED = (
    "the rates may be corrected by Android for a bias that it changes while it runs: log "
    "TYPE_GYROSCOPE_UNCALIBRATED if the app can"
)


def _table(path: Path, header: str, notes: list[str]) -> tuple[str, _Pair, _Pair | None]:
    delimiter = max(",;\t", key=header.count)
    names = [name.strip().strip('"').strip("\ufeff") for name in header.split(delimiter)]
    time = _time_column(names)
    gyro = _axes(names, r"gyr|omega|angular|rotation ?rate|^w|^g(?=[ _]?[xyz]\b)")
    if gyro is None and re.search(r"gyr", path.stem, re.IGNORECASE):
        gyro = _axes(names, r"^")  # a file of its own for each sensor, columns x, y, z
    if time is None or gyro is None:
        raise InputError(
            f"{path.name} has no columns that say time and a gyroscope's x, y, z",
            f"it has {', '.join(names)[:120]}; import it as csv with a column map",
        )
    if not re.search(r"uncal", path.stem + header, re.IGNORECASE):
        notes.append(_CORRECTED)
    accel = _axes(names, r"acc|^a(?=[ _]?[xyz]\b)")
    # the header's names as they stand: the reader strips blanks only
    columns = open_columns(path, [time, *gyro, *(accel or ())])
    stamps = columns.matrix([time], 1)[:, 0]
    stamp_ns = _as_ns(stamps, time, path.name)
    rates = columns.matrix(gyro, 3)
    if re.search(r"deg|°|\bdps", "".join(gyro)):
        rates = np.radians(rates)
    moment = None if accel is None else (stamp_ns, columns.matrix(accel, 3))
    return "a table", (stamp_ns, rates), moment


def _time_column(names: Sequence[str]) -> str | None:
    """Return the column with the sensor's own time, which is never one of the time of day."""
    for wanted in (
        r"sensor.?(time|stamp)", r"seconds_elapsed", r"elapsed", r"^timestamp", r"^time\b",
        r"^t\b", r"timestamp", r"time",
    ):  # fmt: skip
        for name in names:
            if re.search(wanted, name.lower()) and not re.search(r"unix|utc|epoch", name.lower()):
                return name
    return None


def _axes(names: Sequence[str], of: str) -> list[str] | None:
    """Return the names of x, y and z of one sensor."""
    found: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[\[(].*?[\])]", "", name.lower()).strip()
        axis = re.search(r"(?:^|[^a-z]|(?<=[agw]))([xyz])(?:$|[^a-z])", plain)
        if axis and re.search(of, plain) and axis[1] not in found:
            found[axis[1]] = name
    return [found[axis] for axis in "xyz"] if len(found) == 3 else None


def _as_ns(stamps: FloatArray, name: str, where: str) -> IntArray:
    """Return stamps in ns; their unit is said by the column's name, or by how far they step."""
    if stamps.size < 3:
        raise InputError(
            f"{where} holds {stamps.size} samples of the gyroscope", "log for a minute or more"
        )
    steps = np.diff(stamps)
    steps = steps[steps > 0.0]
    step = float(np.median(steps)) if steps.size else 0.0
    said = re.search(
        r"[\[(_ ]\s*(nano\w*|micro\w*|milli\w*|sec\w*|ns|us|ms|s)\s*[\])]?$", name.lower()
    )
    for unit, worth in UNITS:
        if said and _unit(said[1]) != unit:
            continue
        if said or STEP_S[0] <= step * worth < STEP_S[1]:
            times = stamps * (worth * NS)
            if np.any(~np.isfinite(times)) or np.abs(times).max() > MAX_STAMP_NS:
                raise InputError(
                    f"{where}: a stamp is no time", "correct the time column, or log again"
                )
            return np.asarray(np.rint(times), dtype=np.int64)
    raise InputError(
        f"{where}: stamps step by {step:g}, in no unit a rate of 4 to 2000 Hz",
        "say their unit in a column map, and import it as csv",
    )


def _unit(word: str) -> str:
    return {"n": "ns", "u": "us", "s": "s"}.get(word[0]) or ("us" if word[:3] == "mic" else "ms")


def _sorted(stamp_ns: IntArray, values: FloatArray, what: str, notes: list[str]) -> _Pair:
    """Return the samples in the order of their stamps, each stamp once."""
    there = np.all(np.isfinite(values), axis=1)
    stamp_ns, values = stamp_ns[there], values[there]
    order = np.argsort(stamp_ns, kind="stable")
    moved = int(np.sum(np.diff(stamp_ns) < 0))
    stamp_ns, values = stamp_ns[order], values[order]
    new = np.concatenate([[True], np.diff(stamp_ns) > 0])
    if moved:
        notes.append(f"{what}: {moved} times a stamp ran back; sorted by stamp")
    if not new.all():
        notes.append(f"{what}: {int((~new).sum())} samples with the stamp of another left out")
    if new.sum() < 3:
        raise InputError(
            f"the {what} has {int(new.sum())} samples with stamps of their own",
            "log for a minute or more, with an app that writes every sample's own stamp",
        )
    return stamp_ns[new], values[new]
