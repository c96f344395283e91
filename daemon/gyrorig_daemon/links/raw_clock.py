"""The clock of every stamp, as the acquisition process and the daemon both read it."""

import time


def raw_ns() -> int:
    """Return CLOCK_MONOTONIC_RAW in ns: no NTP slew enters it."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
