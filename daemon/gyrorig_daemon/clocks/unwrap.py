"""Counter ticks to a count without wraps, and the recognition of restarts.

The nearest wrap by host time is right while skew x gap stays below half a wrap (35.8
minutes for 32 bits of microseconds). A restart is not a wrap: it is known by the
counter going back further than late frames do, by a stamp from the future, or by a
sequence that does not fit the time that passed (reference: timesync.md section 5).
"""

from typing import NamedTuple

LATE_STEPS = 4  # frames may arrive in another order, but never this far back
FUTURE_S = 0.05  # a stamp cannot be ahead of its arrival; skew and stalls allowed for
SKEW_LIMIT = 1e-3  # ceramic resonators: -640 ppm (Paul Stoffregen's Time library, issue 69)
STALL_S = 10.0  # beyond this a lag is doubted if the sequence does not fit it
SEQUENCE_SLACK = 0.2  # fraction by which a step of the sequence may differ from time's


class Unwrapped(NamedTuple):
    """One stamp without wraps; `restarted` when a new count begins with it."""

    ticks: int
    restarted: bool


class Unwrapper:
    """The unwrapped count of one device's clock."""

    def __init__(self, tick_hz: float, counter_bits: int, sequence_bits: int = 16) -> None:
        self._tick_hz = tick_hz
        self._modulus = 1 << counter_bits
        self._sequence_modulus = 1 << sequence_bits
        self._second_ticks = min(tick_hz, (1 << counter_bits) / 4)  # beyond it, look closer
        self._last_ticks = 0  # unwrapped
        self._last_ns: int | None = None
        self._last_sequence: int | None = None
        self._period_ticks = 0.0

    @property
    def modulus(self) -> int:
        """The count at which the device's counter wraps, in ticks."""
        return self._modulus

    def restart(self) -> None:
        """Forget the count: the device said that it booted."""
        self._last_ns = None
        self._last_sequence = None
        self._period_ticks = 0.0

    def feed(self, raw: int, arrival_ns: int, sequence: int | None = None) -> Unwrapped:
        """Return the unwrapped stamp.

        Args:
            raw: ticks as sent.
            arrival_ns: when it arrived, on the raw monotonic clock.
            sequence: the device's sample counter as sent, where it has one.
        """
        if self._last_ns is None:
            return self._begin(raw, arrival_ns, sequence)
        step = self._sequence_step(sequence)
        if step == 1 and self._period_ticks:  # the next sample, in time: nearly always
            taken = (raw - self._last_ticks) % self._modulus
            ahead_ticks = taken - (arrival_ns - self._last_ns) * 1e-9 * self._tick_hz
            if taken and -self._second_ticks < ahead_ticks < self._second_ticks:
                return self._go_on(self._last_ticks + taken, arrival_ns, sequence, taken)
        return self._judge(raw, arrival_ns, sequence, step)

    def _judge(self, raw: int, arrival_ns: int, sequence: int | None, step: int) -> Unwrapped:
        """Unwrap a stamp that need not be the next one's."""
        if self._last_ns is None:
            raise AssertionError  # `feed` has looked
        elapsed_s = (arrival_ns - self._last_ns) * 1e-9
        expected = self._last_ticks + round(elapsed_s * self._tick_hz)
        ticks = raw + round((expected - raw) / self._modulus) * self._modulus
        if self._is_restart(ticks, expected, elapsed_s, sequence):
            return self._begin(raw, arrival_ns, sequence)
        if ticks <= self._last_ticks:
            return Unwrapped(ticks, False)
        return self._go_on(
            ticks, arrival_ns, sequence, ticks - self._last_ticks if step == 1 else 0
        )

    def _go_on(
        self, ticks: int, arrival_ns: int, sequence: int | None, period_ticks: int
    ) -> Unwrapped:
        """Take a later stamp; `period_ticks` is 0 where it is not the next one's."""
        if period_ticks:
            gain = 0.05 if self._period_ticks else 1.0
            self._period_ticks += gain * (period_ticks - self._period_ticks)
        self._last_ticks, self._last_ns, self._last_sequence = ticks, arrival_ns, sequence
        return Unwrapped(ticks, False)

    def _begin(self, raw: int, arrival_ns: int, sequence: int | None) -> Unwrapped:
        self._last_ticks, self._last_ns, self._last_sequence = raw, arrival_ns, sequence
        self._period_ticks = 0.0
        return Unwrapped(raw, True)

    def _is_restart(
        self, ticks: int, expected: int, elapsed_s: float, sequence: int | None
    ) -> bool:
        back = self._last_ticks - ticks
        # without a period yet, two samples at the slowest sensible rate (10 Hz) count as late
        late = LATE_STEPS * self._period_ticks if self._period_ticks else 0.2 * self._tick_hz
        if back > max(late, 1.0):
            return True
        ahead_s = (ticks - expected) / self._tick_hz
        # arrivals jitter both ways: the last one may have been the late one
        if ahead_s > FUTURE_S + STALL_S + SKEW_LIMIT * elapsed_s:
            return True
        if not self._period_ticks or sequence is None or back > 0:
            return False
        if abs(ahead_s) <= 1.0 + SKEW_LIMIT * elapsed_s:
            return False
        passed = (ticks - self._last_ticks) / self._period_ticks
        step = self._sequence_step(sequence)
        if passed >= self._sequence_modulus / 2:
            return False  # the sequence has aliased and says nothing
        return abs(step - passed) > 2 + SEQUENCE_SLACK * passed

    def _sequence_step(self, sequence: int | None) -> int:
        if sequence is None or self._last_sequence is None:
            return 0
        return (sequence - self._last_sequence) % self._sequence_modulus
