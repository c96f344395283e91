"""Sample numbers of streams whose times are those of sampling.

What to use when: `number_sampled_rows` for the rows of a stream without a counter of its source.

A row that is missing from the source leaves a gap in the times. The gap is a gap of the numbers
only if the times show the period of the sensor. They do so in two cases: most steps are a multiple
of one period (`_find_common_period`), or the same number of rows always takes the same time, apart
from jitter. In all other cases, for example if events trigger the rows, the rows are the samples.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.pauses import longest_gap_s
from gyrorig_solver.importers.stamp_kinds import NEIGHBOURS, count_rows

# Their durations show whether the rows have a constant rate. A prime number, because a duration of
# a whole number of digits can be rounded up and down.
WINDOW_ROWS = 97
MIN_WINDOW_ROWS = 8
MAX_INSPECTED = 200_000  # steps or windows for an estimate
MAX_DIVISOR = 4  # of the median step: with half of the rows missing it can be two periods
MAX_EXACT_SCATTER = 0.05  # rms; with more, a step alone does not show a lost sample
MAX_SCATTER = 0.15  # rms of the steps about multiples of the period; 0.29 without a period
MIN_SINGLE_SHARE = 0.4  # of the steps, which must be a single period
MAX_COUNTED = 20  # periods in a step that the period is estimated from
PERIOD_TOLERANCE = 1e-3  # between two estimates of the same period


@dataclass(frozen=True, slots=True, eq=False)
class SampleNumbers:
    """The numbers of the samples, and their period."""

    number: IntArray  # (k,), increasing
    period_s: float
    has_constant_rate: bool = True  # otherwise a missing row cannot be recognised


def number_sampled_rows(time_s: FloatArray, row: IntArray) -> SampleNumbers:
    """Return the numbers of the samples by their times.

    The rows with a rate are examined first: in a table of several sensors, the other rows are no
    lost samples. If these rows have no constant rate, all rows are examined.

    Args:
        time_s: of all rows, shape (n,), increasing.
        row: the rows with a rate, shape (k,), at least two.
    """
    numbers = _number_rows(time_s[row])
    if numbers is not None:
        return numbers
    numbers = _number_rows(time_s) if row.size < time_s.size else None
    if numbers is not None:
        return SampleNumbers(numbers.number[row], numbers.period_s)
    period_s = float(np.median(np.diff(time_s)))
    return SampleNumbers(row, period_s, row.size < MIN_WINDOW_ROWS * 4)


def _number_rows(time_s: FloatArray) -> SampleNumbers | None:
    """Return the numbers of rows, None if the times do not show the period."""
    step_s = np.diff(time_s)
    window = min(WINDOW_ROWS, time_s.size // 4)
    if window < MIN_WINDOW_ROWS:
        return None
    stride = max(1, (time_s.size - window) // MAX_INSPECTED)
    durations_s = time_s[window::stride] - time_s[:-window:stride]
    mean_s = float(np.median(durations_s)) / window
    lowest_s, low_s, high_s, highest_s = np.percentile(durations_s, (5.0, 25.0, 75.0, 95.0))
    has_constant_rate = high_s - low_s <= 0.5 * mean_s
    common = _find_common_period(step_s)
    if common is not None:
        period_s, scatter = common
        # Times with coarse digits also are multiples, those of the digit. But then each window
        # takes the same time up to one digit, and lost rows differ more from window to window.
        has_coarse_digits = (
            highest_s - lowest_s < 1.5 * period_s and mean_s > (1.0 + PERIOD_TOLERANCE) * period_s
        )
        jitters = has_constant_rate and scatter > MAX_EXACT_SCATTER
        if not has_coarse_digits and not jitters:
            return SampleNumbers(_count_steps(step_s, period_s), period_s)
    if not has_constant_rate:
        return None
    if time_s.size < 4 * NEIGHBOURS:
        return SampleNumbers(np.arange(time_s.size, dtype=np.int64), mean_s)
    longest_s = longest_gap_s(mean_s)
    pause_s = np.where(step_s > longest_s, step_s - mean_s, 0.0)
    running_s = time_s - np.concatenate([[0.0], np.cumsum(pause_s)])
    return SampleNumbers(count_rows(running_s, NEIGHBOURS // 2), mean_s)


def _find_common_period(step_s: FloatArray) -> tuple[float, float] | None:
    """Return the period of which the steps are multiples, and their scatter about them, in periods.

    None without such a period.
    """
    inspected = step_s[:: max(1, step_s.size // MAX_INSPECTED)]
    median_s = float(np.median(inspected))
    for divisor in range(1, MAX_DIVISOR + 1):
        period_s = median_s / divisor
        for _ in range(3):
            count = np.rint(inspected / period_s)
            is_short = (count >= 1.0) & (count <= MAX_COUNTED)
            if not is_short.any():
                break
            period_s = float(
                np.sum(inspected[is_short] * count[is_short]) / np.sum(count[is_short] ** 2)
            )
        periods = inspected / period_s
        count = np.rint(periods)
        is_short = count <= MAX_COUNTED
        scatter = float(np.sqrt(np.mean((periods - count)[is_short] ** 2)))
        if scatter <= MAX_SCATTER and np.mean(count == 1.0) >= MIN_SINGLE_SHARE:
            return period_s, scatter
    return None


def _count_steps(step_s: FloatArray, period_s: float) -> IntArray:
    """Return the numbers of rows from steps that are multiples of the period.

    A pause is one step, because nothing was sampled in it.
    """
    counts = np.rint(step_s / period_s)
    counts[step_s > longest_gap_s(period_s)] = 1.0
    # a late sample is followed by an early one, whose step can be less than half a period
    for at in np.flatnonzero(counts == 0.0).tolist():
        counts[at] = 1.0
        for neighbour in (at - 1, at + 1):
            if 0 <= neighbour < counts.size and counts[neighbour] >= 2.0:
                counts[neighbour] -= 1.0
                break
    return np.concatenate([[0], np.cumsum(counts.astype(np.int64))])
