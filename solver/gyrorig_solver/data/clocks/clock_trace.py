"""Decimated time series of a clock map, for figures.

What to use when: `trace_clock` for the samples of one board, of any length; the result has at most
`MAX_POINTS` points.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray

MAX_POINTS = 350
_MIN_POINTS = 4  # points that are sufficient for a figure


@dataclass(frozen=True, slots=True, eq=False)
class ClockTrace:
    """One point per block of equally many samples; arrays of shape (k,)."""

    time_s: FloatArray  # since the recording's origin
    min_latency_s: FloatArray  # smallest delay from sample to host
    max_latency_s: FloatArray  # largest
    wander_s: FloatArray  # sample times minus a constant rate; nan outside the longest segment


def trace_clock(
    time_s: FloatArray, host_s: FloatArray, number: CounterArray, segment: IntArray
) -> ClockTrace | None:
    """Return the time series of one board's clock, None if there are too few samples.

    Args:
        time_s: sampling times, capture clock, shape (n,).
        host_s: its arrival time, shape (n,).
        number: sample count since the segment's first, shape (n,).
        segment: shape (n,), counts up.
    """
    points = min(MAX_POINTS, time_s.size)
    if points < _MIN_POINTS:
        return None
    size = time_s.size // points
    latency_s = (host_s - time_s)[: points * size].reshape(points, size)
    used_rows = slice(0, points * size)
    longest = int(np.argmax(np.bincount(segment)))
    inside = np.all(segment[used_rows].reshape(points, size) == longest, axis=1)
    # Means of blocks, because a single timestamp has the resolution of a tick.
    first_number = int(number[0])
    mean_number = (
        (number[used_rows].astype(np.float64) - first_number).reshape(points, size).mean(axis=1)
    )
    mean_time_s = time_s[used_rows].reshape(points, size).mean(axis=1)
    wander = np.full(points, np.nan)
    if np.count_nonzero(inside) >= _MIN_POINTS:
        slope, intercept = np.polyfit(mean_number[inside], mean_time_s[inside], 1)
        wander[inside] = mean_time_s[inside] - (intercept + slope * mean_number[inside])
    return ClockTrace(
        time_s=mean_time_s,
        min_latency_s=latency_s.min(axis=1),
        max_latency_s=latency_s.max(axis=1),
        wander_s=wander,
    )
