"""Times of imported streams, and values of one stream at the samples of another."""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.pauses import longest_gap_s
from gyrorig_solver.importers.map_keys import TimeBase
from gyrorig_solver.importers.measurement_columns import MeasurementColumns

UNIT_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
MAX_DISORDER_S = 0.1  # of the stamps of attitudes, far above the jitter of a link
WINDOW_ROWS = 97  # whose duration shows how dense the rows are
DENSITY_TOLERANCE = 0.15  # of the usual duration
MAX_TIME_S = 2**31 - 1  # builtin_interfaces/Time counts seconds in an int32


@dataclass(frozen=True, slots=True, eq=False)
class GyroTimes:
    """The times of a gyro, and the rows that are samples."""

    time_s: FloatArray  # (n,), of all rows
    row: IntArray  # (k,), the rows with a rate
    period_s: float  # of the samples


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
        time_s = np.arange(rows) / sample_rate(columns, base)
    time_s = time_s + base.origin_s
    if time_s.size != rows:
        raise InputError(
            f"the {stream} columns have {rows} rows, but their time column has {time_s.size}",
            f"correct `key` under `time` of the {stream} in the import map",
        )
    check_times(time_s, 0, stream, may_repeat=base.stamp == "arrival")
    return np.asarray(time_s, dtype=np.float64)


def check_times(
    time_s: FloatArray, origin_ns: int, stream: str, *, may_repeat: bool = False
) -> None:
    """Check that times increase and are in the range of a recording.

    Args:
        time_s: since `origin_ns`, shape (n,).
        origin_ns: the time of the recording at which they are 0.
        stream: the name of the stream; the times of an "attitude" can go back a little.
        may_repeat: neighbours can be equal, as arrival times are.

    Raises:
        InputError: they are not.
    """
    absolute_s = time_s + origin_ns * 1e-9
    invalid = ~np.isfinite(time_s) | (absolute_s < 0.0) | (absolute_s >= MAX_TIME_S)
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
        not_increasing = step < 0.0 if may_repeat else step <= 0.0
    if not_increasing.any():
        at = int(np.argmax(not_increasing)) + 1
        raise InputError(
            f"the times of the {stream} columns do not increase at row {at + 1}",
            "sort the rows and remove duplicates. If the times are arrival times, set "
            "`stamp: arrival` under `time` in the import map",
        )


def describe_jump(time_s: FloatArray, period_s: float, board: str) -> list[str]:
    """Return a note on the largest step of the times far above the sample period, or no note.

    Args:
        time_s: of all rows, shape (n,).
        period_s: the sample period.
        board: the name of the board.
    """
    step_s = np.diff(time_s)
    jumps = int(np.count_nonzero(step_s > longest_gap_s(period_s)))
    if not jumps:
        return []
    at = int(np.argmax(step_s))
    more = f", and at {jumps - 1} other rows by less" if jumps > 1 else ""
    return [
        f"{board}: the times jump by {step_s[at]:.6g} s at row {at + 2}{more}; if the log has no "
        "pause there, its clock was set, so import the rows before and after it separately"
    ]


def describe_doubled_times(time_s: FloatArray, board: str) -> list[str]:
    """Return a note if the rows are twice as dense for some time as elsewhere, or no note.

    They are if the clock of the log was set back: then the rows of two times are sorted into one.

    Args:
        time_s: of all rows, shape (n,), not decreasing.
        board: the name of the board.
    """
    if time_s.size < 4 * WINDOW_ROWS:
        return []
    durations_s = time_s[WINDOW_ROWS:] - time_s[:-WINDOW_ROWS]
    usual_s = float(np.percentile(durations_s, 75.0))
    is_usual = np.abs(durations_s - usual_s) < DENSITY_TOLERANCE * usual_s
    is_doubled = np.abs(durations_s - 0.5 * usual_s) < 0.5 * DENSITY_TOLERANCE * usual_s
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_doubled, [False]]).astype(np.int8)))
    if np.mean(is_usual) < 0.25 or not edges.size:
        return []
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    first, last = int(edges[2 * longest]), int(edges[2 * longest + 1]) - 1
    if last - first < WINDOW_ROWS:
        return []
    return [
        f"{board}: from {time_s[first]:.6g} s to {time_s[last + WINDOW_ROWS]:.6g} s the rows are "
        "twice as dense as elsewhere; if the sample rate was not changed there, the clock of the "
        "log was set back, and rows of different times are mixed, so import only the rows before "
        "or after this interval"
    ]


def sample_rate(columns: MeasurementColumns, base: TimeBase) -> float:
    """Return the rate that a map or an array gives.

    Raises:
        InputError: it is not a positive number.
    """
    rate = base.rate_hz
    if base.rate_key is not None:
        rate = float(columns.matrix([base.rate_key], 1)[0, 0])
    if rate is None or not np.isfinite(rate) or rate <= 0.0:
        raise InputError(
            f"the sample rate in the import map is {rate}, but it must be above 0",
            "correct `rate_hz` under `time` in the import map, or give a column of times as `key`",
        )
    return rate


def nanoseconds(time_s: FloatArray) -> IntArray:
    """Return seconds as whole nanoseconds."""
    return np.asarray(np.rint(time_s * 1e9), dtype=np.int64)


def seconds_since(stamp_ns: IntArray, origin_ns: int) -> FloatArray:
    """Return whole nanoseconds as seconds since an origin, exact to a nanosecond for 50 days."""
    return np.asarray((stamp_ns - origin_ns) * 1e-9, dtype=np.float64)


def order_by_time(
    stamp_ns: IntArray, values: FloatArray, stream: str, notes: list[str]
) -> tuple[IntArray, FloatArray]:
    """Return the finite rows sorted by their times, each time once; appends to `notes`.

    Args:
        stamp_ns: times, shape (n,).
        values: shape (n, k).
        stream: the name of the stream, for the notes.
        notes: what was changed.
    """
    is_finite = np.all(np.isfinite(values), axis=1)
    stamp_ns, values = stamp_ns[is_finite], values[is_finite]
    order = np.argsort(stamp_ns, kind="stable")
    reversals = int(np.sum(np.diff(stamp_ns) < 0))
    stamp_ns, values = stamp_ns[order], values[order]
    is_new = np.concatenate([[True], np.diff(stamp_ns) > 0])[: stamp_ns.size]
    if reversals:
        notes.append(
            f"{stream}: {reversals} timestamps decreased; the samples were sorted by timestamp"
        )
    if not is_new.all():
        notes.append(
            f"{stream}: {int((~is_new).sum())} samples with a duplicate timestamp were left out"
        )
    return stamp_ns[is_new], values[is_new]


def values_at_samples(
    values: FloatArray,
    base_s: FloatArray | None,
    gyro: GyroTimes,
    stream: str,
    notes: list[str],
) -> FloatArray:
    """Return the values at the samples of the gyro, nan if none is near, shape (k, columns).

    A stream with other times is not resampled. Each sample gets the nearest value within half
    a sample period, and a note gives the largest shift.

    Args:
        values: shape (m, columns).
        base_s: their times, shape (m,); None: the times of the gyro.
        gyro: the times and the samples of the gyro.
        stream: the name of the stream, for the notes.
        notes: texts for a reader; is appended to.

    Raises:
        InputError: without times, the stream does not have the rows of the gyro; or it has
            fewer than two rows.
    """
    time_s, row = gyro.time_s, gyro.row
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
    is_near = distance_s <= 0.5 * gyro.period_s
    largest_ms = 1e3 * float(distance_s[is_near].max()) if is_near.any() else 0.0
    notes.append(
        f"{stream}: each sample has the nearest value in time; the largest time difference is "
        f"{largest_ms:.3f} ms, and {int((~is_near).sum())} samples have no value nearby"
    )
    return np.where(is_near[:, None], values[nearest], np.nan)
