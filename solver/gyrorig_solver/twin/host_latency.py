"""Latency of the host in an exchange: a request is written, and a reply is read.

The latencies of writing and of reading each have a floor and an excess with an exponential
distribution. Pings of a board show the sum of both floors and the mean of both excesses, so that
the replies of the unit show its answer time.

What to use when: `HostLatency` for the usual latency of an exchange; `median_of_sum` for the median
of both excesses.
"""

import math
from dataclasses import dataclass, replace

from scipy import optimize

EQUAL_MEANS = 1e-6  # relative difference below which two means are equal
LONGEST = 40.0  # times the sum of the means: the median is below
RELATIVE_STEP = 1e-3  # of a numeric derivative
BIAS_STEPS = 10  # of the iteration for the jitter of writing, which converges in a few


@dataclass(frozen=True, slots=True)
class HostFloor:
    """The smallest latency of the host, without transmission on the line."""

    floor_s: float  # of each of writing and reading
    std_s: float  # only the sum of both is known, so each has this uncertainty
    excess_s: float  # mean of an exchange above its smallest time, without stalls
    excess_std_s: float
    exchange_count: int

    def without_bias(self, jitter_s: float) -> "HostFloor":
        """Return the floor below the shortest exchange; `jitter_s`: mean excess of reading.

        The density of the sum of two exponential variables with the means a and b begins as
        t / (a b). The smallest of n therefore has a Rayleigh distribution with the mean
        sqrt(pi a b / (2 n)), and at least a / n.
        """
        bias_s = jitter_s / self.exchange_count
        for _ in range(BIAS_STEPS):
            write_jitter_s = max(self.excess_s + bias_s - jitter_s, 0.0)
            product_s2 = math.pi * jitter_s * write_jitter_s / (2.0 * self.exchange_count)
            bias_s = max(math.sqrt(product_s2), jitter_s / self.exchange_count)
        bias_s = min(bias_s, 2.0 * self.floor_s)
        return replace(self, floor_s=self.floor_s - bias_s / 2.0, excess_s=self.excess_s + bias_s)


@dataclass(frozen=True, slots=True)
class HostLatency:
    """The latency of the host in an exchange with a device, without the line."""

    floors_s: float  # of writing and reading together
    floors_std_s: float
    jitter_s: float  # mean excess of reading
    jitter_std_s: float
    write_jitter_s: float  # mean excess of writing
    write_jitter_std_s: float

    @property
    def exchange_s(self) -> float:
        """Usual latency of writing and reading."""
        return self.floors_s + median_of_sum(self.jitter_s, self.write_jitter_s)

    @property
    def exchange_std_s(self) -> float:
        """Standard uncertainty of the usual latency.

        The jitter of writing is the excess of an exchange minus the jitter of reading, so that its
        error contains the error of the jitter of reading with the opposite sign.
        """
        by_read, by_write = median_derivatives(self.jitter_s, self.write_jitter_s)
        excess_std_s = math.sqrt(max(self.write_jitter_std_s**2 - self.jitter_std_s**2, 0.0))
        return math.hypot(
            self.floors_std_s, (by_read - by_write) * self.jitter_std_s, by_write * excess_std_s
        )

    @property
    def write_s(self) -> float:
        """Usual latency of writing: its median."""
        return self.floors_s / 2.0 + median_of_sum(self.write_jitter_s, 0.0)


def median_of_sum(mean: float, other: float) -> float:
    """Return the median of the sum of two independent exponential variables.

    The sum has the hypoexponential distribution.

    Args:
        mean: of one variable, at least 0.
        other: of the other one, at least 0, in the same unit.
    """
    low, high = sorted((mean, other))
    if low <= EQUAL_MEANS * high:
        return high * math.log(2.0)
    ratio = low / high

    def exceeds(t: float) -> float:
        if 1.0 - ratio < EQUAL_MEANS:
            return math.exp(-t) * (1.0 + t) - 0.5
        return (math.exp(-t) - ratio * math.exp(-t / ratio)) / (1.0 - ratio) - 0.5

    return high * float(optimize.brentq(exceeds, 0.0, LONGEST))


def median_derivatives(mean: float, other: float) -> tuple[float, float]:
    """Return the derivatives of `median_of_sum` by its two arguments."""
    step = RELATIVE_STEP * max(mean, other)
    if step <= 0.0:
        return math.log(2.0), math.log(2.0)
    centre = median_of_sum(mean, other)
    return (
        (median_of_sum(mean + step, other) - centre) / step,
        (median_of_sum(mean, other + step) - centre) / step,
    )
