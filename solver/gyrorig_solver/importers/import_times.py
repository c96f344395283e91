"""Times of imported streams, and values of one stream at the samples of another."""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.map_keys import TimeBase
from gyrorig_solver.importers.measurement_columns import MeasurementColumns

UNIT_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
MAX_DISORDER_S = 0.1  # of the stamps of attitudes, far above the jitter of a link
MAX_TIME_S = 2**31 - 1  # builtin_interfaces/Time counts seconds in an int32


def read_times(columns: MeasurementColumns, base: TimeBase, rows: int, stream: str) -> FloatArray:
    """Return the times of a stream in s, shape (rows,).

    Raises:
        InputError: their number differs from `rows`, they do not increase, or they are out
            of the range of a recording. Arrival times can repeat. The stamps of attitudes can
            also go back by up to `MAX_DISORDER_S`, which is jitter.
    """
    if base.key is not None:
        time_s = columns.matrix([base.key], 1)[:, 0] * UNIT_S[base.unit]
    else:
        time_s = np.arange(rows) / _sample_rate(columns, base)
    time_s = time_s + base.origin_s
    if time_s.size != rows:
        raise InputError(
            f"the {stream} columns have {rows} rows, but their time column has {time_s.size}",
            f"correct `key` under `time` of the {stream} in the import map",
        )
    invalid = ~np.isfinite(time_s) | (time_s < 0.0) | (time_s >= MAX_TIME_S)
    if invalid.any():
        at = int(np.argmax(invalid))
        raise InputError(
            f"the time {time_s[at]:g} s of the {stream} columns in row {at + 1} is outside "
            "the valid range",
            "correct `unit` under `time` in the import map, or set `origin_s` under `time` "
            "so that no time is below 0",
        )
    step = np.diff(time_s)
    if stream == "attitude":
        not_increasing = (np.maximum.accumulate(time_s) - time_s)[1:] > MAX_DISORDER_S
    else:
        not_increasing = step < 0.0 if base.stamp == "arrival" else step <= 0.0
    if not_increasing.any():
        at = int(np.argmax(not_increasing)) + 1
        raise InputError(
            f"the times of the {stream} columns do not increase at row {at + 1}",
            "sort the rows and remove duplicates. If the times are arrival times, set "
            "`stamp: arrival` under `time` in the import map",
        )
    return np.asarray(time_s, dtype=np.float64)


def _sample_rate(columns: MeasurementColumns, base: TimeBase) -> float:
    rate = base.rate_hz
    if base.rate_key is not None:
        rate = float(columns.matrix([base.rate_key], 1)[0, 0])
    if rate is None or not np.isfinite(rate) or rate <= 0.0:
        raise InputError(
            f"the sample rate in the import map is {rate}, but it must be above 0",
            "correct `rate_hz` under `time` in the import map, or give a column of times as `key`",
        )
    return rate


def output_rate_metadata(columns: MeasurementColumns, base: TimeBase) -> dict[str, str]:
    """Return `odr_hz` if the source specifies a rate."""
    has_rate = base.rate_hz is not None or base.rate_key is not None
    return {"odr_hz": repr(_sample_rate(columns, base))} if has_rate else {}


def device_ticks(
    base: TimeBase, time_s: FloatArray, row: IntArray
) -> tuple[IntArray, dict[str, str]]:
    """Return device ticks and their frequency.

    A single time column is both host and device time. If it contains arrival times, the sample
    count is the device clock: the lower envelope of the arrivals gives its true rate.
    """
    if base.stamp == "arrival":
        return row.astype(np.int64), {"tick_hz": repr(base.rate_hz), "counter_bits": "64"}
    return nanoseconds(time_s[row]), {"tick_hz": "1000000000.0", "counter_bits": "64"}


def nanoseconds(time_s: FloatArray) -> IntArray:
    """Return seconds as whole nanoseconds."""
    return np.asarray(np.rint(time_s * 1e9), dtype=np.int64)


def values_at_samples(
    values: FloatArray,
    base_s: FloatArray | None,
    time_s: FloatArray,
    row: IntArray,
    stream: str,
    notes: list[str],
) -> FloatArray:
    """Return the values at the samples of the gyro, nan if none is near.

    A stream with other times is not resampled. Each sample gets the nearest value within half
    a sample period, and a note gives the largest shift.
    """
    if base_s is None:
        if len(values) != time_s.size:
            raise InputError(
                f"the {stream} columns have {len(values)} rows, but the gyro columns have "
                f"{time_s.size}",
                f"give the times of the {stream} rows with the key `time` under `{stream}` in the "
                "import map",
            )
        return values[row]
    if base_s.size == time_s.size and np.array_equal(base_s, time_s):
        return values[row]
    after = np.clip(np.searchsorted(base_s, time_s[row]), 1, max(base_s.size - 1, 1))
    if base_s.size < 2:
        raise InputError(
            f"the {stream} columns have only {base_s.size} rows, but at least 2 are needed",
            f"remove `{stream}` from the import map, or give columns with more rows",
        )
    nearer = np.abs(base_s[after - 1] - time_s[row]) <= np.abs(base_s[after] - time_s[row])
    nearest = np.where(nearer, after - 1, after)
    distance_s = np.abs(base_s[nearest] - time_s[row])
    is_near = distance_s <= 0.5 * float(np.median(np.diff(time_s)))
    largest_ms = 1e3 * float(distance_s[is_near].max()) if is_near.any() else 0.0
    notes.append(
        f"{stream}: each sample has the nearest value in time; the largest time difference is "
        f"{largest_ms:.3f} ms, and {int((~is_near).sum())} samples have no value nearby"
    )
    return np.where(is_near[:, None], values[nearest], np.nan)
