"""The controller's own counter as a clock: when, inside each exchange, the count was taken.

An E-series unit answers `BT` with its position and its counter. The position was taken
after the query was received and before the answer began, so the counter's map to the
capture clock lies between two envelopes: above every earliest instant, below every latest.
The line half way between them places all samples of a recording against each other; what
stays unknown is one constant, uniform between the two.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.clocks.envelope import Envelope, hull_line, piecewise_envelope
from gyrorig_solver.clocks.unwrap import unwrap_ticks

FEWEST = 50  # fewer exchanges do not fix a line better than each fixes its own instant
# A counter whose samples fall outside their own exchanges is not the counter it says it is.
INSIDE_SHARE = 0.99
# Up to here one line follows a crystal; beyond, it wanders by about this (time
# synchronisation notes, section 0 point 3 and section 2).
LINE_UP_TO_S = 120.0
KNOT_SPACING_S = 10.0
WANDER_PER_SQRT_S = 1e-8
SLACK_S = 2e-4  # a wandering clock against a straight line, over two minutes


@dataclass(frozen=True, slots=True, eq=False)
class CounterInstants:
    """When each count was taken, up to one constant."""

    at_s: FloatArray  # (n,), capture clock
    width_s: float  # the constant lies in +-width/2, uniform
    skew_ppm: float  # of the counter against the capture clock


def counter_instants(
    ticks: IntArray, lo_s: FloatArray, hi_s: FloatArray, counter_hz: float
) -> CounterInstants | None:
    """Return the sample instants by the controller's counter, None where it cannot serve.

    Args:
        ticks: the counter as answered, shape (n,), in the order of the exchanges.
        lo_s: earliest instant of each sample, shape (n,), not decreasing.
        hi_s: latest instant, shape (n,).
        counter_hz: nominal ticks per second.
    """
    if ticks.size < FEWEST or not counter_hz > 0.0 or not np.any(np.diff(ticks)):
        return None
    bits = 32 if int(ticks.max()) < 2**32 else 64
    clock = unwrap_ticks(ticks, lo_s, counter_hz, bits)
    if clock.segment.any() or clock.late.any():
        return None
    device_s = clock.device_s
    latest = _envelope(device_s, hi_s - device_s)
    earliest = _envelope(device_s, device_s - lo_s)
    high, low = latest.at(device_s), -earliest.at(device_s)
    at_s = device_s + (high + low) / 2.0
    inside = (at_s > lo_s - SLACK_S) & (at_s < hi_s + SLACK_S)
    width_s = float(np.mean(high - low))
    if width_s <= 0.0 or np.mean(inside) < INSIDE_SHARE:
        return None
    span_s = float(device_s[-1] - device_s[0])
    rate = float(at_s[-1] - at_s[0]) / span_s
    return CounterInstants(at_s, width_s, 1e6 * (1.0 / rate - 1.0))


def _envelope(device_s: FloatArray, delay_s: FloatArray) -> Envelope:
    """Return the lower envelope: a line for short recordings, pieces for long ones."""
    line = hull_line(device_s, delay_s)
    if device_s[-1] - device_s[0] <= LINE_UP_TO_S:
        return line
    mean_s = float(np.median(delay_s - line.at(device_s))) / float(np.log(2.0))
    if mean_s <= 0.0:
        return line
    change = WANDER_PER_SQRT_S * float(np.sqrt(KNOT_SPACING_S))
    return piecewise_envelope(device_s, delay_s, KNOT_SPACING_S, mean_s / change)
