"""What two-way exchanges know of the constant that arrivals cannot show.

One-way stamps place the board's clock late by the link's least latency s. A ping bounds
it from both sides: the board received after the host sent, and sent before the host
received, so m(T3) - t4 <= s <= m(T2) - t1, m the one-way mapping (time synchronisation
notes, section 4). The lower hull over all upper bounds and the upper hull over all lower
ones hold s at every moment: their distance is the certified width, their midpoint the
estimate where both directions have like floors. Where the midpoint drifts by more than
the hulls can err, the one-way mapping does (a stream that beats with USB frames), and the
times follow the midpoint.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.clocks.envelope import Envelope, hull_line, piecewise_envelope
from gyrorig_solver.clocks.mapping import ClockMap

FEWEST = 10  # fewer exchanges say too little of the least latency
ENOUGH = 300  # from here on the hulls held the truth in every trial (notes, section 4)
LINE_UP_TO_S = 120.0
KNOT_SPACING_S = 60.0  # 300 exchanges at five a second
WALK_PER_SQRT_S = 1e-8  # of a crystal's rate (notes, section 2)
# A line under n exponential delays errs by 3.4 to 3.9 mu/n at its ends (notes, section 2): by
# so much the bounds are widened.
EDGE_ERROR = 4.0
PARTS = 4  # of the pings, whose midpoints' scatter says what a midpoint is worth
DRIFT_SIGMAS = 2.0  # of the parts' midpoints, which err 1 to 4 times as much as that of all
NEAR_S = 2.0  # a ping is dated by a sample that came within this


@dataclass(frozen=True, slots=True, eq=False)
class TwoWay:
    """Where the device's clock stands by its pings alone: two hulls over device time."""

    low: Envelope  # capture clock minus device time: at least
    high: Envelope  # at most
    low_error_s: float  # what the hulls may err
    high_error_s: float
    one_way: Envelope  # the same by the arrivals, late by the least latency

    def latency_at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the least and the largest least latency by the hulls, at one-way times."""
        # Device time is where the one-way map came from.
        late = Envelope(self.one_way.knot_s + self.one_way.delay_s, self.one_way.delay_s)
        delay_s = late.at(time_s)
        device_s = time_s - delay_s
        return delay_s - self.high.at(device_s), delay_s - self.low.at(device_s)


@dataclass(frozen=True, slots=True, eq=False)
class LinkFloor:
    """Bounds of the link's least latency, s: of its mean, where it drifts."""

    low_s: float
    high_s: float
    two_way: TwoWay | None = None  # None: too few pings for more than one interval
    drifts: bool = False  # the one-way map does, by more than the hulls can err

    @property
    def middle_s(self) -> float:
        """The estimate, both directions taken alike."""
        return (self.low_s + self.high_s) / 2.0

    @property
    def std_s(self) -> float:
        """Of a uniform distribution between the bounds."""
        return (self.high_s - self.low_s) / float(np.sqrt(12.0))

    def bounds_at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the bounds at one-way times."""
        if self.two_way is None:
            return np.full_like(time_s, self.low_s), np.full_like(time_s, self.high_s)
        low, high = self.two_way.latency_at(time_s)
        return low - self.two_way.high_error_s, high + self.two_way.low_error_s

    def middle_at(self, time_s: FloatArray) -> FloatArray:
        """Return what to take off one-way times: the midpoint, constant unless it drifts."""
        if self.two_way is None or not self.drifts:
            return np.full_like(time_s, self.middle_s)
        low, high = self.two_way.latency_at(time_s)
        return np.asarray((low + high) / 2.0, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Pings:
    """Exchanges: host times in s on the capture clock, board times in raw ticks."""

    host_send_s: FloatArray
    host_receive_s: FloatArray
    device_receive: IntArray
    device_send: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The samples that arrived nearest to the pings; they date the pings' ticks."""

    index: IntArray  # (p,)
    ticks: IntArray  # (p,), as sent
    host_s: FloatArray  # (p,)
    first_tick: int  # of the recording
    first_host_s: float

    @classmethod
    def of(cls, pings: Pings, ticks: IntArray, host_s: FloatArray) -> "Nearest":
        """Find them among the samples' ticks and arrivals, not decreasing, shape (n,)."""
        index = np.clip(np.searchsorted(host_s, pings.host_send_s), 0, host_s.size - 1)
        return cls(index, ticks[index], host_s[index], int(ticks[0]), float(host_s[0]))


def link_floor(
    pings: Pings,
    ticks: IntArray,
    host_s: FloatArray,
    clock: ClockMap,
    tick_hz: float,
    counter_bits: int,
) -> LinkFloor | None:
    """Return the bounds of the least latency, None where the pings cannot tell.

    Args:
        pings: the exchanges.
        ticks: of the samples, as sent, shape (n,).
        host_s: the samples' arrivals, shape (n,), not decreasing.
        clock: the samples' one-way times.
        tick_hz: of the board's clock.
        counter_bits: width of the samples' counter.
    """
    return floor_of(pings, Nearest.of(pings, ticks, host_s), clock, tick_hz, counter_bits)


def floor_of(
    pings: Pings, nearest: Nearest, clock: ClockMap, tick_hz: float, counter_bits: int
) -> LinkFloor | None:
    """Return the same as `link_floor`, from the samples nearest to the pings alone."""
    near, ticks, host_s = nearest.index, nearest.ticks, nearest.host_s
    before = np.maximum(near - 1, 0)
    # Between two segments nobody knows which clock a ping read.
    known = clock.segment[near] == clock.segment[before]
    known &= np.abs(host_s - pings.host_send_s) < NEAR_S
    received_s = _ahead_s(pings.device_receive, ticks, tick_hz, counter_bits)
    sent_s = _ahead_s(pings.device_send, ticks, tick_hz, counter_bits)
    known &= np.abs(received_s) < 2.0 * NEAR_S
    if np.count_nonzero(known) < FEWEST:
        return None
    near, ticks, host_s = near[known], ticks[known], host_s[known]
    received_s, sent_s = received_s[known], sent_s[known]
    send_s, receive_s = pings.host_send_s[known], pings.host_receive_s[known]
    if near.size >= ENOUGH and clock.segments == 1 and clock.floor is not None:
        modulus_s = 2**counter_bits / tick_hz if counter_bits < 63 else np.inf
        device_s = (ticks - nearest.first_tick) / tick_hz
        if np.isfinite(modulus_s):
            passed_s = host_s - nearest.first_host_s
            device_s += modulus_s * np.rint((passed_s - device_s) / modulus_s)
        found = _two_way(
            (device_s + received_s, send_s), (device_s + sent_s, receive_s), clock.floor
        )
        if found is not None:
            return found
    rate = 1.0 / (1.0 + 1e-6 * clock.skew_ppm)
    low_s = float(np.max(clock.time_s[near] + rate * sent_s - receive_s))
    high_s = float(np.min(clock.time_s[near] + rate * received_s - send_s))
    # Bounds that cross by more than the mapping can err say that the stamps are not one clock's.
    return LinkFloor(low_s, high_s) if low_s <= high_s else None


def asked_s(
    pings: Pings, nearest: Nearest, clock: ClockMap, tick_hz: float, counter_bits: int
) -> tuple[BoolArray, FloatArray]:
    """Return which pings a board's samples can date, and when it received those, (p',).

    By the times in `clock`, whatever has been taken off them; see `link_floor`.
    """
    ahead_s = _ahead_s(pings.device_receive, nearest.ticks, tick_hz, counter_bits)
    known = (np.abs(nearest.host_s - pings.host_send_s) < NEAR_S) & (np.abs(ahead_s) < 2.0 * NEAR_S)
    rate = 1.0 / (1.0 + 1e-6 * clock.skew_ppm)
    return known, clock.time_s[nearest.index[known]] + rate * ahead_s[known]


def _ahead_s(device: IntArray, ticks: IntArray, tick_hz: float, counter_bits: int) -> FloatArray:
    """Return how far ping stamps are ahead of samples' ticks, the shorter way round."""
    ahead = device - ticks
    if counter_bits < 63:
        modulus = 2**counter_bits
        ahead = (ahead + modulus // 2) % modulus - modulus // 2
    return np.asarray(ahead / tick_hz, dtype=np.float64)


def _two_way(
    received: tuple[FloatArray, FloatArray], sent: tuple[FloatArray, FloatArray], one_way: Envelope
) -> LinkFloor | None:
    """Return the bounds as two hulls over time, None where they cross.

    Args:
        received: device time of reception and host time of sending, shape (p,).
        sent: device time of sending and host time of reception, shape (p,).
        one_way: the arrivals' lower envelope.
    """

    def hulls(part: slice) -> TwoWay:
        (device_up, host_up), (device_down, host_down) = received, sent
        up, up_s = _hull(device_up[part], device_up[part] - host_up[part])
        down, down_s = _hull(device_down[part], host_down[part] - device_down[part])
        return TwoWay(Envelope(up.knot_s, -up.delay_s), down, up_s, down_s, one_way)

    two_way = hulls(slice(None))
    at_s = received[0] + one_way.at(received[0])
    low_at, high_at = two_way.latency_at(at_s)
    if np.any(low_at > high_at):
        return None
    middle = (low_at + high_at) / 2.0
    apart = [
        np.mean(hulls(slice(k, None, PARTS)).latency_at(at_s), axis=0) - middle
        for k in range(PARTS)
    ]
    error_s = float(np.sqrt(np.mean([np.var(part) for part in apart])))
    # Two sigmas of what the parts say, for delays that are rare near their floor.
    wide = replace(
        two_way,
        low_error_s=two_way.low_error_s + 2.0 * error_s,
        high_error_s=two_way.high_error_s + 2.0 * error_s,
    )
    return LinkFloor(
        float(np.mean(low_at)),
        float(np.mean(high_at)),
        wide,
        drifts=float(np.std(middle)) > DRIFT_SIGMAS * error_s,
    )


def _hull(at_s: FloatArray, delay_s: FloatArray) -> tuple[Envelope, float]:
    """Return the lower envelope of delays, and what it may err."""
    order = np.argsort(at_s, kind="stable")
    at_s, delay_s = at_s[order], delay_s[order]
    hull = hull_line(at_s, delay_s)
    excess_s = float(np.median(delay_s - hull.at(at_s))) / float(np.log(2.0))
    span_s = float(at_s[-1] - at_s[0])
    if span_s > LINE_UP_TO_S and excess_s > 0.0:
        stiffness = excess_s / (WALK_PER_SQRT_S * KNOT_SPACING_S**0.5)
        hull = piecewise_envelope(at_s, delay_s, KNOT_SPACING_S, stiffness)
    count = at_s.size * min(1.0, KNOT_SPACING_S / span_s)
    return hull, EDGE_ERROR * excess_s / count
