"""Bounds of a link's minimum latency from two-way exchanges (pings).

One-way timestamps place the clock of the board late by the minimum latency s of the link. A
ping bounds s from both sides: the board receives after the host sends, and sends before the
host receives. Therefore m(T3) - t4 <= s <= m(T2) - t1, with m the one-way map. The lower hull of
all upper bounds and the upper hull of all lower bounds contain s at every time. Their distance
is the certified width. Their midpoint is the estimate if both directions have the same minimum
latency. If the midpoint drifts by more than the error of the hulls, the one-way map drifts (for
example because a stream beats with USB frames), and the times follow the midpoint.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_map import ClockMap
from gyrorig_solver.data.clocks.lower_envelope import Envelope, hull_line, piecewise_envelope

MIN_PINGS = 10  # fewer exchanges do not bound the latency well
MIN_PINGS_FOR_HULLS = 300  # from this number on, the hulls contained the truth in all simulations
MAX_LINE_SPAN_S = 120.0
KNOT_SPACING_S = 60.0  # 300 exchanges at five per second
WALK_PER_SQRT_S = 1e-8  # assumed, of a crystal's rate
# A line below n exponential delays errs by 3.4 to 3.9 mu/n at its ends (simulated); the bounds
# are widened by this factor.
HULL_END_ERROR_FACTOR = 4.0
SUBSETS = 4  # interleaved subsets of the pings; the scatter of their midpoints is the uncertainty
DRIFT_SIGMAS = 2.0  # of the subsets' midpoints, which err 1 to 4 times as much as that of all
MAX_SAMPLE_DISTANCE_S = 2.0  # of the sample that dates a ping


@dataclass(frozen=True, slots=True, eq=False)
class TwoWayBounds:
    """Bounds of the clock map from pings alone: two hulls over device time."""

    lower: Envelope  # lower bound of capture clock minus device time
    upper: Envelope  # upper bound
    lower_error_s: float  # possible error of the hull
    upper_error_s: float
    one_way: Envelope  # from the arrivals, late by the minimum latency

    def latency_at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of the minimum latency by the hulls, at one-way times."""
        # Convert one-way times back to device time.
        latency = Envelope(self.one_way.knot_s + self.one_way.delay_s, self.one_way.delay_s)
        delay_s = latency.delay_at(time_s)
        device_s = time_s - delay_s
        return delay_s - self.upper.delay_at(device_s), delay_s - self.lower.delay_at(device_s)


@dataclass(frozen=True, slots=True, eq=False)
class LatencyBounds:
    """Bounds of the link's minimum latency, s, or of its mean if it drifts."""

    low_s: float
    high_s: float
    two_way: TwoWayBounds | None = None  # None: the pings give one interval only
    is_drifting: bool = False  # the one-way map drifts by more than the error of the hulls

    @property
    def midpoint_s(self) -> float:
        """The estimate, with equal minimum latencies in both directions."""
        return (self.low_s + self.high_s) / 2.0

    @property
    def std_s(self) -> float:
        """Standard deviation of a uniform distribution between the bounds."""
        return (self.high_s - self.low_s) / float(np.sqrt(12.0))

    def bounds_at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the bounds at one-way times."""
        if self.two_way is None:
            return np.full_like(time_s, self.low_s), np.full_like(time_s, self.high_s)
        low, high = self.two_way.latency_at(time_s)
        return low - self.two_way.upper_error_s, high + self.two_way.lower_error_s

    def midpoint_at(self, time_s: FloatArray) -> FloatArray:
        """Return the midpoint to subtract from one-way times, constant unless it drifts."""
        if self.two_way is None or not self.is_drifting:
            return np.full_like(time_s, self.midpoint_s)
        low, high = self.two_way.latency_at(time_s)
        return np.asarray((low + high) / 2.0, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PingExchanges:
    """Ping exchanges: host times in s on the capture clock, board times in raw ticks."""

    host_send_s: FloatArray
    host_receive_s: FloatArray
    device_receive: IntArray
    device_send: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class NearestSamples:
    """The samples that arrived nearest to the pings; they date the ticks of the pings."""

    index: IntArray  # (p,)
    ticks: IntArray  # (p,), as sent
    host_s: FloatArray  # (p,)
    first_tick: int  # of the recording
    first_host_s: float

    @classmethod
    def of(cls, pings: PingExchanges, ticks: IntArray, host_s: FloatArray) -> "NearestSamples":
        """Return the nearest samples; ticks and arrivals of shape (n,), arrivals sorted."""
        index = np.clip(np.searchsorted(host_s, pings.host_send_s), 0, host_s.size - 1)
        return cls(index, ticks[index], host_s[index], int(ticks[0]), float(host_s[0]))


def estimate_latency_bounds(
    pings: PingExchanges,
    nearest_samples: NearestSamples,
    clock: ClockMap,
    tick_hz: float,
    counter_bits: int,
) -> LatencyBounds | None:
    """Return the bounds of the minimum latency, None if the pings are not sufficient."""
    sample_index = nearest_samples.index
    ticks = nearest_samples.ticks
    host_s = nearest_samples.host_s
    before = np.maximum(sample_index - 1, 0)
    # Between two segments the clock of a ping is not known.
    usable = clock.segment[sample_index] == clock.segment[before]
    usable &= np.abs(host_s - pings.host_send_s) < MAX_SAMPLE_DISTANCE_S
    received_s = _tick_lead_s(pings.device_receive, ticks, tick_hz, counter_bits)
    sent_s = _tick_lead_s(pings.device_send, ticks, tick_hz, counter_bits)
    usable &= np.abs(received_s) < 2.0 * MAX_SAMPLE_DISTANCE_S
    if np.count_nonzero(usable) < MIN_PINGS:
        return None
    sample_index, ticks, host_s = sample_index[usable], ticks[usable], host_s[usable]
    received_s, sent_s = received_s[usable], sent_s[usable]
    send_s, receive_s = pings.host_send_s[usable], pings.host_receive_s[usable]
    if (
        sample_index.size >= MIN_PINGS_FOR_HULLS
        and clock.segment_count == 1
        and clock.latency_floor is not None
    ):
        modulus_s = 2**counter_bits / tick_hz if counter_bits < 63 else np.inf
        device_s = (ticks - nearest_samples.first_tick) / tick_hz
        if np.isfinite(modulus_s):
            passed_s = host_s - nearest_samples.first_host_s
            device_s += modulus_s * np.rint((passed_s - device_s) / modulus_s)
        bounds = _two_way_bounds(
            (device_s + received_s, send_s), (device_s + sent_s, receive_s), clock.latency_floor
        )
        if bounds is not None:
            return bounds
    rate = 1.0 / (1.0 + 1e-6 * clock.skew_ppm)
    low_s = float(np.max(clock.time_s[sample_index] + rate * sent_s - receive_s))
    high_s = float(np.min(clock.time_s[sample_index] + rate * received_s - send_s))
    # If the bounds cross, the timestamps are not those of one clock.
    return LatencyBounds(low_s, high_s) if low_s <= high_s else None


def ping_reception_times(
    pings: PingExchanges,
    nearest_samples: NearestSamples,
    clock: ClockMap,
    tick_hz: float,
    counter_bits: int,
) -> tuple[BoolArray, FloatArray]:
    """Return the mask of datable pings and their reception times by the times in `clock`."""
    lead_s = _tick_lead_s(pings.device_receive, nearest_samples.ticks, tick_hz, counter_bits)
    usable = (np.abs(nearest_samples.host_s - pings.host_send_s) < MAX_SAMPLE_DISTANCE_S) & (
        np.abs(lead_s) < 2.0 * MAX_SAMPLE_DISTANCE_S
    )
    rate = 1.0 / (1.0 + 1e-6 * clock.skew_ppm)
    return usable, clock.time_s[nearest_samples.index[usable]] + rate * lead_s[usable]


def _tick_lead_s(
    device: IntArray, ticks: IntArray, tick_hz: float, counter_bits: int
) -> FloatArray:
    """Return the lead of ping timestamps over the samples' ticks, modulo the counter, s."""
    lead = device - ticks
    if counter_bits < 63:
        modulus = 2**counter_bits
        lead = (lead + modulus // 2) % modulus - modulus // 2
    return np.asarray(lead / tick_hz, dtype=np.float64)


def _two_way_bounds(
    received: tuple[FloatArray, FloatArray], sent: tuple[FloatArray, FloatArray], one_way: Envelope
) -> LatencyBounds | None:
    """Return the bounds as two hulls over time, None if they cross.

    Args:
        received: device time of reception and host time of sending, shape (p,).
        sent: device time of sending and host time of reception, shape (p,).
        one_way: lower envelope of the arrivals.
    """

    def hulls(part: slice) -> TwoWayBounds:
        (device_up, host_up), (device_down, host_down) = received, sent
        receive_hull, receive_error_s = _lower_envelope(
            device_up[part], device_up[part] - host_up[part]
        )
        send_hull, send_error_s = _lower_envelope(
            device_down[part], host_down[part] - device_down[part]
        )
        return TwoWayBounds(
            Envelope(receive_hull.knot_s, -receive_hull.delay_s),
            send_hull,
            receive_error_s,
            send_error_s,
            one_way,
        )

    two_way = hulls(slice(None))
    at_s = received[0] + one_way.delay_at(received[0])
    lower_s, upper_s = two_way.latency_at(at_s)
    if np.any(lower_s > upper_s):
        return None
    midpoint = (lower_s + upper_s) / 2.0
    midpoint_changes = [
        np.mean(hulls(slice(k, None, SUBSETS)).latency_at(at_s), axis=0) - midpoint
        for k in range(SUBSETS)
    ]
    error_s = float(np.sqrt(np.mean([np.var(part) for part in midpoint_changes])))
    # Two sigmas of the subsets, for delays that are rarely near their floor.
    widened = replace(
        two_way,
        lower_error_s=two_way.lower_error_s + 2.0 * error_s,
        upper_error_s=two_way.upper_error_s + 2.0 * error_s,
    )
    return LatencyBounds(
        float(np.mean(lower_s)),
        float(np.mean(upper_s)),
        widened,
        is_drifting=float(np.std(midpoint)) > DRIFT_SIGMAS * error_s,
    )


def _lower_envelope(at_s: FloatArray, delay_s: FloatArray) -> tuple[Envelope, float]:
    """Return the lower envelope of the delays and a bound on its error."""
    order = np.argsort(at_s, kind="stable")
    at_s, delay_s = at_s[order], delay_s[order]
    envelope = hull_line(at_s, delay_s)
    excess_s = float(np.median(delay_s - envelope.delay_at(at_s))) / float(np.log(2.0))
    span_s = float(at_s[-1] - at_s[0])
    if span_s > MAX_LINE_SPAN_S and excess_s > 0.0:
        stiffness = excess_s / (WALK_PER_SQRT_S * KNOT_SPACING_S**0.5)
        envelope = piecewise_envelope(at_s, delay_s, KNOT_SPACING_S, stiffness)
    count = at_s.size * min(1.0, KNOT_SPACING_S / span_s)
    return envelope, HULL_END_ERROR_FACTOR * excess_s / count
