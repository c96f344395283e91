"""The clock of all timestamps, for the daemon and its acquisition process."""

import time


def raw_ns() -> int:
    """Return CLOCK_MONOTONIC_RAW in ns; NTP does not adjust it."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
