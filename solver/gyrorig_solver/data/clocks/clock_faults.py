"""Classification of clock faults: restarts of a device and steps of a clock.

Each suspect step between two samples is checked against the host time, the sample counter and
the sample period (docs/clocks.md has the table). A swapped pair steps back by at most a few
periods, with its counter. A stall makes the arrivals late, and the following burst removes the
lag. In a gap all three agree. A restart breaks the counter. A clock step changes the lag
permanently, and the counter continues.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gyrorig_solver.data.arrays import FloatArray, IntArray

CounterArray = NDArray[np.integer]  # a sample counter, of any width

# A step back by at most this many sample periods is a late sample, not a restart.
MAX_REORDERING = 4
MIN_STEP_S = 2e-3  # a smaller clock step cannot be separated from latency
MAX_SKEW = 1e-3  # ceramic resonators: -640 ppm (PaulStoffregen/Time, issue 69)
MAX_RATE_DRIFT = 2e-3  # relative drift of the sample rate over a gap
WINDOW_BEFORE_S, WINDOW_AFTER_S = 15.0, 10.0  # windows of the minimum latency before and after
QUEUE_DRAIN_S = 10.0  # within this time, a lag can be a queue that still drains
RECENT_START_S = 5.0  # a counter below this can have restarted
PERIOD_SAMPLES = 4096  # samples for the estimate of the sample period


class ClockFaultKind(Enum):
    """The kind of a clock fault."""

    RESTART = "restart"
    STEP = "clock step"


@dataclass(frozen=True, slots=True)
class ClockFault:
    """A restart or a clock step, which begins a new segment."""

    kind: ClockFaultKind
    index: int  # of the first sample after it


@dataclass(frozen=True, slots=True, eq=False)
class TickStream:
    """The received ticks of one device, with its constants."""

    ticks: IntArray
    host_s: FloatArray
    tick_hz: float
    modulus: int
    wrap_s: float  # infinite if the counter cannot wrap
    sequence: CounterArray | None
    sequence_modulus: int
    period_s: float
    max_disagreement_s: float  # of ticks and sample counter; above it a step is suspect

    @classmethod
    def of(
        cls,
        ticks: IntArray,
        host_s: FloatArray,
        tick_hz: float,
        counter_bits: int,
        sequence: CounterArray | None,
        sequence_bits: int | None = None,
    ) -> "TickStream":
        """Measure the sample period and its scatter."""
        modulus = 2**counter_bits if counter_bits < 63 else 0
        wrap_s = modulus / tick_hz if modulus else float("inf")
        steps, counts = [], []
        # From three places, because the first samples can be those of a starting board.
        for start in {0, ticks.size // 2, max(0, ticks.size - PERIOD_SAMPLES)}:
            rows = slice(start, start + PERIOD_SAMPLES)
            steps.append(np.diff(ticks[rows]))
            if sequence is not None:
                counts.append(np.diff(sequence[rows].astype(np.int64)))
        step_s = np.concatenate(steps) / tick_hz
        if modulus:
            step_s %= wrap_s
        count = np.concatenate(counts) if counts else np.ones(step_s.size, np.int64)
        if sequence is not None and not np.any(count):
            sequence, count = None, np.ones(step_s.size, np.int64)
        single_s = step_s[(count == 1) & (step_s > 0.0)]
        period_s = float(np.median(single_s)) if single_s.size else 0.0
        scatter_s = float(np.median(np.abs(single_s - period_s))) if single_s.size else 0.0
        if period_s <= 0.0:
            sequence = None
        if sequence_bits is None:
            sequence_bits = 32 if sequence is not None and int(sequence.max()) >= 2**16 else 16
        max_disagreement_s = max(MIN_STEP_S, 12.0 * scatter_s)
        return cls(
            ticks, host_s, tick_hz, modulus, wrap_s, sequence,
            2**sequence_bits, period_s, max_disagreement_s,
        )  # fmt: skip

    def counter_lead_s(self, counted: FloatArray, passed_s: FloatArray) -> FloatArray:
        """Return the lead of the sample counter over an elapsed time, s."""
        lead = counted - passed_s / self.period_s
        half = self.sequence_modulus / 2
        if float(lead.min()) < -half or float(lead.max()) > half:
            lead -= self.sequence_modulus * np.rint(lead / self.sequence_modulus)
        return np.asarray(lead * self.period_s, dtype=np.float64)


class FaultClassifier:
    """Classifies suspect steps in their order."""

    def __init__(self, stream: TickStream) -> None:
        """Begin with the segment of the first sample."""
        self._stream = stream
        self.segment_starts: list[int] = []  # the first samples of new segments
        self.late_samples: list[int] = []
        self.faults: list[ClockFault] = []

    def classify_step(self, index: int, wraps: int) -> None:
        """Classify the step before a sample.

        Args:
            index: the sample.
            wraps: wraps of the counter inside the step, by host time.
        """
        stream = self._stream
        host_s = float(stream.host_s[index] - stream.host_s[index - 1])
        device_s = (
            int(stream.ticks[index]) - int(stream.ticks[index - 1]) + wraps * stream.modulus
        ) / stream.tick_hz
        counter_agrees = self._counter_agrees(index, device_s)
        if device_s <= 0.0 and -device_s <= (MAX_REORDERING + 0.5) * max(stream.period_s, 0.0):
            if stream.sequence is not None and self._counter_step(index) > 0.0:
                self._classify_lag_change(index, wraps, host_s, device_s)  # the counter continued
            elif counter_agrees is not False:
                if device_s < 0.0:
                    self.late_samples.append(index)
            else:
                self._start_segment(ClockFaultKind.RESTART, index)
        elif device_s <= 0.0:
            counter_continued = self._counter_continued(index, host_s)
            self._start_segment(
                ClockFaultKind.STEP if counter_continued else ClockFaultKind.RESTART, index
            )
        elif counter_agrees is False and not self._counter_continued(index, host_s):
            self._start_segment(ClockFaultKind.RESTART, index)
        else:
            self._classify_lag_change(index, wraps, host_s, device_s)

    def _classify_lag_change(self, index: int, wraps: int, host_s: float, device_s: float) -> None:
        """Begin a segment if the minimum latency changed with the step."""
        stream = self._stream
        shift_s, scatter_s, time_before_s, time_after_s = self._floor_shift(index, wraps)
        limit_s = max(0.75 * stream.max_disagreement_s, 5.0 * scatter_s) + MAX_SKEW * host_s
        counter_disagrees = (
            stream.sequence is not None
            and abs(
                float(
                    stream.counter_lead_s(
                        np.array([self._counter_step(index)]), np.array([device_s])
                    )[0]
                )
            )
            > stream.max_disagreement_s + MAX_SKEW * device_s
        )
        if not counter_disagrees:
            # Only the arrivals are suspect; they vary by this much without a fault.
            limit_s = max(limit_s, 0.1 + MAX_SKEW * host_s)
            if shift_s > 0.0 and time_after_s < QUEUE_DRAIN_S + min(shift_s, WINDOW_BEFORE_S):
                return
            # The first samples can have waited in a queue.
            if -WINDOW_BEFORE_S < shift_s < 0.0 and time_before_s < QUEUE_DRAIN_S:
                return
        if abs(shift_s) <= limit_s:
            return
        restarted = abs(shift_s) > 0.5 and self._may_have_restarted(index)
        self._start_segment(ClockFaultKind.RESTART if restarted else ClockFaultKind.STEP, index)

    def _floor_shift(self, index: int, wraps: int) -> tuple[float, float, float, float]:
        """Return the shift of the floor, its scatter before, and the times before and after."""
        stream = self._stream
        segment_start = self.segment_starts[-1] if self.segment_starts else 0
        first = max(
            segment_start,
            int(np.searchsorted(stream.host_s, stream.host_s[index - 1] - WINDOW_BEFORE_S)),
        )
        # After a stall the queue drains at once; a lasting shift is not a stall.
        window_s = WINDOW_AFTER_S + min(
            float(stream.host_s[index] - stream.host_s[index - 1]), WINDOW_BEFORE_S
        )
        last = int(np.searchsorted(stream.host_s, stream.host_s[index] + window_s, side="right"))
        before = self._lag_s(slice(first, index), index - 1, 0)
        after = self._lag_s(slice(index, last), index - 1, wraps)
        parts = np.array_split(before, max(1, min(10, before.size // 20)))
        floors = np.array([part.min() for part in parts])
        floor_s = float(floors.min())
        scatter_s = float(np.median(floors) - floor_s)
        time_after_s = float(
            stream.host_s[min(last, stream.host_s.size) - 1] - stream.host_s[index]
        )
        time_before_s = float(stream.host_s[index - 1] - stream.host_s[first])
        return float(after.min()) - floor_s, scatter_s, time_before_s, time_after_s

    def _lag_s(self, rows: slice, origin: int, wraps: int) -> FloatArray:
        """Return arrival minus device time relative to a sample, without whole wraps."""
        stream = self._stream
        ticks_passed = stream.ticks[rows] - stream.ticks[origin] + wraps * stream.modulus
        lag_s = (stream.host_s[rows] - stream.host_s[origin]) - ticks_passed / stream.tick_hz
        if np.isfinite(stream.wrap_s):
            lag_s -= stream.wrap_s * np.rint(lag_s / stream.wrap_s)
        return np.asarray(lag_s, dtype=np.float64)

    def _counter_step(self, index: int) -> float:
        """Return the step of the sample counter, modulo its width, with the smaller size."""
        stream = self._stream
        if stream.sequence is None:
            return 0.0
        half = stream.sequence_modulus // 2
        step = int(stream.sequence[index]) - int(stream.sequence[index - 1])
        return float((step + half) % stream.sequence_modulus - half)

    def _counter_agrees(self, index: int, passed_s: float) -> bool | None:
        """Return whether the sample counter agrees with a time, None if it cannot decide."""
        stream = self._stream
        slack_s = 2.5 * stream.period_s + MAX_RATE_DRIFT * abs(passed_s)
        if stream.sequence is None or slack_s > 0.125 * stream.sequence_modulus * stream.period_s:
            return None
        lead_s = stream.counter_lead_s(np.array([self._counter_step(index)]), np.array([passed_s]))
        return bool(abs(float(lead_s[0])) <= slack_s)

    def _counter_continued(self, index: int, host_s: float) -> bool:
        """Return whether the sample counter continued, for any change of the clock.

        It did not advance more than the host time, which a stall can lengthen.
        """
        stream = self._stream
        if self._may_have_restarted(index):
            return False
        counted_s = self._counter_step(index) * stream.period_s
        return 0.0 < counted_s <= host_s + 2.5 * stream.period_s or bool(
            self._counter_agrees(index, host_s)
        )

    def _may_have_restarted(self, index: int) -> bool:
        """Return whether the clock and the counter, if any, can have restarted."""
        stream = self._stream
        sample_count = 0 if stream.sequence is None else int(stream.sequence[index])
        return (
            int(stream.ticks[index]) < RECENT_START_S * stream.tick_hz
            and sample_count * stream.period_s < RECENT_START_S
        )

    def _start_segment(self, kind: ClockFaultKind, index: int) -> None:
        self.segment_starts.append(index)
        self.faults.append(ClockFault(kind, index))
