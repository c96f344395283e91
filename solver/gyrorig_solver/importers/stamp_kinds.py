"""Whether stamps are times of sampling or times of arrival, and how many samples are missing.

What to use when: `choose_stamp_kind` for the stamps of a stream whose source does not specify them;
`count_rows` for the sample numbers of a stream with arrival times.
"""

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.importers.measured_streams import StampKind

# Stamps of a device's own clock have steps that differ by its resolution; those of a host jitter
# by tens of microseconds at least.
MAX_SAMPLED_SPREAD = 0.02  # of the median step
EQUAL_NS = 1000  # stamps this close to the time of the log are the time of the log
GAP_STEPS = 1.25  # at a longer step, in periods, a sample can be missing
NEIGHBOURS = 50  # samples before and after a gap, whose earliest arrivals are compared


def find_stamp_kind(stamp_ns: IntArray, log_ns: IntArray | None = None) -> tuple[StampKind, str]:
    """Return what the stamps are, and the reason.

    Args:
        stamp_ns: the stamps of the messages, shape (n,).
        log_ns: the times at which the messages were logged, shape (n,), if the source has them.
    """
    if stamp_ns.size < 3:
        return "sampled", "there are too few to decide"
    if log_ns is not None and np.mean(np.abs(stamp_ns - log_ns) < EQUAL_NS) > 0.9:
        return "arrival", "they are the times at which the messages were logged"
    steps = np.diff(np.sort(stamp_ns)).astype(np.float64)
    median = float(np.median(steps))
    spread = 1.4826 * float(np.median(np.abs(steps - median))) / max(median, 1.0)
    if spread > MAX_SAMPLED_SPREAD:
        return "arrival", f"the steps between them differ by {100 * spread:.1f} %"
    return "sampled", f"the steps between them differ by only {100 * spread:.2f} %"


def choose_stamp_kind(
    stamp_ns: IntArray, log_ns: IntArray | None, chosen: str | None
) -> tuple[StampKind, str]:
    """Return what a person chose, "sampled" or "arrival", else what `find_stamp_kind` finds."""
    if chosen is not None:
        return ("arrival" if chosen == "arrival" else "sampled"), "as chosen"
    return find_stamp_kind(stamp_ns, log_ns)


def count_rows(arrival_s: FloatArray, least_neighbours: int = 1) -> IntArray:
    """Return the sample numbers of samples by their arrival, shape (n,), from 0.

    A late sample is followed by early ones. After a lost sample all later ones come later: at
    each gap, the earliest arrivals of the samples after it are compared with those before it.

    Args:
        arrival_s: arrival times, shape (n,), not decreasing.
        least_neighbours: samples on each side of a gap with which it is compared; a gap closer to
            the begin or the end loses no sample.
    """
    count = arrival_s.size
    rows = np.arange(count, dtype=np.int64)
    if count < 4 * NEIGHBOURS:
        return rows
    # over many samples jitter has little weight, and few of the stretches lose samples
    span = 2 * NEIGHBOURS
    period_s = float(np.median((arrival_s[span:] - arrival_s[:-span]) / span))
    gaps = np.flatnonzero(np.diff(arrival_s) > GAP_STEPS * period_s) + 1
    begin, total = 0, 0
    for gap in gaps[(gaps >= least_neighbours) & (gaps <= count - least_neighbours)].tolist():
        if total:
            rows[begin:gap] += total
        begin = gap
        before, after = slice(max(0, gap - NEIGHBOURS), gap), slice(gap, gap + NEIGHBOURS)
        delay_s = (arrival_s[after] - period_s * rows[after]).min() - period_s * total
        delay_s -= (arrival_s[before] - period_s * rows[before]).min()
        total += max(0, round(float(delay_s) / period_s))
    rows[begin:] += total
    return rows
