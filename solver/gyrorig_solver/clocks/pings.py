"""What two-way exchanges know of the constant that arrivals cannot show.

One-way stamps place the board's clock late by the link's least latency s. A ping bounds
it from both sides: the board received after the host sent, and sent before the host
received, so max(m(T3) - t4) <= s <= min(m(T2) - t1), m the one-way mapping (time
synchronisation notes, section 4). The midpoint is the estimate where both directions
have like floors; the width is certified.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray

FEWEST = 10  # fewer exchanges say too little of the least latency


@dataclass(frozen=True, slots=True)
class LinkFloor:
    """Bounds of the link's least latency, s."""

    low_s: float
    high_s: float

    @property
    def middle_s(self) -> float:
        """The estimate, both directions taken alike."""
        return (self.low_s + self.high_s) / 2.0

    @property
    def std_s(self) -> float:
        """Of a uniform distribution between the bounds."""
        return (self.high_s - self.low_s) / float(np.sqrt(12.0))


@dataclass(frozen=True, slots=True, eq=False)
class Pings:
    """Exchanges: host times in s on the capture clock, board times in raw ticks."""

    host_send_s: FloatArray
    host_receive_s: FloatArray
    device_receive: IntArray
    device_send: IntArray


def link_floor(
    pings: Pings,
    ticks: IntArray,
    host_s: FloatArray,
    time_s: FloatArray,
    tick_hz: float,
    counter_bits: int,
) -> LinkFloor | None:
    """Return the bounds of the least latency, None where the pings cannot tell.

    Args:
        pings: the exchanges.
        ticks: of the samples, as sent, shape (n,).
        host_s: the samples' arrivals, shape (n,), not decreasing.
        time_s: the samples' one-way times, shape (n,).
        tick_hz: of the board's clock.
        counter_bits: width of the samples' counter.
    """
    if pings.host_send_s.size < FEWEST:
        return None
    near = np.clip(np.searchsorted(host_s, pings.host_send_s), 0, host_s.size - 1)

    def one_way(device: IntArray) -> FloatArray:
        ahead = device - ticks[near]
        if counter_bits < 63:
            modulus = 2**counter_bits
            ahead = (ahead + modulus // 2) % modulus - modulus // 2
        return np.asarray(time_s[near] + ahead / tick_hz, dtype=np.float64)

    high = float(np.min(one_way(pings.device_receive) - pings.host_send_s))
    low = float(np.max(one_way(pings.device_send) - pings.host_receive_s))
    # Bounds that cross by more than the mapping can err say that the stamps are not one clock's.
    if low > high:
        return None
    return LinkFloor(low, high)
