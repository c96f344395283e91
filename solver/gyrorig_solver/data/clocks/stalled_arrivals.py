"""Sample times of a board that sends no timestamps, without the stalls of the host.

The time of such a sample is its arrival. If the host stalls, samples wait and arrive together, and
all of them have the time of the end of the stall. The samples before and after the stall, and the
counter of the samples, show when they were taken.

What to use when: `times_without_stalls` for arrival times that are used as sample times.
"""

import numpy as np

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray
from gyrorig_solver.data.clocks.counted_samples import map_counted_pieces

LONGEST_STALL_S = 2.0  # a later sample is no longer compared with the samples after it
STALL_FACTOR = 15.0  # times the mean lateness: an exponential exceeds it once in 3e6 samples


def times_without_stalls(sequence: CounterArray, host_s: FloatArray) -> FloatArray:
    """Return the arrival times, with evenly spaced times for samples that waited, shape (n,).

    A sample waited if it is much later, by the counter of the samples, than one that follows it.
    Samples that were lost without a gap of the counter delay all later ones, so that they change
    only the times between the samples before and after the stall.

    Args:
        sequence: the sample counter, shape (n,).
        host_s: arrival times, shape (n,), not decreasing.
    """
    return map_counted_pieces(sequence, host_s, LONGEST_STALL_S, _without_stalls)


def _without_stalls(number: IntArray, host_s: FloatArray, period_s: float) -> FloatArray:
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - slow to load

    lag_s = host_s - number * period_s
    following = max(1, min(round(LONGEST_STALL_S / period_s), host_s.size))
    earliest_s = minimum_filter1d(lag_s, following, mode="nearest", origin=-(following // 2))
    late_s = lag_s - earliest_s
    waited = late_s > STALL_FACTOR * float(np.median(late_s)) / np.log(2.0)
    waited[[0, -1]] = False
    return np.where(waited, np.interp(number, number[~waited], host_s[~waited]), host_s)
