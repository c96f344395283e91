"""Conversion of measured streams to counts, nanoseconds and status bits.

What to use when: `encode_samples` for the samples of one board, `find_rounding_step` for the step
to which a source rounded its rates. The whole board is checked before anything is written.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.importers.import_times import (
    GyroTimes,
    check_times,
    describe_doubled_times,
    describe_jump,
    nanoseconds,
    values_at_samples,
)
from gyrorig_solver.importers.measured_streams import (
    AccelStream,
    GyroStream,
    MeasuredBoard,
    TemperatureStream,
)
from gyrorig_solver.importers.sample_numbers import SampleNumbers, number_sampled_rows

# Physical units become int32 counts with a scale far below the resolution of any sensor.
GYRO_COUNT_RAD_S = 1e-7
ACCEL_COUNT_M_S2 = 1e-6
# int16 with this scale and offset covers -40 to 85 degC in steps of 2 mK.
TEMPERATURE_COUNT_C = 0.002
TEMPERATURE_OFFSET_C = 25.0
MAX_TEMPERATURE_COUNT = 32767
INT32 = np.iinfo(np.int32)
MIN_STEP_RAD_S = 1e-6  # the finest digit that a logger writes; smaller steps are rounding of floats
MIN_STEP_SAMPLES = 16  # as many as the solver needs
MIN_REPEATS = 2  # a value that occurs once can be a knock
# The differences between neighbouring values are one step, or two if a value does not occur. If a
# source rounded twice, they alternate, and their mean is the step.
MAX_STEP_RATIO = 2.5


@dataclass(frozen=True, slots=True, eq=False)
class ImuStream:
    """The samples of one board, in the form of the recording."""

    host_time_ns: IntArray  # (n,)
    device_time: IntArray  # (n,), ticks
    row: IntArray  # (n,), row in the source, from 0
    number: IntArray  # (n,), sample counter
    time_s: FloatArray  # (n,), time in the source
    status: IntArray  # (n,)
    temperature: IntArray  # (n,)
    gyro: IntArray  # (n, 3)
    accel: IntArray | None
    metadata: dict[str, str]
    notes: tuple[str, ...]


def encode_samples(board: MeasuredBoard, origin_ns: int) -> ImuStream:
    """Return the samples of a board in the form of a recording.

    Args:
        board: has a gyro stream.
        origin_ns: the time of the recording at which the board's times are 0.

    Raises:
        InputError: times decrease, a value is out of range, or there is no usable data.
    """
    gyro = board.gyro
    if gyro is None:
        raise ValueError(f"the board {board.name} has no gyro")
    check_times(gyro.time_s, origin_ns, "gyro", may_repeat=gyro.stamp == "arrival")
    notes: list[str] = []
    is_finite = np.all(np.isfinite(gyro.values), axis=1)
    if is_finite.sum() < 2:
        raise InputError(
            f"the gyro data of {board.name} contain fewer than two rows of numbers",
            "import data with the rates of a gyroscope, or correct `keys` under `gyro` in the "
            "import map",
        )
    if not is_finite.all():
        notes.append(f"{int((~is_finite).sum())} rows without a gyro value were left out")
    row = np.flatnonzero(is_finite)
    status = np.zeros(row.size, dtype=np.int64)
    metadata = {"uid": "unknown", "link": "file"} | board.metadata
    numbers = _sample_numbers(gyro, row)
    number = numbers.number
    times = GyroTimes(gyro.time_s, row, numbers.period_s)
    notes += describe_jump(gyro.time_s, times.period_s, board.name)
    notes += describe_doubled_times(gyro.time_s, board.name)
    if not numbers.has_constant_rate:
        notes.append(
            f"{board.name}: the times of the rows show no constant sample rate, so a missing row "
            "cannot be recognised, and the sample rate is the mean rate of the rows"
        )
    metadata["gyro_scale_rad_s"] = repr(gyro.scale_rad_s or GYRO_COUNT_RAD_S)
    step_rad_s = None if gyro.scale_rad_s else find_rounding_step(gyro.values[row])
    if step_rad_s is not None:
        metadata["gyro_rounding_rad_s"] = repr(step_rad_s)
    accel = None
    if board.accel:
        accel, valid = _accel_counts(board.accel, origin_ns, times, notes)
        status |= np.where(valid, int(ImuStatus.ACCEL_VALID), 0)
        metadata["accel_scale_m_s2"] = repr(board.accel.scale_m_s2 or ACCEL_COUNT_M_S2)
    temperature = np.zeros(row.size, dtype=np.int64)
    if board.temperature:
        temperature, valid = _temperature_counts(board.temperature, origin_ns, times, notes)
        status |= np.where(valid, int(ImuStatus.TEMPERATURE_VALID), 0)
        metadata["temperature_scale_c"] = repr(TEMPERATURE_COUNT_C)
        metadata["temperature_offset_c"] = repr(TEMPERATURE_OFFSET_C)
    device_time, clock = _device_ticks(gyro, origin_ns, row, number)
    if gyro.rate_hz is not None:
        clock["odr_hz"] = repr(gyro.rate_hz)
    return ImuStream(
        host_time_ns=origin_ns + nanoseconds(gyro.time_s[row]),
        device_time=device_time,
        row=row,
        number=number.astype(np.int64),
        time_s=gyro.time_s[row],
        status=status,
        temperature=temperature,
        gyro=_gyro_counts(gyro, row),
        accel=accel,
        metadata=metadata | clock,
        notes=tuple(notes),
    )


def _device_ticks(
    gyro: GyroStream, origin_ns: int, row: IntArray, number: IntArray
) -> tuple[IntArray, dict[str, str]]:
    """Return device ticks and their frequency.

    Times of sampling are both host and device time. If the times are arrival times, the sample
    count is the device clock: the lower envelope of the arrivals gives its true rate.
    """
    if gyro.stamp == "arrival":
        rate_hz = _arrival_rate_hz(gyro, row, number)
        return number.astype(np.int64), {"tick_hz": repr(rate_hz), "counter_bits": "64"}
    ticks = origin_ns + nanoseconds(gyro.time_s[row])
    return ticks, {"tick_hz": "1000000000.0", "counter_bits": "64"}


def _arrival_rate_hz(gyro: GyroStream, row: IntArray, number: IntArray) -> float:
    if gyro.rate_hz is not None:
        return gyro.rate_hz
    span_s = max(float(gyro.time_s[row[-1]] - gyro.time_s[row[0]]), 1e-9)
    return float(number[-1] - number[0]) / span_s


def _sample_numbers(gyro: GyroStream, row: IntArray) -> SampleNumbers:
    """Return the sample numbers and the period.

    The steps of arrival times do not show the period, for many can be 0.
    """
    number = row if gyro.number is None else gyro.number[row]
    if gyro.stamp == "arrival":
        return SampleNumbers(number, 1.0 / _arrival_rate_hz(gyro, row, number))
    if gyro.number is None:
        return number_sampled_rows(gyro.time_s, row)
    step_s = np.diff(gyro.time_s[row]) / np.maximum(np.diff(number), 1)
    return SampleNumbers(number, float(np.median(step_s)))


def _gyro_counts(gyro: GyroStream, row: IntArray) -> IntArray:
    if gyro.scale_rad_s is not None:
        return _whole_counts(gyro.values[row], "gyro")
    with np.errstate(over="ignore"):  # a value out of range is refused
        return _int32_counts(gyro.values[row] / GYRO_COUNT_RAD_S, "gyro")


def _accel_counts(
    accel: AccelStream, origin_ns: int, gyro: GyroTimes, notes: list[str]
) -> tuple[IntArray, BoolArray]:
    """Return counts at the samples of the gyro, and their validity."""
    _check_stream_times(accel, origin_ns, "accel")
    picked = values_at_samples(accel.values, accel.time_s, gyro, "accel", notes)
    valid = np.all(np.isfinite(picked), axis=1)
    picked = np.where(valid[:, None], picked, 0.0)
    if accel.scale_m_s2 is not None:
        return _whole_counts(picked, "accel"), valid
    with np.errstate(over="ignore"):
        return _int32_counts(picked / ACCEL_COUNT_M_S2, "accel"), valid


def _temperature_counts(
    stream: TemperatureStream, origin_ns: int, gyro: GyroTimes, notes: list[str]
) -> tuple[IntArray, BoolArray]:
    values = stream.temperature_degc[:, None]
    _check_stream_times(stream, origin_ns, "temperature")
    picked = values_at_samples(values, stream.time_s, gyro, "temperature", notes)[:, 0]
    counts = np.rint((picked - TEMPERATURE_OFFSET_C) / TEMPERATURE_COUNT_C)
    is_finite = np.isfinite(counts)
    valid = is_finite & (np.abs(counts) <= MAX_TEMPERATURE_COUNT)
    outside = int(np.count_nonzero(is_finite & ~valid))
    if outside:
        range_c = TEMPERATURE_COUNT_C * MAX_TEMPERATURE_COUNT
        notes.append(
            f"temperature: {outside} samples have no temperature in the recording, because it is "
            f"outside {TEMPERATURE_OFFSET_C - range_c:.1f} to {TEMPERATURE_OFFSET_C + range_c:.1f} "
            "degC; the temperatures of the source must be in degC"
        )
    return np.where(valid, counts, 0.0).astype(np.int64), valid


def _check_stream_times(stream: AccelStream | TemperatureStream, origin_ns: int, name: str) -> None:
    if stream.time_s is not None:
        check_times(stream.time_s, origin_ns, name, may_repeat=stream.stamp == "arrival")


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
            f"correct `unit` under `{quantity}` in the import map, or the program that wrote "
            "the file",
        )
    return np.asarray(whole, dtype=np.int64)


def find_rounding_step(rate_rad_s: FloatArray) -> float | None:
    """Return the step in rad/s, None if the rates show none.

    Args:
        rate_rad_s: shape (n, 3), finite.

    A table in deg/s or rad/s hides the counts of the sensor and the digits of the program that
    wrote it. The fit needs their step, because the mean of rounded samples at rest can be wrong by
    half a step.

    Most rates of a rounded source at rest are equal to other rates. Without this, the noise is
    larger than the step, and the step does not matter.
    """
    steps = [step for axis in rate_rad_s.T if (step := _find_step(axis)) is not None]
    return float(np.median(steps)) if steps else None


def _find_step(rate_rad_s: FloatArray) -> float | None:
    levels, repeats = np.unique(rate_rad_s, return_counts=True)
    is_repeated = repeats >= MIN_REPEATS
    if rate_rad_s.size < MIN_STEP_SAMPLES or 2 * repeats[is_repeated].sum() < rate_rad_s.size:
        return None
    gaps, weights = np.diff(levels), np.minimum(repeats[1:], repeats[:-1])
    # Between two levels that a clipped motion repeats are others, so their difference is no step.
    is_real = (gaps >= MIN_STEP_RAD_S) & is_repeated[1:] & is_repeated[:-1]
    if not is_real.any():
        return None
    # A rest has the most samples per level and no missing level.
    is_near = is_real & (gaps <= MAX_STEP_RATIO * gaps[is_real].min())
    return float(np.average(gaps[is_near], weights=weights[is_near]))
