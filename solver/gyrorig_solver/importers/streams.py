"""Columns turned into what a recording holds: counts, nanoseconds, status bits.

What to use when: `read_streams` does all of it for one input; nothing is written before
everything in the input has been looked at.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.importers.columns import Columns
from gyrorig_solver.importers.mapping import (
    AccelColumns,
    AttitudeColumns,
    GyroColumns,
    ImportMap,
)
from gyrorig_solver.importers.times import (
    at_samples,
    device_clock,
    nanoseconds,
    read_times,
    said_rate,
)

# Contract: physical units become int32 counts with a scale fine enough to lose nothing.
GYRO_COUNT_RAD_S = 1e-7
ACCEL_COUNT_M_S2 = 1e-6
# int16 with this scale and offset covers a MEMS part's -40 to 85 degC in steps of 2 mK.
TEMPERATURE_COUNT_C = 0.002
TEMPERATURE_ZERO_C = 25.0
STANDARD_GRAVITY_M_S2 = 9.80665  # the unit g, CGPM 1901
INT32 = np.iinfo(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream:
    """One board's samples as they go into the recording."""

    host_time_ns: IntArray  # (n,)
    device_time: IntArray  # (n,), ticks
    row: IntArray  # (n,), row number in the source, which is the sample counter
    time_s: FloatArray  # (n,), the source's time
    status: IntArray  # (n,)
    temperature: IntArray  # (n,)
    gyro: IntArray  # (n, 3)
    accel: IntArray | None
    metadata: dict[str, str]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeStream:
    """Reference attitudes that are there; lost ones are gaps."""

    host_time_ns: IntArray  # (n,)
    orientation_xyzw: FloatArray  # (n, 4)
    standard_deviation_rad: float  # nan where the source does not say
    lost: int


def wanted_keys(mapping: ImportMap) -> list[str]:
    """Return every column that a map asks for."""
    keys = list(mapping.gyro.keys)
    for part in (mapping.accel, mapping.attitude):
        keys += part.keys if part else []
    if mapping.temperature:
        keys.append(mapping.temperature.key)
    if mapping.static_mask:
        keys.append(mapping.static_mask.key)
    for part_with_time in (mapping, mapping.accel, mapping.temperature, mapping.attitude):
        time = part_with_time.time if part_with_time is not None else None
        keys += [key for key in (time.key, time.rate_key) if key] if time else []
    return keys


def read_streams(columns: Columns, mapping: ImportMap) -> tuple[ImuStream, AttitudeStream | None]:
    """Return the samples and the reference attitude of one input.

    Raises:
        InputError: times run back, a value does not fit, or nothing usable is there.
    """
    gyro = columns.matrix(mapping.gyro.keys, 3)
    time_s = read_times(columns, mapping.time, len(gyro), "gyro")
    notes: list[str] = []
    there = np.all(np.isfinite(gyro), axis=1)
    if there.sum() < 2:
        raise InputError(
            f"the gyro columns {', '.join(mapping.gyro.keys)} hold no numbers",
            "correct gyro: keys in the map",
        )
    if not there.all():
        notes.append(f"{int((~there).sum())} rows without a gyro value left out")
    row = np.flatnonzero(there)
    gyro_counts = _gyro_counts(gyro[row], mapping.gyro)
    status = np.zeros(row.size, dtype=np.int64)
    metadata = {"uid": mapping.uid, "sensor": mapping.sensor, "link": "file"}
    metadata |= {"model": mapping.model} if mapping.model else {}
    metadata["gyro_scale_rad_s"] = repr(_gyro_scale(mapping.gyro))
    for key in ("full_scale_dps", "bandwidth_hz"):
        value = getattr(mapping.gyro, key)
        if value is not None:
            metadata["gyro_" + key if key == "full_scale_dps" else key] = repr(value)
    accel = None
    if mapping.accel:
        accel, valid, scale = _accel(columns, mapping.accel, time_s, row, notes)
        status |= np.where(valid, int(ImuStatus.ACCEL_VALID), 0)
        metadata["accel_scale_m_s2"] = repr(scale)
    temperature = np.zeros(row.size, dtype=np.int64)
    if mapping.temperature:
        temperature, valid = _temperature(columns, mapping, time_s, row, notes)
        status |= np.where(valid, int(ImuStatus.TEMPERATURE_VALID), 0)
        metadata["temperature_scale_c"] = repr(TEMPERATURE_COUNT_C)
        metadata["temperature_offset_c"] = repr(TEMPERATURE_ZERO_C)
    device_time, clock = device_clock(mapping.time, time_s, row)
    imu = ImuStream(
        host_time_ns=nanoseconds(time_s[row]),
        device_time=device_time,
        row=row.astype(np.int64),
        time_s=time_s[row],
        status=status,
        temperature=temperature,
        gyro=gyro_counts,
        accel=accel,
        metadata=metadata | clock | said_rate(columns, mapping.time),
        notes=tuple(notes),
    )
    return imu, _attitude(columns, mapping.attitude, time_s) if mapping.attitude else None


def _gyro_scale(columns: GyroColumns) -> float:
    if columns.unit == "counts" and columns.scale_rad_s is not None:
        return columns.scale_rad_s
    return GYRO_COUNT_RAD_S


def _gyro_counts(gyro: FloatArray, columns: GyroColumns) -> IntArray:
    if columns.unit == "counts":
        return _whole(gyro - columns.offset_counts, "gyro")
    rate = np.radians(gyro) if columns.unit == "deg/s" else gyro
    return _fitting(rate / GYRO_COUNT_RAD_S, "gyro")


def _accel(
    columns: Columns, part: AccelColumns, time_s: FloatArray, row: IntArray, notes: list[str]
) -> tuple[IntArray, BoolArray, float]:
    """Return counts at the gyro's samples, where they are valid, and the scale."""
    values = columns.matrix(part.keys, 3)
    base_s = read_times(columns, part.time, len(values), "accel") if part.time else None
    picked = at_samples(values, base_s, time_s, row, "accel", notes)
    valid = np.all(np.isfinite(picked), axis=1)
    picked = np.where(valid[:, None], picked, part.offset_counts if part.unit == "counts" else 0.0)
    if part.unit == "counts" and part.scale_m_s2 is not None:
        return _whole(picked - part.offset_counts, "accel"), valid, part.scale_m_s2
    unit = STANDARD_GRAVITY_M_S2 if part.unit == "g" else 1.0
    return _fitting(picked * unit / ACCEL_COUNT_M_S2, "accel"), valid, ACCEL_COUNT_M_S2


def _temperature(
    columns: Columns, mapping: ImportMap, time_s: FloatArray, row: IntArray, notes: list[str]
) -> tuple[IntArray, BoolArray]:
    part = mapping.temperature
    if part is None:
        raise ValueError("the map has no temperature")
    values = columns.matrix([part.key], 1)
    base_s = read_times(columns, part.time, len(values), "temperature") if part.time else None
    picked = at_samples(values, base_s, time_s, row, "temperature", notes)[:, 0]
    counts = np.rint((picked - TEMPERATURE_ZERO_C) / TEMPERATURE_COUNT_C)
    valid = np.isfinite(counts) & (np.abs(counts) <= 32767)
    return np.where(valid, counts, 0.0).astype(np.int64), valid


def _attitude(columns: Columns, part: AttitudeColumns, time_s: FloatArray) -> AttitudeStream:
    values = columns.matrix(part.keys, 4)
    if part.order == "wxyz":
        values = values[:, [1, 2, 3, 0]]
    if part.time is not None:
        base_s = read_times(columns, part.time, len(values), "attitude")
    elif len(values) == time_s.size:
        base_s = time_s
    else:
        raise InputError(
            f"attitude has {len(values)} rows, the gyro {time_s.size}",
            "give it times of its own in the map, attitude: time",
        )
    there = np.all(np.isfinite(values), axis=1)
    length = np.linalg.norm(values[there], axis=1)
    if not there.any() or np.any(np.abs(length - 1.0) > 0.01):
        raise InputError(
            "the attitude columns hold no quaternions of length 1",
            "correct attitude: keys and order in the map",
        )
    std_rad = float(np.radians(part.std_deg)) if part.std_deg else float("nan")
    return AttitudeStream(
        nanoseconds(base_s[there]), values[there] / length[:, None], std_rad, int((~there).sum())
    )


def _whole(values: FloatArray, what: str) -> IntArray:
    if np.any(values != np.rint(values)):
        raise InputError(f"{what} counts are not whole numbers", f"correct {what}: unit in the map")
    return _fitting(values, what)


def _fitting(counts: FloatArray, what: str) -> IntArray:
    whole = np.rint(counts)
    bad = ~((whole >= INT32.min) & (whole <= INT32.max))
    if bad.any():
        at = int(np.argmax(bad.any(axis=1)))
        raise InputError(
            f"{what} of sample {at + 1} is beyond any sensor", f"correct {what}: unit in the map"
        )
    return np.asarray(whole, dtype=np.int64)
