"""Which lower envelope a stretch of arrivals deserves, and how far to believe it.

What to use when: `find_floor`. Up to two minutes one line follows a crystal; beyond, a
piecewise envelope by linear programming, and beside it the smoother on window minima.
The two err in different ways, so their difference shows what neither expects: latency
with a structure of its own, such as the beat of a timer with USB frames.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.clocks.envelope import Envelope, hull_line, piecewise_envelope
from gyrorig_solver.clocks.smoother import WINDOW_S, Smoothed, least_delays, memory, smooth

# Up to here one line follows a crystal; beyond, it wanders (notes, section 0, point 3).
LINE_UP_TO_S = 120.0
# In proportion to the window that balances jitter and wander, from and to.
KNOT_SPACING_S = (2.0, 30.0)
# One slope change costs what the delays' likelihood pays for it, mu over the walk's deviation
# across an interval, and somewhat less: too stiff errs by more than too soft (notes, section
# 3.2). Of 0.3, 0.5, 0.7 and 1 this is the best in the grid of bench_clocks.py.
SOFTNESS = 0.6
STRUCTURED_SPACING_S = 60.0  # notes, section 3.3: beats of cascaded quantisers
LONGEST_SPACING_S = 600.0  # beyond, a warming crystal bends away from a chord
WAVE_SHARE = 0.2  # of the power: less is no beat
# Frequency random walk of a crystal on a desk, per sqrt(s) (notes, section 2; an
# assumption, replaced by the smoother's finding in long recordings).
WALK_PER_SQRT_S = 1e-8
# Squared autocorrelations of honest windows sum to less, whatever the delays' distribution.
MEMORY_LIMIT = 0.25
DISAGREEMENT_LIMIT = 3.0  # times the predicted deviation (notes, section 10)
LEAST_STRUCTURE_S = 2e-6  # below, it is the counter's own grain


@dataclass(frozen=True, slots=True, eq=False)
class Floor:
    """The latency floor over device time, and its judgement."""

    envelope: Envelope
    method: str
    bound_s: float  # e*
    sigma_s: float  # predicted wander
    disagreement_s: float = 0.0
    structured: str = ""
    walk_per_sqrt_s: float = float("nan")


def find_floor(x: FloatArray, y: FloatArray) -> Floor:
    """Return the floor of delays.

    Args:
        x: device time, not decreasing, shape (n,).
        y: arrival minus device time, shape (n,).
    """
    line = hull_line(x, y)
    mean_s = _mean_delay_s(x, y, line)
    span_s = float(x[-1] - x[0])
    if span_s <= 0.0 or mean_s <= 0.0:
        return Floor(line, "line", 0.0, 0.0)
    period_s = span_s / x.size
    if span_s <= LINE_UP_TO_S:
        return _short(x, y, line, mean_s, period_s)
    second = smooth(x, y, line, mean_s)
    if second is None:
        return Floor(line, "line", bound_s(mean_s, period_s, WALK_PER_SQRT_S), float("nan"))
    return _long(x, y, second, mean_s, period_s)


def bound_s(mean_s: float, period_s: float, walk: float) -> float:
    """Return e* = (mu/f)^0.6 q^0.4, what an ideal envelope leaves (notes, section 2)."""
    return float((mean_s * period_s) ** 0.6 * walk**0.4)


def _mean_delay_s(x: FloatArray, y: FloatArray, line: Envelope) -> float:
    """Return the mean of an exponential with the delays' median, in stretches of two minutes."""
    spread = []
    parts = max(1, int((x[-1] - x[0]) / LINE_UP_TO_S))
    for a, b in pairwise(k * x.size // parts for k in range(parts + 1)):
        if b - a > 8:
            floor = line if b - a == x.size else hull_line(x[a:b], y[a:b])
            spread.append(float(np.median(y[a:b] - floor.at(x[a:b]))))
    return float(np.median(spread)) / float(np.log(2.0)) if spread else 0.0


def _short(x: FloatArray, y: FloatArray, line: Envelope, mean_s: float, period_s: float) -> Floor:
    """Judge a line by the least delays of its windows."""
    windows = least_delays(x, y, line, WINDOW_S, mean_s)
    rest = windows.least_s - line.at(windows.at_s)
    # What a resonator's rate may wander off a line (integrated walk, bridged at both ends).
    wander_s = 1e-7 * float(x[-1] - x[0]) ** 1.5 / np.sqrt(120.0)
    limit_s = DISAGREEMENT_LIMIT * max(windows.sigma_s, float(wander_s), LEAST_STRUCTURE_S)
    spread_s = 1.4826 * float(np.median(np.abs(rest - np.median(rest))))
    structured = ""
    if spread_s > limit_s and memory(rest) > MEMORY_LIMIT:
        structured = f"the least delays of {WINDOW_S:g} s drift by {_short_time(spread_s)}"
    # Notes, section 2: a line under n points, if many lie near the floor.
    sigma_s = max(2.45 * mean_s / x.size, 0.3 * windows.sigma_s)
    return Floor(
        line,
        "line",
        bound_s(mean_s, period_s, WALK_PER_SQRT_S),
        max(sigma_s, spread_s) if structured else sigma_s,
        structured=structured,
    )


def _long(x: FloatArray, y: FloatArray, second: Smoothed, mean_s: float, period_s: float) -> Floor:
    """Return envelope or smoother, and what their difference says."""
    walk, windows = second.walk, second.windows
    best_s = bound_s(mean_s, period_s, walk)
    spacing_s = float(np.clip(1.5 * (mean_s * period_s / walk) ** 0.4, *KNOT_SPACING_S))
    first = _envelope(x, y, spacing_s, mean_s, walk)
    apart_s = _rms_apart(first, second)
    excess_s = float(np.median(windows.excess_s))
    noise_s = max(windows.sigma_s, excess_s)
    # Where few delays lie near the floor, the least ones scatter by more than mu/n.
    dense = noise_s < 3.0 * excess_s + 1e-6
    smoothed_s = float(np.median(second.sigma_s))
    sigma_s = float(np.hypot(smoothed_s, 0.6 * best_s if dense else 0.5 * noise_s))
    structured = ""
    if apart_s > DISAGREEMENT_LIMIT * sigma_s + LEAST_STRUCTURE_S:
        structured = (
            f"envelope and smoother differ by {_short_time(apart_s)}, "
            f"{apart_s / sigma_s:.0f} times what they should"
        )
    elif second.memory > MEMORY_LIMIT and noise_s > LEAST_STRUCTURE_S:
        structured = f"the least delays of {WINDOW_S:g} s remember each other"
    if structured:
        spacing_s = min(_beyond_beat_s(second), float(x[-1] - x[0]))
        first = _envelope(x, y, spacing_s, mean_s, WALK_PER_SQRT_S)
    # What two so different methods make of the same delays bounds what either is worth.
    envelope_s = max(0.6 * best_s, apart_s if structured else 0.8 * apart_s)
    chosen = dense or bool(structured)
    return Floor(
        first if chosen else second.floor,
        "envelope" if chosen else "smoother",
        best_s,
        envelope_s if chosen else max(smoothed_s, 0.4 * apart_s),
        apart_s,
        structured,
        walk,
    )


def _envelope(
    x: FloatArray, y: FloatArray, spacing_s: float, mean_s: float, walk: float
) -> Envelope:
    stiffness = SOFTNESS * mean_s / (walk * np.sqrt(spacing_s))
    return piecewise_envelope(x, y, spacing_s, stiffness)


def _short_time(value_s: float) -> str:
    return f"{value_s * 1e3:.0f} ms" if value_s >= 2e-3 else f"{value_s * 1e6:.0f} us"


def _rms_apart(first: Envelope, second: Smoothed) -> float:
    at_s = second.windows.at_s
    return float(np.std(first.at(at_s) - second.floor.at(at_s)))


def _beyond_beat_s(second: Smoothed) -> float:
    """Return two periods of the strongest wave in the least delays, a minute where none is."""
    at_s, least_s = second.windows.at_s, second.windows.least_s
    # The clock's own wander is slower than any beat worth waiting for.
    around = round(LONGEST_SPACING_S / float(np.median(np.diff(at_s))))
    if at_s.size > 2 * around:
        mean = np.convolve(np.pad(least_s, around // 2, mode="edge"), np.ones(around) / around)
        rest = (least_s - mean[around - 1 :][: at_s.size])[around // 2 : -around // 2]
    else:
        rest = least_s - np.polynomial.Polynomial.fit(at_s, least_s, 3)(at_s)
    limit = 6.0 * float(np.median(np.abs(rest)))
    power = np.abs(np.fft.rfft(np.clip(rest, -limit, limit))[1:]) ** 2
    at = int(np.argmax(power))
    if power[at] < WAVE_SHARE * power.sum():
        return STRUCTURED_SPACING_S
    beat_s = rest.size / (at + 1) * float(np.median(np.diff(at_s)))
    return float(np.clip(2.0 * beat_s, STRUCTURED_SPACING_S, LONGEST_SPACING_S))
