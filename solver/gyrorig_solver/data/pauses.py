"""Pauses of imported logs, in which nothing was sampled.

What to use when: `longest_gap_s` for the longest gap that lost samples explain; `count_pauses` for
the parts of an imported recording between pauses.
"""

import numpy as np

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray

# A longer step of the times, in sample periods and in s, is a pause or a step of the clock.
MAX_STEP_PERIODS = 100.0
MAX_STEP_S = 1.0
# A log of events can have a pause every few rows. 20,000 segments take 1 s to load (measured); with
# more pauses than this, they are not separated.
MAX_PAUSES = 50_000


def longest_gap_s(period_s: float) -> float:
    """Return the longest step of the times that is not a pause."""
    return max(MAX_STEP_PERIODS * period_s, MAX_STEP_S)


def count_pauses(time_s: FloatArray, sequence: CounterArray, segment: IntArray) -> IntArray:
    """Return the segments of an imported recording, divided at its pauses, shape (n,).

    The number of a sample does not count a pause, so that the time of the pause must not be part of
    the sample period.

    Args:
        time_s: of each sample, shape (n,).
        sequence: the sample counter, shape (n,).
        segment: of each sample, from the clocks, shape (n,).
    """
    step_s: FloatArray = np.diff(time_s)
    counted: FloatArray = np.diff(sequence.astype(np.float64))
    is_counted = (counted > 0) & (step_s > 0.0)
    if not is_counted.any():
        return segment
    period_s = float(np.median(step_s[is_counted] / counted[is_counted]))
    is_pause = step_s - counted * period_s > longest_gap_s(period_s)
    is_pause &= np.diff(segment) == 0
    if not 0 < np.count_nonzero(is_pause) <= MAX_PAUSES:
        return segment
    return np.asarray(segment + np.concatenate([[0], np.cumsum(is_pause)]), dtype=np.int64)
