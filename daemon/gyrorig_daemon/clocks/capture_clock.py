"""The capture clock: UTC read once, plus CLOCK_MONOTONIC_RAW since then.

It contains no step or slew of NTP. The host's other clocks are read once per second, so that
the solver can identify a slew or a step.
"""

import contextlib
import ctypes
import math
import os
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ANCHOR_READINGS = 5
STA_UNSYNC = 0x40  # <linux/timex.h>
# systemd-timesyncd makes this file when it has set the clock. A sandbox can deny adjtimex(2).
SYNCHRONISED_FILE = Path("/run/systemd/timesync/synchronized")
_ADJTIMEX_FREQUENCY_UNIT = 65536.0  # <linux/timex.h>: ppm scaled by 2^16
_TIMEX = ctypes.c_long * 64  # more than the structure's 208 bytes


@dataclass(slots=True)
class CaptureClock:
    """The anchor of a session. The rig keeps one object and moves it between sessions."""

    anchor_utc_ns: int
    anchor_raw_ns: int

    def copy_anchor(self, other: "CaptureClock") -> None:
        """Use the anchor of another clock: a new session starts."""
        self.anchor_utc_ns, self.anchor_raw_ns = other.anchor_utc_ns, other.anchor_raw_ns

    def utc_ns(self, raw_ns: int) -> int:
        """Return the capture time of a raw monotonic timestamp."""
        return raw_ns - self.anchor_raw_ns + self.anchor_utc_ns


@dataclass(frozen=True, slots=True)
class HostClocks:
    """The host's clocks in ns, read together, and the kernel's NTP state."""

    raw_ns: int
    monotonic_ns: int
    realtime_ns: int
    frequency_ppm: float
    estimated_error_s: float
    ntp_status: int

    @property
    def is_synchronised(self) -> bool | None:
        """Whether the system time follows UTC, None if the kernel does not tell this process."""
        if not self.ntp_status & STA_UNSYNC:
            return True
        return None if math.isnan(self.frequency_ppm) else False


def anchor_now() -> CaptureClock:
    """Return an anchor: the tightest of a few bracketed readings of both clocks."""
    best: tuple[int, CaptureClock] | None = None
    for _ in range(ANCHOR_READINGS):
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        utc_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
        width_ns = after_ns - before_ns
        if best is None or width_ns < best[0]:
            best = width_ns, CaptureClock(utc_ns, before_ns + width_ns // 2)
    if best is None:  # BRACKETS is not zero
        raise AssertionError
    return best[1]


def read_host_clocks() -> HostClocks:
    """Return the present time of the host's clocks."""
    before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
    monotonic_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    realtime_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
    after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW)
    frequency_ppm, error_s, status = _adjtimex()
    return HostClocks(
        (before_ns + after_ns) // 2, monotonic_ns, realtime_ns, frequency_ppm, error_s, status
    )


def _adjtimex() -> tuple[float, float, int]:
    """Return frequency in ppm, estimated error in s and status.

    Without the system call, both numbers are nan, and systemd-timesyncd decides about the status.
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        # struct timex, 64-bit: modes, offset, freq, maxerror, esterror, status (longs, with
        # the ints padded); modes 0 only reads
        words = _TIMEX()
        if _libc().adjtimex(ctypes.byref(words)) >= 0 and ctypes.sizeof(ctypes.c_long) == 8:
            return words[2] / _ADJTIMEX_FREQUENCY_UNIT, words[4] * 1e-6, words[5] & 0xFFFF_FFFF
    return math.nan, math.nan, 0 if os.access(SYNCHRONISED_FILE, os.F_OK) else STA_UNSYNC


@cache
def _libc() -> ctypes.CDLL:
    """Return the C library, opened once.

    Every `CDLL` makes two classes in a reference cycle, and the daemon collects cycles rarely.
    """
    return ctypes.CDLL(None, use_errno=True)
