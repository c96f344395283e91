"""Counter unwrapping: device ticks to a count without wraps, with detection of resets.

The wrap that is nearest to the host time is right while skew times gap is below half a wrap
(35.8 minutes for 32 bits of microseconds). A reset is not a wrap. It is detected when the
counter decreases by more than late frames can explain, when a timestamp is in the future, or
when the sequence number does not fit the elapsed time (docs/clocks.md).
"""

from typing import NamedTuple

LATE_STEPS = 4  # frames may arrive out of order, but not by more than this
FUTURE_S = 0.05  # a timestamp cannot be later than its arrival, except for skew and stalls
SKEW_LIMIT = 1e-3  # ceramic resonators: -640 ppm (PaulStoffregen/Time, issue 69)
STALL_S = 10.0  # a longer lag is rejected if the sequence does not fit
SEQUENCE_SLACK = 0.2  # relative difference between the steps of sequence and time


class UnwrappedCount(NamedTuple):
    """One timestamp without wraps; `restarted` if a new count starts with it."""

    ticks: int
    restarted: bool


class CounterUnwrapper:
    """Unwraps the counter of one device's clock."""

    def __init__(self, tick_hz: float, counter_bits: int, sequence_bits: int = 16) -> None:
        self._tick_hz = tick_hz
        self._modulus = 1 << counter_bits
        self._sequence_modulus = 1 << sequence_bits
        self._second_ticks = min(
            tick_hz, (1 << counter_bits) / 4
        )  # a larger difference needs the full test
        self._last_ticks = 0  # unwrapped
        self._last_ns: int | None = None
        self._last_sequence: int | None = None
        self._period_ticks = 0.0

    @property
    def modulus(self) -> int:
        """The number of ticks after which the device's counter wraps."""
        return self._modulus

    def restart(self) -> None:
        """Forget the count, because the device reported a restart."""
        self._last_ns = None
        self._last_sequence = None
        self._period_ticks = 0.0

    def feed(self, raw: int, arrival_ns: int, sequence: int | None = None) -> UnwrappedCount:
        """Return the unwrapped timestamp.

        Args:
            raw: ticks as received.
            arrival_ns: time of arrival on the raw monotonic clock.
            sequence: the device's sample counter as received, if it has one.
        """
        if self._last_ns is None:
            return self._start_count(raw, arrival_ns, sequence)
        step = self._sequence_step(sequence)
        if step == 1 and self._period_ticks:  # the next sample, in time: almost always
            step_ticks = (raw - self._last_ticks) % self._modulus
            ahead_ticks = step_ticks - (arrival_ns - self._last_ns) * 1e-9 * self._tick_hz
            if step_ticks and -self._second_ticks < ahead_ticks < self._second_ticks:
                return self._accept(self._last_ticks + step_ticks, arrival_ns, sequence, step_ticks)
        return self._unwrap_by_time(raw, arrival_ns, sequence, step)

    def _unwrap_by_time(
        self, raw: int, arrival_ns: int, sequence: int | None, step: int
    ) -> UnwrappedCount:
        """Unwrap a timestamp that is not the expected next one."""
        if self._last_ns is None:
            raise AssertionError  # `feed` has checked it
        elapsed_s = (arrival_ns - self._last_ns) * 1e-9
        expected = self._last_ticks + round(elapsed_s * self._tick_hz)
        ticks = raw + round((expected - raw) / self._modulus) * self._modulus
        if self._is_restart(ticks, expected, elapsed_s, sequence):
            return self._start_count(raw, arrival_ns, sequence)
        if ticks <= self._last_ticks:
            return UnwrappedCount(ticks, False)
        return self._accept(
            ticks, arrival_ns, sequence, ticks - self._last_ticks if step == 1 else 0
        )

    def _accept(
        self, ticks: int, arrival_ns: int, sequence: int | None, period_ticks: int
    ) -> UnwrappedCount:
        """Store a later timestamp; `period_ticks` is 0 if it is not the next one."""
        if period_ticks:
            gain = 0.05 if self._period_ticks else 1.0
            self._period_ticks += gain * (period_ticks - self._period_ticks)
        self._last_ticks, self._last_ns, self._last_sequence = ticks, arrival_ns, sequence
        return UnwrappedCount(ticks, False)

    def _start_count(self, raw: int, arrival_ns: int, sequence: int | None) -> UnwrappedCount:
        self._last_ticks, self._last_ns, self._last_sequence = raw, arrival_ns, sequence
        self._period_ticks = 0.0
        return UnwrappedCount(raw, True)

    def _is_restart(
        self, ticks: int, expected: int, elapsed_s: float, sequence: int | None
    ) -> bool:
        back_ticks = self._last_ticks - ticks
        # without a period, allow two samples at the slowest sensible rate (10 Hz)
        allowed_back_ticks = (
            LATE_STEPS * self._period_ticks if self._period_ticks else 0.2 * self._tick_hz
        )
        if back_ticks > max(allowed_back_ticks, 1.0):
            return True
        ahead_s = (ticks - expected) / self._tick_hz
        # arrivals jitter: the previous one may have been late
        if ahead_s > FUTURE_S + STALL_S + SKEW_LIMIT * elapsed_s:
            return True
        if not self._period_ticks or sequence is None or back_ticks > 0:
            return False
        if abs(ahead_s) <= 1.0 + SKEW_LIMIT * elapsed_s:
            return False
        elapsed_periods = (ticks - self._last_ticks) / self._period_ticks
        step = self._sequence_step(sequence)
        if elapsed_periods >= self._sequence_modulus / 2:
            return False  # the sequence is ambiguous
        return abs(step - elapsed_periods) > 2 + SEQUENCE_SLACK * elapsed_periods

    def _sequence_step(self, sequence: int | None) -> int:
        if sequence is None or self._last_sequence is None:
            return 0
        return (sequence - self._last_sequence) % self._sequence_modulus
