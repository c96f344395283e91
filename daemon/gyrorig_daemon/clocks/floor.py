"""Offset and skew of one clock from the floor of its latencies.

With stalls, every mean-based method wanders by 50 to 700 us in 75 s, every
lower-envelope method by 0.2 to 3 us (reference: timesync.md section 3.1). So the least
detrended latency of each second is the measurement, and a filter of two states
(offset, skew) carries it on. Its gate has one side: a late window is dropped, because
a latency may rise for a while; an early one is an alarm, because a floor cannot fall.
"""

import math
from dataclasses import dataclass

WINDOW_S = 1.0
WINDOW_SAMPLES = 8  # with fewer, a window's spread says nothing of its floor
OFFSET_SIGMA_S = 0.02  # prior of the first window
SKEW_SIGMA = 1e-3  # prior: ceramic resonators reach 640 ppm
FIRST_SKEW_SIGMA = 20e-6  # of a skew guessed from one window, beside its scatter
FIRST_LIMIT = 4096  # samples kept of the first window, whose clock may stand still
GATE_SIGMAS = 5.0
STAMP_FLOOR_S = 1e-6  # no window is trusted below one microsecond
LATE_WINDOWS_LIMIT = 30  # then the path has changed for good and the floor with it
EARLY_STEP_S = 0.005  # early by more is a step of a clock, not a better minimum
EARLY_ALARM_S = 1e-4  # early by less is no news on a bus of 125 us microframes
SCATTER_GAIN = 0.1
SCATTER_CLIP = 9.0  # three sigmas squared: one stall must not blunt the gate
SCATTER_SHARE = 0.5  # of the innovations' unexplained variance, counted to the measurement
SETTLING_WINDOWS = 5  # the first floors are none yet: processes and caches warm up


@dataclass(frozen=True, slots=True)
class FloorState:
    """The filter's state at one device time."""

    device_s: float
    offset_s: float  # arrival floor minus device time, at device_s
    skew: float  # rate of the host's clock against the device's, minus one
    offset_sigma_s: float
    skew_sigma: float
    windows: int
    late_windows: int
    early_windows: int
    steps: int


class FloorFilter:
    """Arrival floors of one clock, in the order of arrival.

    Device times must be counted from a near zero of the caller's choice, so that
    double precision resolves far below a microsecond.
    """

    def __init__(self, skew_walk: float = 1e-8) -> None:
        """Begin without a state.

        Args:
            skew_walk: random walk of the skew per sqrt(s): 1e-8 for a crystal, 1e-7 for
                a resonator (timesync.md section 10).
        """
        self._skew_walk = skew_walk
        self._late_total = 0
        self._early_total = 0
        self._steps = 0
        self._window_end_s: float | None = None
        self._least_rest = math.inf
        self.revision = 0  # changes whenever offset or skew may have
        self._begin()

    def restart(self) -> None:
        """Forget offset and skew; the counts of faults stay."""
        self.revision += 1
        self._begin()

    @property
    def has_state(self) -> bool:
        """True once the first window has closed."""
        return self._windows > 0

    def observe(self, device_s: float, latency_s: float) -> None:
        """Take one pair: device time, and arrival minus device time."""
        if self._window_end_s is None:
            self._window_end_s = device_s + WINDOW_S
        elif device_s >= self._window_end_s and self._count >= WINDOW_SAMPLES:
            self._close_window()
            self._window_end_s = device_s + WINDOW_S
        if not self._windows and len(self._first) < FIRST_LIMIT:
            self._first.append((device_s, latency_s))
        self._take(device_s, latency_s)

    def latency_floor_s(self, device_s: float) -> float:
        """Return arrival floor minus device time, at `device_s`."""
        return self._offset + self._skew * (device_s - self._at_s)

    def state(self) -> FloorState:
        """Return the state as of the last window."""
        return FloorState(
            device_s=self._at_s,
            offset_s=self._offset,
            skew=self._skew,
            offset_sigma_s=math.sqrt(self._p_oo),
            skew_sigma=math.sqrt(self._p_ss),
            windows=self._windows,
            late_windows=self._late_total,
            early_windows=self._early_total,
            steps=self._steps,
        )

    def _begin(self) -> None:
        self._at_s = 0.0
        self._offset = 0.0
        self._skew = 0.0
        self._p_oo = OFFSET_SIGMA_S**2
        self._p_os = 0.0
        self._p_ss = SKEW_SIGMA**2
        self._scatter = 0.0
        self._first: list[tuple[float, float]] = []
        self._windows = 0
        self._late_in_a_row = 0
        self._window_end_s = None
        self._clear_window()

    def _clear_window(self) -> None:
        self._count = 0
        self._sum_rest = 0.0
        self._least_rest = math.inf
        self._least_s = 0.0
        self._least_latency = 0.0

    def _close_window(self) -> None:
        self.revision += 1
        if not self._windows:
            self._guess_skew()
        count, mean_over = self._count, self._sum_rest / self._count - self._least_rest
        at_s, latency_s = self._least_s, self._least_latency
        self._clear_window()
        # the least of n exponential latencies of mean mu exceeds the floor by mu/n, with
        # the same standard deviation; the sample mean over the minimum is mu (1 - 1/n)
        excess_s = mean_over / max(count - 1, 1)
        measured_s = latency_s - excess_s
        # what no exponential explains shows in the windows' own scatter: tails, beats
        variance = excess_s**2 + STAMP_FLOOR_S**2 + SCATTER_SHARE * self._scatter
        if not self._windows:
            self._at_s, self._offset, self._windows = at_s, measured_s, 1
            self._p_oo = variance
            return
        self._predict(at_s)
        innovation = measured_s - self._offset
        total = self._p_oo + variance
        sigma = math.sqrt(total)
        if self._windows > 1:
            seen = min(innovation**2, SCATTER_CLIP * total) - self._p_oo
            self._scatter += SCATTER_GAIN * (max(seen, 0.0) - self._scatter)
        if innovation > GATE_SIGMAS * sigma and self._late_in_a_row < LATE_WINDOWS_LIMIT:
            self._late_in_a_row += 1
            self._late_total += 1
            return
        if self._late_in_a_row >= LATE_WINDOWS_LIMIT:
            self._step(measured_s, variance)
        elif innovation < -GATE_SIGMAS * sigma:
            if innovation < -EARLY_ALARM_S and self._windows >= SETTLING_WINDOWS:
                self._early_total += 1
            if innovation < -EARLY_STEP_S and self._windows >= SETTLING_WINDOWS:
                self._step(measured_s, variance)
            else:
                self._p_oo += innovation**2  # the earlier floor was none: believe the new one
        self._late_in_a_row = 0
        self._update(measured_s - self._offset, variance)

    def _guess_skew(self) -> None:
        """Detrend the first window by the floors of its two halves.

        Without that its least latency stands at its end, up to 640 us off.
        """
        middle = len(self._first) // 2
        early = min(self._first[:middle], key=lambda pair: pair[1])
        late = min(self._first[middle:], key=lambda pair: pair[1])
        apart_s = late[0] - early[0]
        skew = (late[1] - early[1]) / apart_s if apart_s > 0.0 else math.inf
        rows, self._first = self._first, []
        if abs(skew) > SKEW_SIGMA:
            return  # a stall hides the floor of one half: leave it to the filter
        self._skew = skew
        self._clear_window()
        for device_s, latency_s in rows:
            self._take(device_s, latency_s)
        half_excess_s = self._sum_rest / self._count - self._least_rest
        self._p_ss = (FIRST_SKEW_SIGMA + 4.0 * half_excess_s / middle / apart_s) ** 2

    def _take(self, device_s: float, latency_s: float) -> None:
        rest = latency_s - self._skew * (device_s - self._at_s)
        self._sum_rest += rest
        self._count += 1
        if rest < self._least_rest:
            self._least_rest, self._least_s, self._least_latency = rest, device_s, latency_s

    def _step(self, measured_s: float, variance: float) -> None:
        self._steps += 1
        self._offset = measured_s
        self._p_oo, self._p_os = variance, 0.0

    def _predict(self, at_s: float) -> None:
        dt_s = at_s - self._at_s
        self._at_s = at_s
        self._offset += self._skew * dt_s
        q = self._skew_walk**2
        self._p_oo += 2 * dt_s * self._p_os + dt_s**2 * self._p_ss + q * dt_s**3 / 3
        self._p_os += dt_s * self._p_ss + q * dt_s**2 / 2
        self._p_ss += q * dt_s

    def _update(self, innovation: float, variance: float) -> None:
        total = self._p_oo + variance
        gain_o, gain_s = self._p_oo / total, self._p_os / total
        self._offset += gain_o * innovation
        self._skew += gain_s * innovation
        self._p_ss -= gain_s * self._p_os
        self._p_oo *= 1 - gain_o
        self._p_os *= 1 - gain_o
        self._windows += 1
