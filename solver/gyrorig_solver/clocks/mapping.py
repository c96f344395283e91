"""Sample times on the capture clock, from a board's ticks and the frames' arrivals."""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.clocks.envelope import Envelope, hull_line, piecewise_envelope
from gyrorig_solver.clocks.unwrap import unwrap_ticks

# Up to here one line follows a crystal; beyond, it wanders (notes, section 0, point 3).
LINE_UP_TO_S = 120.0
KNOT_SPACING_S = 10.0
# Frequency random walk of a crystal on a desk, per sqrt(s) (notes, section 2; an assumption).
WANDER_PER_SQRT_S = 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class ClockMap:
    """When each sample was taken, on the capture clock, up to one constant.

    The constant is the least latency of the link: no one-way stamp can show it, and the
    time offset that the motion gives holds it too.
    """

    time_s: FloatArray  # (n,), capture clock, seconds since the recording's origin
    segment: IntArray  # (n,), counts restarts of the device's clock
    late: BoolArray  # (n,)
    skew_ppm: float  # of the device's clock against the capture clock, longest segment
    wander_bound_s: float  # e* of the notes, section 2: what an ideal envelope leaves
    latency_s: FloatArray  # (3,), median, 99th percentile and largest delay above the floor
    restarts: int
    wraps: int


def map_clock(ticks: IntArray, host_s: FloatArray, tick_hz: float, counter_bits: int) -> ClockMap:
    """Return sample times from raw ticks and arrival times.

    Args:
        ticks: as sent, shape (n,).
        host_s: arrival of each frame's last byte, shape (n,), not decreasing.
        tick_hz: nominal ticks per second.
        counter_bits: width of the tick counter.
    """
    clock = unwrap_ticks(ticks, host_s, tick_hz, counter_bits)
    time_s = np.empty_like(host_s)
    skews: list[tuple[float, float]] = []
    delays = np.empty_like(host_s)
    bound_s = 0.0
    for k in range(clock.restarts + 1):
        inside = np.flatnonzero(clock.segment == k)
        x = clock.device_s[inside]
        y = host_s[inside] - x
        order = np.argsort(x, kind="stable")
        envelope, mean_s = _envelope(x[order], y[order])
        floor = envelope.at(x)
        time_s[inside] = x + floor
        delays[inside] = y - floor
        span = float(x.max() - x.min())
        skews.append((span, _slope(envelope)))
        bound_s = max(bound_s, _bound(mean_s, inside.size, span))
    skew = max(skews)[1]
    return ClockMap(
        time_s=time_s,
        segment=clock.segment,
        late=clock.late,
        skew_ppm=-1e6 * skew / (1.0 + skew),
        wander_bound_s=bound_s,
        latency_s=np.array([*np.percentile(delays, (50.0, 99.0)), delays.max()]),
        restarts=clock.restarts,
        wraps=clock.wraps,
    )


def _envelope(x: FloatArray, y: FloatArray) -> tuple[Envelope, float]:
    """Return the envelope and the mean delay above it, without the stalls."""
    line = hull_line(x, y)
    above = y - line.at(x)
    mean_s = float(np.median(above)) / np.log(2.0)  # the mean of an exponential
    if x[-1] - x[0] <= LINE_UP_TO_S or mean_s <= 0.0:
        return line, mean_s
    # One unit of slope change costs as much as lifting the points by mean/wander does
    # (notes, section 3.2: the knob is mu/q; too weak is safer than too stiff).
    change = WANDER_PER_SQRT_S * np.sqrt(KNOT_SPACING_S)
    return piecewise_envelope(x, y, KNOT_SPACING_S, mean_s / change), mean_s


def _slope(envelope: Envelope) -> float:
    if envelope.knot_s.size < 2:
        return 0.0
    span = envelope.knot_s[-1] - envelope.knot_s[0]
    return float((envelope.delay_s[-1] - envelope.delay_s[0]) / span)


def _bound(mean_s: float, samples: int, span_s: float) -> float:
    """Return e* = (mu/f)^0.6 q^0.4 (notes, section 2), 0 where there is no jitter."""
    if mean_s <= 0.0 or span_s <= 0.0:
        return 0.0
    return float((mean_s / (samples / span_s)) ** 0.6 * WANDER_PER_SQRT_S**0.4)
