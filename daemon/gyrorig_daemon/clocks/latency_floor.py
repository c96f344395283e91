"""Kalman filter of clock offset and skew, from the minimum latency of each second.

Host stalls make every method that averages wander by 50 to 700 us in 75 s, and every
lower-envelope method by 0.2 to 3 us (simulated; docs/clocks.md). Therefore the smallest
detrended latency of each second is the measurement of a filter with two states, offset and
skew. The innovation gate is one-sided. A late window is dropped, because latency can increase
for a while. An early window is an alarm, because the minimum latency cannot decrease.
"""

import math
from dataclasses import dataclass

WINDOW_S = 1.0
WINDOW_SAMPLES = 8  # fewer samples give no estimate of the excess over the minimum
OFFSET_SIGMA_S = 0.02  # prior of the first window
SKEW_SIGMA = 1e-3  # prior: ceramic resonators reach 640 ppm
SKEW_WALK = 1e-8  # random walk of the skew of a crystal per sqrt(s); 1e-7 for a ceramic resonator
FIRST_SKEW_SIGMA = 20e-6  # of a skew from one window, in addition to its scatter
MAX_FIRST_SAMPLES = 4096  # samples kept of the first window, in case the clock stands still
GATE_SIGMAS = 5.0
MIN_SIGMA_S = 1e-6  # smallest standard deviation of a window
LATE_WINDOWS_LIMIT = 30  # then the minimum latency has changed permanently
EARLY_STEP_S = 0.005  # earlier than this: a clock step, not a better minimum
EARLY_ALARM_S = 1e-4  # smaller values are normal on a bus with 125 us microframes
SCATTER_GAIN = 0.1
SCATTER_CLIP = 9.0  # three sigma squared: one stall must not widen the gate
SCATTER_SHARE = 0.5  # part of the unexplained innovation variance that is measurement noise
WARM_UP_WINDOWS = 5  # the first minima are too late: processes and caches warm up


@dataclass(frozen=True, slots=True)
class LatencyFloorState:
    """State of the filter at one device time."""

    device_s: float
    offset_s: float  # minimum arrival minus device time, at device_s
    skew: float  # rate of the host's clock relative to the device's, minus one
    offset_sigma_s: float
    skew_sigma: float
    windows: int
    late_windows: int
    early_windows: int
    steps: int


class LatencyFloorFilter:
    """Filters the minimum latency of one clock, in the order of arrival.

    Device times must be relative to a nearby origin, so that double precision resolves far
    below a microsecond.
    """

    def __init__(self) -> None:
        """Start without offset and skew."""
        self._late_total = 0
        self._early_total = 0
        self._steps = 0
        self._window_end_s: float | None = None
        self._min_detrended_s = math.inf
        self.revision = 0  # changes whenever offset or skew may have changed
        self._reset()

    def restart(self) -> None:
        """Forget offset and skew; the fault counters stay."""
        self.revision += 1
        self._reset()

    @property
    def has_state(self) -> bool:
        """True after the first window."""
        return self._windows > 0

    def observe(self, device_s: float, latency_s: float) -> None:
        """Add one pair: device time, and arrival minus device time."""
        if self._window_end_s is None:
            self._window_end_s = device_s + WINDOW_S
        elif device_s >= self._window_end_s and self._count >= WINDOW_SAMPLES:
            self._close_window()
            self._window_end_s = device_s + WINDOW_S
        if not self._windows and len(self._first_samples) < MAX_FIRST_SAMPLES:
            self._first_samples.append((device_s, latency_s))
        self._add_to_window(device_s, latency_s)

    def latency_floor_s(self, device_s: float) -> float:
        """Return the minimum of arrival minus device time, at `device_s`."""
        return self._offset_s + self._skew * (device_s - self._at_s)

    def state(self) -> LatencyFloorState:
        """Return the state after the last window."""
        return LatencyFloorState(
            device_s=self._at_s,
            offset_s=self._offset_s,
            skew=self._skew,
            offset_sigma_s=math.sqrt(self._p_oo),
            skew_sigma=math.sqrt(self._p_ss),
            windows=self._windows,
            late_windows=self._late_total,
            early_windows=self._early_total,
            steps=self._steps,
        )

    def _reset(self) -> None:
        self._at_s = 0.0
        self._offset_s = 0.0
        self._skew = 0.0
        self._p_oo = OFFSET_SIGMA_S**2
        self._p_os = 0.0
        self._p_ss = SKEW_SIGMA**2
        self._scatter = 0.0
        self._first_samples: list[tuple[float, float]] = []
        self._windows = 0
        self._consecutive_late = 0
        self._window_end_s = None
        self._clear_window()

    def _clear_window(self) -> None:
        self._count = 0
        self._sum_detrended_s = 0.0
        self._min_detrended_s = math.inf
        self._min_device_s = 0.0
        self._min_latency_s = 0.0

    def _close_window(self) -> None:
        self.revision += 1
        if not self._windows:
            self._guess_skew()
        count, mean_over = self._count, self._sum_detrended_s / self._count - self._min_detrended_s
        at_s, latency_s = self._min_device_s, self._min_latency_s
        self._clear_window()
        # The minimum of n exponential latencies of mean mu exceeds the floor by mu/n, with the
        # same standard deviation. The sample mean exceeds the minimum by mu (1 - 1/n).
        excess_s = mean_over / max(count - 1, 1)
        measured_s = latency_s - excess_s
        # deviations from the exponential (tails, beats) appear in the scatter of the windows
        variance = excess_s**2 + MIN_SIGMA_S**2 + SCATTER_SHARE * self._scatter
        if not self._windows:
            self._at_s, self._offset_s, self._windows = at_s, measured_s, 1
            self._p_oo = variance
            return
        self._predict(at_s)
        innovation = measured_s - self._offset_s
        total = self._p_oo + variance
        sigma = math.sqrt(total)
        if self._windows > 1:
            excess_variance = min(innovation**2, SCATTER_CLIP * total) - self._p_oo
            self._scatter += SCATTER_GAIN * (max(excess_variance, 0.0) - self._scatter)
        if innovation > GATE_SIGMAS * sigma and self._consecutive_late < LATE_WINDOWS_LIMIT:
            self._consecutive_late += 1
            self._late_total += 1
            return
        if self._consecutive_late >= LATE_WINDOWS_LIMIT:
            self._apply_step(measured_s, variance)
        elif innovation < -GATE_SIGMAS * sigma:
            if innovation < -EARLY_ALARM_S and self._windows >= WARM_UP_WINDOWS:
                self._early_total += 1
            if innovation < -EARLY_STEP_S and self._windows >= WARM_UP_WINDOWS:
                self._apply_step(measured_s, variance)
            else:
                self._p_oo += innovation**2  # the earlier minimum was too late: use the new one
        self._consecutive_late = 0
        self._update(measured_s - self._offset_s, variance)

    def _guess_skew(self) -> None:
        """Detrend the first window with the minima of its two halves.

        Otherwise its minimum latency is at one end, up to 640 us wrong.
        """
        middle = len(self._first_samples) // 2
        early = min(self._first_samples[:middle], key=lambda pair: pair[1])
        late = min(self._first_samples[middle:], key=lambda pair: pair[1])
        separation_s = late[0] - early[0]
        skew = (late[1] - early[1]) / separation_s if separation_s > 0.0 else math.inf
        samples, self._first_samples = self._first_samples, []
        if abs(skew) > SKEW_SIGMA:
            return  # a stall hides the minimum of one half: leave it to the filter
        self._skew = skew
        self._clear_window()
        for device_s, latency_s in samples:
            self._add_to_window(device_s, latency_s)
        half_excess_s = self._sum_detrended_s / self._count - self._min_detrended_s
        self._p_ss = (FIRST_SKEW_SIGMA + 4.0 * half_excess_s / middle / separation_s) ** 2

    def _add_to_window(self, device_s: float, latency_s: float) -> None:
        detrended_s = latency_s - self._skew * (device_s - self._at_s)
        self._sum_detrended_s += detrended_s
        self._count += 1
        if detrended_s < self._min_detrended_s:
            self._min_detrended_s, self._min_device_s, self._min_latency_s = (
                detrended_s,
                device_s,
                latency_s,
            )

    def _apply_step(self, measured_s: float, variance: float) -> None:
        self._steps += 1
        self._offset_s = measured_s
        self._p_oo, self._p_os = variance, 0.0

    def _predict(self, at_s: float) -> None:
        dt_s = at_s - self._at_s
        self._at_s = at_s
        self._offset_s += self._skew * dt_s
        q = SKEW_WALK**2
        self._p_oo += 2 * dt_s * self._p_os + dt_s**2 * self._p_ss + q * dt_s**3 / 3
        self._p_os += dt_s * self._p_ss + q * dt_s**2 / 2
        self._p_ss += q * dt_s

    def _update(self, innovation: float, variance: float) -> None:
        total = self._p_oo + variance
        gain_o, gain_s = self._p_oo / total, self._p_os / total
        self._offset_s += gain_o * innovation
        self._skew += gain_s * innovation
        self._p_ss -= gain_s * self._p_os
        self._p_oo *= 1 - gain_o
        self._p_os *= 1 - gain_o
        self._windows += 1
