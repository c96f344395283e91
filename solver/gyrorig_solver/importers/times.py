"""Times of imported streams: read, checked, and one stream's values at another's samples."""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.importers.columns import Columns
from gyrorig_solver.importers.mapping import TimeBase

UNIT_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
LATEST_S = 2**31 - 1  # builtin_interfaces/Time counts seconds in an int32


def read_times(columns: Columns, base: TimeBase, rows: int, of: str) -> FloatArray:
    """Return a stream's times in s, shape (rows,).

    Raises:
        InputError: their number differs, or they stand still, run back or leave what a
            recording can hold. Arrival times may stand still.
    """
    if base.key is not None:
        time_s = columns.matrix([base.key], 1)[:, 0] * UNIT_S[base.unit]
    else:
        time_s = np.arange(rows) / _rate(columns, base)
    time_s = time_s + base.origin_s
    if time_s.size != rows:
        raise InputError(
            f"{of}: {time_s.size} times for {rows} rows", "correct the key of its time in the map"
        )
    bad = ~np.isfinite(time_s) | (time_s < 0.0) | (time_s >= LATEST_S)
    if bad.any():
        at = int(np.argmax(bad))
        raise InputError(
            f"{of}: row {at + 1} has the time {time_s[at]:g} s",
            "correct time: unit in the map, or set time: origin_s so that no time is below 0",
        )
    step = np.diff(time_s)
    back = step < 0.0 if base.stamp == "arrival" else step <= 0.0
    if back.any():
        at = int(np.argmax(back)) + 1
        raise InputError(
            f"{of}: time stands still or runs back at row {at + 1}",
            "sort the rows, take those out that come twice, or say stamp: arrival",
        )
    return np.asarray(time_s, dtype=np.float64)


def _rate(columns: Columns, base: TimeBase) -> float:
    rate = base.rate_hz
    if base.rate_key is not None:
        rate = float(columns.matrix([base.rate_key], 1)[0, 0])
    if rate is None or not np.isfinite(rate) or rate <= 0.0:
        raise InputError(
            f"the sample rate is {rate}",
            "give time: rate_hz above 0 in the map, or a column of times",
        )
    return rate


def said_rate(columns: Columns, base: TimeBase) -> dict[str, str]:
    """Return `odr_hz` where the source says a rate."""
    said = base.rate_hz is not None or base.rate_key is not None
    return {"odr_hz": repr(_rate(columns, base))} if said else {}


def device_clock(
    base: TimeBase, time_s: FloatArray, row: IntArray
) -> tuple[IntArray, dict[str, str]]:
    """Return ticks and what they are worth.

    One time column is the host's and the device's time both. Where it holds arrivals,
    the sensor's own clock is its sample count: a floor under the arrivals' bursts finds
    the true rate, which no single arrival tells.
    """
    if base.stamp == "arrival":
        return row.astype(np.int64), {"tick_hz": repr(base.rate_hz), "counter_bits": "64"}
    return nanoseconds(time_s[row]), {"tick_hz": "1000000000.0", "counter_bits": "64"}


def nanoseconds(time_s: FloatArray) -> IntArray:
    """Return seconds as whole nanoseconds."""
    return np.asarray(np.rint(time_s * 1e9), dtype=np.int64)


def at_samples(
    values: FloatArray,
    base_s: FloatArray | None,
    time_s: FloatArray,
    row: IntArray,
    what: str,
    notes: list[str],
) -> FloatArray:
    """Return the values that belong to the gyro's samples, nan where none is near.

    A stream with other times than the gyro's is not resampled: each sample gets the
    nearest value if that is within half a sample, and the recording says how far off.
    """
    if base_s is None:
        if len(values) != time_s.size:
            raise InputError(
                f"{what} has {len(values)} rows, the gyro {time_s.size}",
                f"give it times of its own in the map, {what}: time",
            )
        return values[row]
    if base_s.size == time_s.size and np.array_equal(base_s, time_s):
        return values[row]
    after = np.clip(np.searchsorted(base_s, time_s[row]), 1, max(base_s.size - 1, 1))
    if base_s.size < 2:
        raise InputError(f"{what} has {base_s.size} rows", "leave it out of the map")
    nearer = np.abs(base_s[after - 1] - time_s[row]) <= np.abs(base_s[after] - time_s[row])
    nearest = np.where(nearer, after - 1, after)
    off = np.abs(base_s[nearest] - time_s[row])
    near = off <= 0.5 * float(np.median(np.diff(time_s)))
    largest_ms = 1e3 * float(off[near].max()) if near.any() else 0.0
    notes.append(
        f"{what}: nearest value taken, {int((~near).sum())} samples without one, "
        f"largest shift {largest_ms:.3f} ms"
    )
    return np.where(near[:, None], values[nearest], np.nan)
