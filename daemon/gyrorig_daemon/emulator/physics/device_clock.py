"""Clocks of devices: a board's microseconds, a controller's ticks.

The rate has a skew and a random walk of frequency. Knots one second apart are drawn in order and
stored, so that a reading does not depend on the order of the queries.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

_KNOT_S = 1.0


@dataclass(frozen=True, slots=True)
class ClockTruth:
    """True properties of a counter."""

    tick_hz: float
    skew: float = 0.0  # relative rate error at the start; 50e-6 is 50 ppm fast
    wander_per_rts: float = 0.0  # random walk of the rate error, per sqrt(s)
    start_ticks: int = 0


class DeviceClock:
    """A free-running counter that does not wrap; some of its bits are transmitted.

    At each reset it starts from zero again, as at a reboot; the oscillator continues.
    """

    def __init__(
        self,
        truth: ClockTruth,
        origin_ns: int,
        rng: np.random.Generator,
        resets_ns: tuple[int, ...] = (),
    ) -> None:
        """Start counting at `origin_ns`, the host's raw monotonic time."""
        self.truth = truth
        self._rng = rng
        self._origin_ns = origin_ns
        self._resets_ns = sorted(resets_ns)
        self._rates = [1.0 + truth.skew]
        self._elapsed = [0.0]  # device seconds at each knot

    def seconds(self, at_ns: int) -> float:
        """Return device seconds since the origin, independent of resets."""
        host_s = (at_ns - self._origin_ns) * 1e-9
        if host_s < 0.0:
            return host_s * self._rates[0]
        knot = int(host_s / _KNOT_S)
        while len(self._elapsed) <= knot:
            self._elapsed.append(self._elapsed[-1] + self._rates[-1] * _KNOT_S)
            step = self.truth.wander_per_rts * math.sqrt(_KNOT_S) * self._rng.standard_normal()
            self._rates.append(self._rates[-1] + step)
        return self._elapsed[knot] + self._rates[knot] * (host_s - knot * _KNOT_S)

    def last_reset_ns(self, at_ns: int) -> int | None:
        """Return the time of the last reset before a time, None before the first one."""
        index = bisect_right(self._resets_ns, at_ns)
        return self._resets_ns[index - 1] if index else None

    def ticks(self, at_ns: int) -> int:
        """Return the counter, not wrapped."""
        reset_ns = self.last_reset_ns(at_ns)
        if reset_ns is not None:
            return int((self.seconds(at_ns) - self.seconds(reset_ns)) * self.truth.tick_hz)
        return self.truth.start_ticks + math.floor(self.seconds(at_ns) * self.truth.tick_hz)
