"""Conversion of columns to counts, nanoseconds and status bits.

What to use when: `read_streams` for all streams of one input. The whole input is checked before
anything is written.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.importers.import_times import (
    device_ticks,
    nanoseconds,
    output_rate_metadata,
    read_times,
    values_at_samples,
)
from gyrorig_solver.importers.map_columns import MapColumns
from gyrorig_solver.importers.map_keys import (
    AccelColumns,
    AttitudeColumns,
    GyroColumns,
    ImportMap,
    TemperatureColumn,
)
from gyrorig_solver.importers.matrix_attitudes import quaternions_of_matrices
from gyrorig_solver.importers.measurement_columns import MeasurementColumns
from gyrorig_solver.importers.text_columns import list_names

# Physical units become int32 counts with a scale far below the resolution of any sensor.
GYRO_COUNT_RAD_S = 1e-7
ACCEL_COUNT_M_S2 = 1e-6
# int16 with this scale and offset covers -40 to 85 degC in steps of 2 mK.
TEMPERATURE_COUNT_C = 0.002
TEMPERATURE_OFFSET_C = 25.0
STANDARD_GRAVITY_M_S2 = 9.80665  # the unit g, CGPM 1901
INT32 = np.iinfo(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream:
    """The samples of one board, in the form of the recording."""

    host_time_ns: IntArray  # (n,)
    device_time: IntArray  # (n,), ticks
    row: IntArray  # (n,), row number in the source, used as the sample counter
    time_s: FloatArray  # (n,), time in the source
    status: IntArray  # (n,)
    temperature: IntArray  # (n,)
    gyro: IntArray  # (n, 3)
    accel: IntArray | None
    metadata: dict[str, str]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeStream:
    """Reference attitudes; missing ones are gaps."""

    host_time_ns: IntArray  # (n,)
    orientation_xyzw: FloatArray  # (n, 4)
    standard_deviation_rad: float  # nan if the source does not specify it
    lost: int
    metadata: dict[str, str]  # of `gyrorig.reference`; empty if the source says nothing


def read_streams(
    columns: MapColumns, mapping: ImportMap
) -> tuple[ImuStream, AttitudeStream | None]:
    """Return the samples and the reference attitude of one input.

    Raises:
        InputError: times decrease, a value is out of range, or there is no usable data.
    """
    source = columns.of("gyro")
    gyro = source.matrix(mapping.gyro.keys, 3)
    time_s = read_times(source, mapping.time, len(gyro), "gyro")
    notes: list[str] = []
    is_finite = np.all(np.isfinite(gyro), axis=1)
    if is_finite.sum() < 2:
        raise InputError(
            f"the gyro columns {list_names(mapping.gyro.keys)} contain fewer than two rows of "
            "numbers",
            "correct `keys` under `gyro` in the import map",
        )
    if not is_finite.all():
        notes.append(f"{int((~is_finite).sum())} rows without a gyro value were left out")
    row = np.flatnonzero(is_finite)
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
        accel, valid, scale = _accel_counts(columns.of("accel"), mapping.accel, time_s, row, notes)
        status |= np.where(valid, int(ImuStatus.ACCEL_VALID), 0)
        metadata["accel_scale_m_s2"] = repr(scale)
    temperature = np.zeros(row.size, dtype=np.int64)
    if mapping.temperature:
        temperature, valid = _temperature_counts(
            columns.of("temperature"), mapping.temperature, time_s, row, notes
        )
        status |= np.where(valid, int(ImuStatus.TEMPERATURE_VALID), 0)
        metadata["temperature_scale_c"] = repr(TEMPERATURE_COUNT_C)
        metadata["temperature_offset_c"] = repr(TEMPERATURE_OFFSET_C)
    attitude = None
    if mapping.attitude:
        attitude = _attitude_stream(columns.of("attitude"), mapping.attitude, time_s, notes)
    device_time, clock = device_ticks(mapping.time, time_s, row)
    imu = ImuStream(
        host_time_ns=nanoseconds(time_s[row]),
        device_time=device_time,
        row=row.astype(np.int64),
        time_s=time_s[row],
        status=status,
        temperature=temperature,
        gyro=gyro_counts,
        accel=accel,
        metadata=metadata | clock | output_rate_metadata(source, mapping.time),
        notes=tuple(notes),
    )
    return imu, attitude


def _gyro_scale(columns: GyroColumns) -> float:
    if columns.unit == "counts" and columns.scale_rad_s is not None:
        return columns.scale_rad_s
    return GYRO_COUNT_RAD_S


def _gyro_counts(gyro: FloatArray, columns: GyroColumns) -> IntArray:
    if columns.unit == "counts":
        return _whole_counts(gyro - np.asarray(columns.offset_counts), "gyro")
    gyro = gyro - np.asarray(columns.zero)
    rate = np.radians(gyro) if columns.unit == "deg/s" else gyro
    return _int32_counts(rate / GYRO_COUNT_RAD_S, "gyro")


def _accel_counts(
    columns: MeasurementColumns,
    part: AccelColumns,
    time_s: FloatArray,
    row: IntArray,
    notes: list[str],
) -> tuple[IntArray, BoolArray, float]:
    """Return counts at the samples of the gyro, their validity, and the scale."""
    values = columns.matrix(part.keys, 3)
    base_s = read_times(columns, part.time, len(values), "accel") if part.time else None
    picked = values_at_samples(values, base_s, time_s, row, "accel", notes)
    valid = np.all(np.isfinite(picked), axis=1)
    zero = np.asarray(part.offset_counts if part.unit == "counts" else part.zero)
    picked = np.where(valid[:, None], picked - zero, 0.0)
    if part.unit == "counts" and part.scale_m_s2 is not None:
        return _whole_counts(picked, "accel"), valid, part.scale_m_s2
    unit = STANDARD_GRAVITY_M_S2 if part.unit == "g" else 1.0
    return _int32_counts(picked * unit / ACCEL_COUNT_M_S2, "accel"), valid, ACCEL_COUNT_M_S2


def _temperature_counts(
    columns: MeasurementColumns,
    part: TemperatureColumn,
    time_s: FloatArray,
    row: IntArray,
    notes: list[str],
) -> tuple[IntArray, BoolArray]:
    values = columns.matrix([part.key], 1)
    base_s = read_times(columns, part.time, len(values), "temperature") if part.time else None
    picked = values_at_samples(values, base_s, time_s, row, "temperature", notes)[:, 0]
    counts = np.rint((picked - TEMPERATURE_OFFSET_C) / TEMPERATURE_COUNT_C)
    valid = np.isfinite(counts) & (np.abs(counts) <= 32767)
    return np.where(valid, counts, 0.0).astype(np.int64), valid


def _attitude_stream(
    columns: MeasurementColumns, part: AttitudeColumns, time_s: FloatArray, notes: list[str]
) -> AttitudeStream:
    if part.order == "matrix":
        values = quaternions_of_matrices(columns.matrix(part.keys, 9))
    else:
        values = columns.matrix(part.keys, 4)
    if part.order == "wxyz":
        values = values[:, [1, 2, 3, 0]]
    if part.maps == "world_to_body":
        values = values * [-1.0, -1.0, -1.0, 1.0]
    if part.time is not None:
        base_s = read_times(columns, part.time, len(values), "attitude")
    elif len(values) == time_s.size:
        base_s = time_s
    else:
        raise InputError(
            f"the attitude columns have {len(values)} rows, but the gyro columns have "
            f"{time_s.size}",
            "give the times of the attitudes with the key `time` under `attitude` in the import "
            "map",
        )
    is_finite = np.all(np.isfinite(values), axis=1)
    length = np.linalg.norm(values[is_finite], axis=1)
    if not length.size:
        raise InputError(
            "no row of the attitude columns contains numbers only",
            "correct `keys` under `attitude` in the import map",
        )
    if np.any(np.abs(length - 1.0) > 0.01):
        wrong = int(np.argmax(np.abs(length - 1.0)))
        raise InputError(
            f"row {int(np.flatnonzero(is_finite)[wrong]) + 1} of the attitude columns has the "
            f"length {length[wrong]:.4g}, but a quaternion of an attitude has the length 1",
            "give the four columns of the quaternion as `keys` under `attitude` in the import map",
        )
    std_rad = float(np.radians(part.std_deg)) if part.std_deg else float("nan")
    ordered_s = np.asarray(isotonic_regression(base_s[is_finite]).x, dtype=np.float64)
    back = int(np.sum(np.diff(base_s[is_finite]) < 0.0))
    if back:
        notes.append(
            f"attitude: {back} times go back to before the row above them; they are replaced by "
            "the mean of the times that are not in order, so that the rows stay in order"
        )
    return AttitudeStream(
        nanoseconds(ordered_s if back else base_s[is_finite]),
        values[is_finite] / length[:, None],
        std_rad,
        int((~is_finite).sum()),
        _reference_metadata(part),
    )


def _reference_metadata(part: AttitudeColumns) -> dict[str, str]:
    """Return what the map says about the stamps of the attitudes."""
    if part.time is None or part.time.stamp != "arrival":
        return {}
    rate = {} if part.time.rate_hz is None else {"rate_hz": repr(part.time.rate_hz)}
    return {"stamp": "arrival", **rate}


def _whole_counts(values: FloatArray, quantity: str) -> IntArray:
    if np.any(values != np.rint(values)):
        raise InputError(
            f"the {quantity} columns contain numbers with decimals, so they cannot be counts",
            f"correct `unit` under `{quantity}` in the import map",
        )
    return _int32_counts(values, quantity)


def _int32_counts(counts: FloatArray, quantity: str) -> IntArray:
    whole = np.rint(counts)
    out_of_range = ~((whole >= INT32.min) & (whole <= INT32.max))
    if out_of_range.any():
        at = int(np.argmax(out_of_range.any(axis=1)))
        raise InputError(
            f"the {quantity} value of sample {at + 1} is too large for any sensor, so its unit of "
            "measure is probably wrong",
            f"correct `unit` under `{quantity}` in the import map",
        )
    return np.asarray(whole, dtype=np.int64)
