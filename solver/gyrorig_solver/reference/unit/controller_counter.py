"""Sampling times of positions from the counter of the controller.

An E-series unit answers `BT` with its position and its counter. It samples the position after
it has received the query and before its reply begins. Therefore the map from the counter to the
capture clock is between two envelopes, above every earliest and below every latest time. The
middle of both gives the relative times of all samples; one constant stays unknown, uniform
between the envelopes.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.clocks.lower_envelope import Envelope, hull_line, piecewise_envelope
from gyrorig_solver.data.clocks.tick_unwrapping import unwrap_ticks

MIN_EXCHANGES = 50  # fewer exchanges do not determine a line better than a single time
# Share of times inside their exchanges; below it the counter is not valid.
MIN_INSIDE_SHARE = 0.99
# Longer recordings need knots, because a crystal wanders (docs/clocks.md).
MAX_LINE_SPAN_S = 120.0
KNOT_SPACING_S = 10.0
WANDER_PER_SQRT_S = 1e-8
MAX_OUTSIDE_S = 2e-4  # a wandering clock minus a line, over two minutes


@dataclass(frozen=True, slots=True, eq=False)
class CounterInstants:
    """Sampling times of the counts, up to one constant."""

    at_s: FloatArray  # (n,), capture clock
    width_s: float  # the constant is uniform in +-width/2
    skew_ppm: float  # of the counter relative to the capture clock


def counter_instants(
    ticks: IntArray, earliest_s: FloatArray, latest_s: FloatArray, counter_hz: float
) -> CounterInstants | None:
    """Return the sampling times by the controller's counter, None if it is not usable.

    Args:
        ticks: the counter in the replies, shape (n,), in the order of the exchanges.
        earliest_s: earliest time of each sample, shape (n,), not decreasing.
        latest_s: latest time, shape (n,).
        counter_hz: nominal ticks per second.
    """
    if ticks.size < MIN_EXCHANGES or not counter_hz > 0.0 or not np.any(np.diff(ticks)):
        return None
    bits = 32 if int(ticks.max()) < 2**32 else 64
    clock = unwrap_ticks(ticks, earliest_s, counter_hz, bits)
    if clock.segment.any() or clock.late_mask.any():
        return None
    device_s = clock.device_s
    latest_envelope = _delay_envelope(device_s, latest_s - device_s)
    earliest_envelope = _delay_envelope(device_s, device_s - earliest_s)
    high, low = latest_envelope.delay_at(device_s), -earliest_envelope.delay_at(device_s)
    at_s = device_s + (high + low) / 2.0
    inside = (at_s > earliest_s - MAX_OUTSIDE_S) & (at_s < latest_s + MAX_OUTSIDE_S)
    width_s = float(np.mean(high - low))
    if width_s <= 0.0 or np.mean(inside) < MIN_INSIDE_SHARE:
        return None
    span_s = float(device_s[-1] - device_s[0])
    rate = float(at_s[-1] - at_s[0]) / span_s
    return CounterInstants(at_s, width_s, 1e6 * (1.0 / rate - 1.0))


def _delay_envelope(device_s: FloatArray, delay_s: FloatArray) -> Envelope:
    """Return the lower envelope, a line or piecewise linear."""
    line = hull_line(device_s, delay_s)
    if device_s[-1] - device_s[0] <= MAX_LINE_SPAN_S:
        return line
    mean_s = float(np.median(delay_s - line.delay_at(device_s))) / float(np.log(2.0))
    if mean_s <= 0.0:
        return line
    change = WANDER_PER_SQRT_S * float(np.sqrt(KNOT_SPACING_S))
    return piecewise_envelope(device_s, delay_s, KNOT_SPACING_S, mean_s / change)
