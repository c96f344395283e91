"""The minimum latency of a segment as a lower envelope, with its uncertainty.

What to use when: `find_latency_floor`. Up to two minutes the floor is a line; for longer
segments it is a piecewise envelope by linear programming or the smoother on window minima. The
two methods have different errors. A large difference indicates structured latency, for example
the beat of a timer with USB frames. The clock of a sensor drifts more than a crystal, so that its
floor is an envelope also in a short segment.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.data.clocks.clock_smoother import (
    WINDOW_S,
    DelayWindows,
    SmoothedClock,
    excess_autocorrelation,
    least_delays,
    smooth_clock,
)
from gyrorig_solver.data.clocks.lower_envelope import Envelope, hull_line, piecewise_envelope

# For longer segments the clock wanders too far from a line (docs/clocks.md).
MAX_LINE_SPAN_S = 120.0
# Limits of the knot spacing, which is proportional to T* of docs/clocks.md.
KNOT_SPACING_RANGE_S = (2.0, 30.0)
# Cost of a slope change, relative to mu over the standard deviation of the walk across an interval.
# Too large a cost gives a larger error than too small a cost; of 0.3, 0.5, 0.7 and 1, the best in
# bench_clocks.py is near this value.
STIFFNESS_FACTOR = 0.6
STRUCTURED_KNOT_SPACING_S = 60.0  # longer than the beats of cascaded quantisers
MAX_KNOT_SPACING_S = 600.0  # above it a warming crystal deviates from a line
MIN_BEAT_POWER_SHARE = 0.2  # of the power; below it there is no beat
# Assumed frequency random walk of a crystal on a desk, per sqrt(s); long recordings use the
# estimate of the smoother.
WALK_PER_SQRT_S = 1e-8
# Of the oscillator of a sensor, whose rate changes with its temperature. Of 1e-7, 3e-7, 1e-6 and
# 3e-6, it has the smallest errors at drifts of 0 to 500 ppm in 130 s.
SENSOR_WALK_PER_SQRT_S = 1e-6
MIN_DELAYS_PER_WINDOW = 4.0  # mean delays, so that each window contains a reading of a FIFO
# Sum of squared autocorrelations; independent windows stay below it for any distribution.
MAX_AUTOCORRELATION = 0.25
MAX_DISAGREEMENT_SIGMAS = 3.0  # times the predicted standard deviation
MIN_STRUCTURE_S = 2e-6  # smaller structure is the resolution of the counter


@dataclass(frozen=True, slots=True, eq=False)
class LatencyFloor:
    """The latency floor over device time, and its uncertainty."""

    envelope: Envelope
    method: str
    wander_bound_s: float  # e* of docs/clocks.md
    sigma_s: float  # predicted wander
    disagreement_s: float = 0.0
    structure_reason: str = ""
    walk_per_sqrt_s: float = float("nan")


def find_latency_floor(
    device_s: FloatArray, delay_s: FloatArray, *, is_sensor_clock: bool = False
) -> LatencyFloor:
    """Return the latency floor of delays.

    Args:
        device_s: device time, not decreasing, shape (n,).
        delay_s: arrival minus device time, shape (n,).
        is_sensor_clock: the device time counts samples, whose rate drifts with the temperature.
    """
    line = hull_line(device_s, delay_s)
    mean_s = _mean_delay_s(device_s, delay_s, line)
    span_s = float(device_s[-1] - device_s[0])
    if span_s <= 0.0 or mean_s <= 0.0:
        return LatencyFloor(line, "line", 0.0, 0.0)
    period_s = span_s / device_s.size
    if is_sensor_clock:
        window_s = max(WINDOW_S, MIN_DELAYS_PER_WINDOW * mean_s)
        windows = least_delays(device_s, delay_s, line, window_s, mean_s)
        beat_s = _beat_s(windows)
        # A faster change is not the temperature: the readings beat with the samples.
        if beat_s is None or beat_s > STRUCTURED_KNOT_SPACING_S:
            noise_s = windows.sigma_s * float(np.sqrt(window_s))
            return _sensor_floor(device_s, delay_s, mean_s, period_s, noise_s)
    if span_s <= MAX_LINE_SPAN_S:
        return _line_floor(device_s, delay_s, line, mean_s, period_s)
    smoothed = smooth_clock(device_s, delay_s, line, mean_s)
    if smoothed is None:
        return LatencyFloor(
            line, "line", wander_bound_s(mean_s, period_s, WALK_PER_SQRT_S), float("nan")
        )
    return _long_recording_floor(device_s, delay_s, smoothed, mean_s, period_s)


def wander_bound_s(mean_s: float, period_s: float, walk: float) -> float:
    """Return e* = (mu/f)^0.6 q^0.4, the error of an ideal envelope (docs/clocks.md)."""
    return float((mean_s * period_s) ** 0.6 * walk**0.4)


def _mean_delay_s(device_s: FloatArray, delay_s: FloatArray, line: Envelope) -> float:
    """Return the mean of an exponential with the median of the delays, per two minutes."""
    medians_s = []
    parts = max(1, int((device_s[-1] - device_s[0]) / MAX_LINE_SPAN_S))
    for a, b in pairwise(k * device_s.size // parts for k in range(parts + 1)):
        if b - a > 8:
            floor = line if b - a == device_s.size else hull_line(device_s[a:b], delay_s[a:b])
            medians_s.append(float(np.median(delay_s[a:b] - floor.delay_at(device_s[a:b]))))
    return float(np.median(medians_s)) / float(np.log(2.0)) if medians_s else 0.0


def _line_floor(
    device_s: FloatArray, delay_s: FloatArray, line: Envelope, mean_s: float, period_s: float
) -> LatencyFloor:
    """Return a line, with an uncertainty from the least delays of its windows."""
    windows = least_delays(device_s, delay_s, line, WINDOW_S, mean_s)
    residual_s = windows.least_s - line.delay_at(windows.at_s)
    # Wander of a resonator off a line (integrated random walk, fixed at both ends).
    wander_s = 1e-7 * float(device_s[-1] - device_s[0]) ** 1.5 / np.sqrt(120.0)
    limit_s = MAX_DISAGREEMENT_SIGMAS * max(windows.sigma_s, float(wander_s), MIN_STRUCTURE_S)
    spread_s = 1.4826 * float(np.median(np.abs(residual_s - np.median(residual_s))))
    structure_reason = ""
    if spread_s > limit_s and excess_autocorrelation(residual_s) > MAX_AUTOCORRELATION:
        structure_reason = (
            f"the smallest delays in windows of {WINDOW_S:g} s drift by {_format_time(spread_s)}"
        )
    # A line below n exponential delays errs by about 2.45 mu/n (simulated).
    sigma_s = max(2.45 * mean_s / device_s.size, 0.3 * windows.sigma_s)
    return LatencyFloor(
        line,
        "line",
        wander_bound_s(mean_s, period_s, WALK_PER_SQRT_S),
        max(sigma_s, spread_s) if structure_reason else sigma_s,
        structure_reason=structure_reason,
    )


def _sensor_floor(
    device_s: FloatArray, delay_s: FloatArray, mean_s: float, period_s: float, noise_s: float
) -> LatencyFloor:
    """Return an envelope that follows the temperature of the sensor.

    Args:
        device_s: device time, not decreasing, shape (n,).
        delay_s: arrival minus device time, shape (n,).
        mean_s: of the delays.
        period_s: mean step of the device time.
        noise_s: standard deviation of the least delay of one second.
    """
    spacing_s = _knot_spacing_s(mean_s, period_s, SENSOR_WALK_PER_SQRT_S)
    ideal_bound_s = wander_bound_s(mean_s, period_s, SENSOR_WALK_PER_SQRT_S)
    return LatencyFloor(
        _fit_envelope(device_s, delay_s, spacing_s, mean_s, SENSOR_WALK_PER_SQRT_S),
        "envelope",
        ideal_bound_s,
        float(np.hypot(0.6 * ideal_bound_s, noise_s / np.sqrt(spacing_s))),
    )


def _long_recording_floor(
    device_s: FloatArray,
    delay_s: FloatArray,
    smoothed: SmoothedClock,
    mean_s: float,
    period_s: float,
) -> LatencyFloor:
    """Return the envelope or the smoother, with an uncertainty from their difference."""
    walk, windows = smoothed.walk_per_sqrt_s, smoothed.windows
    ideal_bound_s = wander_bound_s(mean_s, period_s, walk)
    spacing_s = _knot_spacing_s(mean_s, period_s, walk)
    envelope = _fit_envelope(device_s, delay_s, spacing_s, mean_s, walk)
    disagreement_s = _rms_disagreement_s(envelope, smoothed)
    excess_s = float(np.median(windows.excess_s))
    noise_s = max(windows.sigma_s, excess_s)
    # If few delays are near the floor, the least delays scatter by more than mu/n.
    dense = noise_s < 3.0 * excess_s + 1e-6
    smoother_sigma_s = float(np.median(smoothed.sigma_s))
    sigma_s = float(np.hypot(smoother_sigma_s, 0.6 * ideal_bound_s if dense else 0.5 * noise_s))
    structure_reason = ""
    if disagreement_s > MAX_DISAGREEMENT_SIGMAS * sigma_s + MIN_STRUCTURE_S:
        structure_reason = (
            f"two methods for its lower bound differ by {_format_time(disagreement_s)}, "
            f"{disagreement_s / sigma_s:.0f} times the expected difference"
        )
    elif smoothed.autocorrelation > MAX_AUTOCORRELATION and noise_s > MIN_STRUCTURE_S:
        structure_reason = f"the smallest delays in windows of {WINDOW_S:g} s are autocorrelated"
    if structure_reason:
        spacing_s = min(_knot_spacing_beyond_beat_s(windows), float(device_s[-1] - device_s[0]))
        envelope = _fit_envelope(device_s, delay_s, spacing_s, mean_s, WALK_PER_SQRT_S)
    # The difference of two independent methods bounds the error of both.
    envelope_s = max(
        0.6 * ideal_bound_s, disagreement_s if structure_reason else 0.8 * disagreement_s
    )
    use_envelope = dense or bool(structure_reason)
    return LatencyFloor(
        envelope if use_envelope else smoothed.floor,
        "envelope" if use_envelope else "smoother",
        ideal_bound_s,
        envelope_s if use_envelope else max(smoother_sigma_s, 0.4 * disagreement_s),
        disagreement_s,
        structure_reason,
        walk,
    )


def _knot_spacing_s(mean_s: float, period_s: float, walk: float) -> float:
    return float(np.clip(1.5 * (mean_s * period_s / walk) ** 0.4, *KNOT_SPACING_RANGE_S))


def _fit_envelope(
    device_s: FloatArray, delay_s: FloatArray, spacing_s: float, mean_s: float, walk: float
) -> Envelope:
    stiffness = STIFFNESS_FACTOR * mean_s / (walk * np.sqrt(spacing_s))
    return piecewise_envelope(device_s, delay_s, spacing_s, stiffness)


def _format_time(value_s: float) -> str:
    return f"{value_s * 1e3:.0f} ms" if value_s >= 2e-3 else f"{value_s * 1e6:.0f} us"


def _rms_disagreement_s(envelope: Envelope, smoothed: SmoothedClock) -> float:
    at_s = smoothed.windows.at_s
    return float(np.std(envelope.delay_at(at_s) - smoothed.floor.delay_at(at_s)))


def _knot_spacing_beyond_beat_s(windows: DelayWindows) -> float:
    """Return two periods of the beat in the least delays, a minute without one."""
    beat_s = _beat_s(windows)
    if beat_s is None:
        return STRUCTURED_KNOT_SPACING_S
    return float(np.clip(2.0 * beat_s, STRUCTURED_KNOT_SPACING_S, MAX_KNOT_SPACING_S))


def _beat_s(windows: DelayWindows) -> float | None:
    """Return the period of the strongest beat in the least delays, None without one."""
    at_s, least_s = windows.at_s, windows.least_s
    # The wander of the clock is slower than any relevant beat.
    half_span = round(MAX_KNOT_SPACING_S / float(np.median(np.diff(at_s))))
    if at_s.size > 2 * half_span:
        mean = np.convolve(
            np.pad(least_s, half_span // 2, mode="edge"), np.ones(half_span) / half_span
        )
        residual = (least_s - mean[half_span - 1 :][: at_s.size])[half_span // 2 : -half_span // 2]
    else:
        residual = least_s - np.polynomial.Polynomial.fit(at_s, least_s, 3)(at_s)
    limit = 6.0 * float(np.median(np.abs(residual)))
    power = np.abs(np.fft.rfft(np.clip(residual, -limit, limit))[1:]) ** 2
    strongest = int(np.argmax(power))
    if power[strongest] < MIN_BEAT_POWER_SHARE * power.sum():
        return None
    return residual.size / (strongest + 1) * float(np.median(np.diff(at_s)))
