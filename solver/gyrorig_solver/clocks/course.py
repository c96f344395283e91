"""How a board's samples came over time: what is drawn of a clock map.

What to use when: `clock_course` for one board's samples, of any length; what comes out has a
few hundred points, whatever went in.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.clocks.faults import CounterArray

POINTS = 350
_LEAST = 4  # points that show a course


@dataclass(frozen=True, slots=True, eq=False)
class ClockCourse:
    """Each point stands for a stretch of samples, equally many in all; (k,) each."""

    time_s: FloatArray  # since the recording's origin
    late_low_s: FloatArray  # least delay from sample to host
    late_high_s: FloatArray  # greatest
    wander_s: FloatArray  # sample times against a constant rate; nan outside the longest segment


def clock_course(
    time_s: FloatArray, host_s: FloatArray, number: CounterArray, segment: IntArray
) -> ClockCourse | None:
    """Return the course of one board's clock, None where there are too few samples.

    Args:
        time_s: when each sample was taken, capture clock, shape (n,).
        host_s: when it was in the host's hands, shape (n,).
        number: sample count since the segment's first, shape (n,).
        segment: shape (n,), counts up.
    """
    points = min(POINTS, time_s.size)
    if points < _LEAST:
        return None
    size = time_s.size // points
    late = (host_s - time_s)[: points * size].reshape(points, size)
    whole = slice(0, points * size)
    longest = int(np.argmax(np.bincount(segment)))
    inside = np.all(segment[whole].reshape(points, size) == longest, axis=1)
    # Means of stretches: a single stamp is as coarse as the board's tick.
    first = int(number[0])
    at = (number[whole].astype(np.float64) - first).reshape(points, size).mean(axis=1)
    seen = time_s[whole].reshape(points, size).mean(axis=1)
    wander = np.full(points, np.nan)
    if np.count_nonzero(inside) >= _LEAST:
        slope, start = np.polyfit(at[inside], seen[inside], 1)
        wander[inside] = seen[inside] - (start + slope * at[inside])
    return ClockCourse(
        time_s=seen,
        late_low_s=late.min(axis=1),
        late_high_s=late.max(axis=1),
        wander_s=wander,
    )
