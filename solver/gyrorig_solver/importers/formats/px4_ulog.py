"""Logs of the flight controller PX4 (ULog), with one board per gyroscope.

Source: PX4, "ULog file format", and msg/SensorGyro.msg (x, y, z in rad/s,
temperature), VehicleImu.msg (delta_angle in rad over delta_angle_dt in us), SensorCombined.msg
(gyro_rad), SensorAccel.msg, VehicleOdometry.msg (q: w, x, y, z, body to world). `timestamp_sample`
and `timestamp` are in us since the start. The rates of vehicle_imu and sensor_combined are in the
body frame, offset-compensated by PX4 where possible (VehicleImu.msg, SensorCombined.msg).
sensor_combined is that of the gyroscope which sensor_selection names ("Sensor ID's for the voted
sensors output on the sensor_combined topic", SensorSelection.msg). vehicle_attitude comes from the
filter EKF2, which uses the same gyroscopes. vehicle_mocap_odometry and vehicle_visual_odometry come
from outside.
"""

import contextlib
import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.flight_boards import RateSource, choose_source, name_boards
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    MeasuredStreams,
    PoseStream,
    TemperatureStream,
)
from gyrorig_solver.importers.measurement_format import (
    BOARD_OPTIONS,
    FormatMatch,
    ImportOptions,
    read_head,
)
from gyrorig_solver.importers.px4_gyroscopes import (
    GYROS,
    SELECTION,
    Px4Gyroscope,
    Topic,
    processing_notes,
    rate_sources,
    time_s_of,
    triple,
)

MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35"
MAX_BYTES = 4_000_000_000
MAX_FIELDS = 5_000  # of one topic, with those of nested types; PX4 has up to a few hundred
_MAX_UNKNOWN_BYTES = 10_000  # of a message of an unknown type that pyulog skips
_OUTSIDE_ATTITUDES = ("vehicle_mocap_odometry", "vehicle_visual_odometry")
_OWN_ATTITUDE = "vehicle_attitude"
_ACCEL = "sensor_accel"


@dataclass(frozen=True, slots=True)
class Px4Ulog:
    """The gyroscopes of one flight controller, and an attitude from outside if it has one."""

    name: str = "ulog"
    title: str = "PX4 log (ULog)"
    extra: str = "flight"
    used_options: frozenset[str] = BOARD_OPTIONS | {"topics"}

    def detect(self, source: Path) -> FormatMatch | None:
        """Return a match for the first bytes of a ULog file."""
        return FormatMatch("a PX4 log (ULog)") if read_head(source, 7) == MAGIC else None

    def read(self, source: Path, options: ImportOptions) -> MeasuredStreams:
        """Return one board per gyroscope; `--topic vehicle_attitude` uses PX4's attitude."""
        options.check_topics((*GYROS, _OWN_ATTITUDE, *_OUTSIDE_ATTITUDES))
        notes: list[str] = []
        topics = _read_topics(source, notes)
        wanted = frozenset(options.topics)
        boards = []
        for gyroscope in rate_sources(topics, wanted, notes):
            chosen = choose_source(gyroscope.sources, notes, f"gyroscope {gyroscope.name}")
            if chosen is not None:
                notes += processing_notes(gyroscope.name, chosen.name)
                boards.append(_board(gyroscope, chosen, topics, options))
        if not boards:
            listed = ", ".join(sorted(topics))[:200] or "no data"
            raise InputError(
                f"the log {source.name} contains no gyroscope (sensor_gyro, vehicle_imu or "
                f"sensor_combined), but only {listed}",
                "set SDLOG_PROFILE to high rate or sensor comparison in PX4, and record again",
            )
        poses = _poses(topics, wanted, notes)
        return MeasuredStreams(
            f"imported from {source.name}: ULog of PX4",
            name_boards(boards, options.board, "GYRO"),
            poses=poses,
            notes=tuple(notes),
        )


def _read_topics(source: Path, notes: list[str]) -> dict[str, list[Topic]]:
    """Return the topics that are used, by name; may append to `notes`.

    Raises:
        InputError: the log is damaged.
    """
    _check_definitions(source)
    from pyulog import ULog  # type: ignore[import-untyped] # noqa: PLC0415 - of the extra

    names = [*GYROS, SELECTION, *_OUTSIDE_ATTITUDES, _OWN_ATTITUDE, _ACCEL]
    try:
        with source.open("rb") as file, contextlib.redirect_stdout(io.StringIO()):
            log = ULog(file, names)  # prints warnings
    except ModuleNotFoundError:
        raise
    except Exception as error:  # pyulog raises what its parsing of damaged bytes happens to raise
        raise InputError(
            f"the ULog file {source.name} is damaged ({type(error).__name__})",
            "copy the log from the flight controller again",
        ) from error
    if log.file_corruption:
        notes.append("a part of the log is damaged and was left out")
    topics: dict[str, list[Topic]] = {}
    for part in log.data_list:
        if "timestamp" in part.data and part.data["timestamp"].size:
            topics.setdefault(part.name, []).append((part.multi_id, part.data))
    return topics


def _check_definitions(source: Path) -> None:
    """Check that no type of the log has too many fields, because pyulog lists them all.

    Raises:
        InputError: the log is too large, or a type has too many fields.
    """
    if source.stat().st_size > MAX_BYTES:
        raise InputError(
            f"the log {source.name} has more than 4 GB", "give a log of a shorter flight"
        )
    fields: dict[str, list[tuple[str, int]]] = {}
    for text in _definitions(source):
        name, _, listed = text.partition(":")
        members = []
        for member in listed.split(";")[:MAX_FIELDS]:
            kind, _, count = member.split(" ")[0].partition("[")
            digits = count.rstrip("]")
            members.append((kind, int(digits) if digits.isdecimal() and len(digits) < 7 else 1))
        fields[name] = members
    known: dict[str, int] = {}
    for name in fields:
        if _field_count(name, fields, known, 0) > MAX_FIELDS:
            raise InputError(
                f"the ULog file {source.name} is damaged: the type {name[:40]!r} has too many "
                "fields",
                "copy the log from the flight controller again",
            )


def _definitions(source: Path) -> Iterator[str]:
    """Yield the format definitions of a log, "name:type field;type field".

    Raises:
        InputError: the definitions are damaged, so that pyulog would search for others.
    """
    with source.open("rb") as file:
        file.seek(16)
        while len(head := file.read(3)) == 3:
            size, kind = struct.unpack("<HB", head)
            if kind in b"ALC":  # the data begin
                return
            is_known = kind in b"BFIMPQ"
            body = file.read(size)
            # pyulog would search for other definitions, without end in a file that is cut
            if len(body) < size or not (is_known or (kind and 0 < size <= _MAX_UNKNOWN_BYTES)):
                raise InputError(
                    f"the definitions in the ULog file {source.name} are damaged or incomplete",
                    "copy the log from the flight controller again",
                )
            if kind in b"F":
                yield body.decode("utf-8", errors="ignore")


def _field_count(
    name: str, fields: dict[str, list[tuple[str, int]]], known: dict[str, int], depth: int
) -> int:
    """Return the number of fields of a type; a type that contains itself has too many."""
    if name not in fields:
        return 1
    if depth > 8:
        return MAX_FIELDS + 1
    if name not in known:
        total = 0
        for kind, count in fields[name]:
            total += max(count, 1) * _field_count(kind, fields, known, depth + 1)
            if total > MAX_FIELDS:
                break
        known[name] = total
    return known[name]


def _instance(
    topics: dict[str, list[Topic]], name: str, number: int | None
) -> dict[str, Any] | None:
    return next((columns for multi, columns in topics.get(name, []) if multi == number), None)


def _board(
    gyroscope: Px4Gyroscope,
    chosen: RateSource,
    topics: dict[str, list[Topic]],
    options: ImportOptions,
) -> MeasuredBoard:
    instance = gyroscope.instance
    gyro = _instance(topics, "sensor_gyro", instance) or {}
    metadata = {"sensor": options.sensor or "unknown", "model": "PX4"}
    if gyroscope.device_id:
        metadata["uid"] = str(gyroscope.device_id)
    accel = None
    raw = _instance(topics, _ACCEL, instance)
    if raw is not None:
        values = triple(raw, ("x", "y", "z"))
        accel = values if values is None else RateSource(_ACCEL, time_s_of(raw), values).in_order()
    temperature = None
    if "temperature" in gyro:
        time_s, first = np.unique(time_s_of(gyro), return_index=True)
        with np.errstate(invalid="ignore"):
            degc = np.asarray(gyro["temperature"], dtype=np.float64)[first]
        if np.any(np.isfinite(degc)) and time_s.size > 1:
            temperature = TemperatureStream(degc, time_s)
    return MeasuredBoard(
        gyroscope.name,
        GyroStream(chosen.time_s, chosen.rate_rad_s),
        None if accel is None else AccelStream(accel.rate_rad_s, accel.time_s),
        temperature,
        metadata,
    )


def _poses(
    topics: dict[str, list[Topic]], wanted: frozenset[str], notes: list[str]
) -> PoseStream | None:
    name = next((name for name in _OUTSIDE_ATTITUDES if name in topics), None)
    if _OWN_ATTITUDE in wanted and _OWN_ATTITUDE in topics:
        name = _OWN_ATTITUDE
        notes.append("the reference is vehicle_attitude, computed from the same gyroscopes")
    elif _OWN_ATTITUDE in topics:
        notes.append(
            "vehicle_attitude is not used as a reference, because PX4 computes it from the same "
            "gyroscopes (--topic vehicle_attitude uses it)"
        )
    if name is None:
        return None
    columns = topics[name][0][1]
    if any(f"q[{index}]" not in columns for index in range(4)):
        notes.append(f"{name} has no attitude")
        return None
    with np.errstate(invalid="ignore"):
        values = np.stack(
            [np.asarray(columns[f"q[{index}]"], dtype=np.float64) for index in (1, 2, 3, 0)], axis=1
        )
    poses = PoseStream.of_rows(time_s_of(columns), values)
    if not poses.time_s.size:
        notes.append(f"{name} has no valid attitude")
        return None
    return poses


FORMAT = Px4Ulog()
