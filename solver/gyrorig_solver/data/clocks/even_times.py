"""Sample times of a board that sends no timestamps, without the jitter of the arrivals.

The time of such a sample is its arrival, and the jitter of the host is an error of each time. In an
acceleration, it looks like noise of the rate, and it hides the shape of the edges of a move. The
sensor takes its samples evenly, and the counter of the samples shows which sample is which. A
sample that was lost without a gap of the counter delays all later ones by whole periods. Such steps
are much larger than the smallest latency of many samples, so that the arrivals show them.

What to use when: `evenly_spaced` for arrival times without stalls.
"""

import numpy as np

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray
from gyrorig_solver.data.clocks.counted_samples import map_counted_pieces

LONGEST_STEP_S = 2.0  # of the times against the counter; a longer one is a restart or a pause
WINDOW_SAMPLES = 64  # the smallest latency of so many samples is far below a period
BLOCK_SAMPLES = 16  # few, so that most blocks have no uncounted sample
MIN_SAMPLES = 8  # before and after a step
# Of a period. A late sample before a step has a part of it, so that a larger share finds its place.
STEP_SHARE, LARGEST_FALL_SHARE = 0.75, 0.5
# The mean of so many latencies has 0.03 of their standard deviation. At 100 Hz, a rate that changes
# by 500 ppm in 130 s bends the lag by 0.05 ms between two means.
SMOOTHED_SAMPLES = 1000
MAX_PASSES = 16  # each finds one step of several within a window


def evenly_spaced(sequence: CounterArray, time_s: FloatArray) -> FloatArray:
    """Return evenly spaced times of the samples of a board without timestamps, shape (n,).

    Times that are not even by the counter of the samples are returned as they are.

    Args:
        sequence: the sample counter, shape (n,).
        time_s: arrival times without stalls of the host, shape (n,), not decreasing.
    """
    return map_counted_pieces(sequence, time_s, LONGEST_STEP_S, _even_piece)


def _even_piece(number: IntArray, time_s: FloatArray, period_s: float) -> FloatArray:
    """Return the even times of samples without a restart between them."""
    if time_s.size < 2 * WINDOW_SAMPLES:
        return time_s
    period_s += _period_change_s(number, time_s - number * period_s)
    lag_s = time_s - number * period_s
    level_s = _lost_time_s(lag_s, period_s)
    if level_s is None:
        return time_s
    smooth_s = _smooth_lag_s(number, lag_s - level_s)
    return np.asarray(number * period_s + level_s + smooth_s, np.float64)


def _period_change_s(number: IntArray, lag_s: FloatArray) -> float:
    """Return how much longer the period is than a rough one that contains uncounted samples."""
    first = np.arange(0, lag_s.size, BLOCK_SAMPLES)
    least_s = np.minimum.reduceat(lag_s, first)
    return float(np.median(np.diff(least_s) / np.diff(number[first])))


def _smooth_lag_s(number: IntArray, lag_s: FloatArray) -> FloatArray:
    """Return the mean lag as a function of the sample number, of straight lines, shape (n,).

    The rate of a sensor depends on its temperature, so one line does not fit a long piece.
    """
    count = number.size // SMOOTHED_SAMPLES
    if count < 2:
        centred = number - number.mean()
        return np.asarray(np.polyval(np.polyfit(centred, lag_s, 1), centred), dtype=np.float64)
    first = np.linspace(0, number.size, count, endpoint=False).astype(np.int64)
    sizes = np.diff(np.append(first, number.size))
    at, mean_s = (np.add.reduceat(values, first) / sizes for values in (number, lag_s))
    slopes = np.diff(mean_s)[[0, -1]] / np.diff(at)[[0, -1]]
    ends = number[[0, -1]]
    end_s = mean_s[[0, -1]] + slopes * (ends - at[[0, -1]])
    knots = np.concatenate([ends[:1], at, ends[1:]])
    knot_lags_s = np.concatenate([end_s[:1], mean_s, end_s[1:]])
    return np.asarray(np.interp(number, knots, knot_lags_s), dtype=np.float64)


def _lost_time_s(lag_s: FloatArray, period_s: float) -> FloatArray | None:
    """Return how much the uncounted samples before each sample delay it, shape (n,).

    None if the latency also decreases by a large part of a period: then the samples are not even.
    """
    level_s = np.zeros(lag_s.size)
    for _ in range(MAX_PASSES):
        rise_s = _rise_s(lag_s - level_s)
        if (rise_s < -LARGEST_FALL_SHARE * period_s).any():
            return None
        is_step = rise_s > STEP_SHARE * period_s
        if not is_step.any():
            return level_s
        first = np.flatnonzero(is_step & ~np.concatenate([[False], is_step[:-1]]))
        added_s = np.zeros(lag_s.size)
        added_s[first] = period_s * np.maximum(rise_s[first] // period_s, 1.0)
        level_s += np.cumsum(added_s)
    return None


def _rise_s(lag_s: FloatArray) -> FloatArray:
    """Return the smallest lag from each sample on, minus the smallest one before it, (n,).

    It is zero near the ends, where a window has few samples.
    """
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - slow to load

    half = WINDOW_SAMPLES // 2
    ahead_s = minimum_filter1d(lag_s, WINDOW_SAMPLES, mode="nearest", origin=-half)
    behind_s = minimum_filter1d(lag_s, WINDOW_SAMPLES, mode="nearest", origin=half - 1)
    rise_s = np.zeros(lag_s.size)
    inner = slice(MIN_SAMPLES, 1 - MIN_SAMPLES)
    rise_s[inner] = ahead_s[inner] - behind_s[MIN_SAMPLES - 1 : -MIN_SAMPLES]
    return rise_s
