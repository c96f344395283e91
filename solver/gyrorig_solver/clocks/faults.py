"""Tell a device's restarts and clock steps from what only looks like them.

Three witnesses are heard on each odd step between two samples: host time, the sample
counter and the sample period (time synchronisation notes, section 5). A swapped pair
steps back by at most a few periods, with its counter; a stall makes the arrivals late
and the burst after it brings the lag down again; a gap leaves all three in agreement;
a restart breaks the counter; a clock step shifts the lag for good while the counter
runs on.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gyrorig_solver.arrays import FloatArray, IntArray

CounterArray = NDArray[np.integer]  # a sample counter, of any width

# A tick that steps back by at most this many sample periods is a late sample, not a restart.
LATE_SAMPLES = 4
LEAST_JUMP_S = 2e-3  # a shorter step of the clock is not told from latency
SKEW_LIMIT = 1e-3  # ceramic resonators: -640 ppm (Paul Stoffregen's Time library, issue 69)
SEQUENCE_SLACK = 2e-3  # how far the sample rate may drift over a gap
BEFORE_S, AFTER_S = 15.0, 10.0  # where the floors before and after are sought
DRAIN_S = 10.0  # so long, a lag may be a queue not yet drained
YOUNG_S = 5.0  # a counter below this may have begun just now
FEW_PERIODS = 4096  # enough to know the sample period


class FaultKind(Enum):
    """What begins a new segment."""

    RESTART = "restart"
    STEP = "clock step"


@dataclass(frozen=True, slots=True)
class ClockFault:
    """A new segment begins at a sample."""

    kind: FaultKind
    index: int  # of the first sample after it
    shift_s: float  # of the lag (arrival minus device time), NaN where it was not measured


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """What arrived of one device, with what is constant about it."""

    ticks: IntArray
    host_s: FloatArray
    tick_hz: float
    modulus: int
    wrap_s: float  # infinite where the counter is too wide to wrap
    sequence: CounterArray | None
    sequence_modulus: int
    period_s: float
    jump_s: float  # ticks against the sample counter: what more than this is odd

    @classmethod
    def of(
        cls,
        ticks: IntArray,
        host_s: FloatArray,
        tick_hz: float,
        counter_bits: int,
        sequence: CounterArray | None,
    ) -> "Stream":
        """Measure the sample period and its scatter."""
        modulus = 2**counter_bits if counter_bits < 63 else 0
        wrap_s = modulus / tick_hz if modulus else float("inf")
        steps, counts = [], []
        # From three places: the first samples may be those of a board that just starts.
        for start in {0, ticks.size // 2, max(0, ticks.size - FEW_PERIODS)}:
            rows = slice(start, start + FEW_PERIODS)
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
        wide = sequence is not None and int(sequence.max()) >= 2**16
        jump_s = max(LEAST_JUMP_S, 12.0 * scatter_s)
        return cls(
            ticks, host_s, tick_hz, modulus, wrap_s, sequence,
            2**32 if wide else 2**16, period_s, jump_s,
        )  # fmt: skip

    def off_s(self, counted: FloatArray, passed_s: FloatArray) -> FloatArray:
        """Return how far the sample counter is ahead of a time that passed, s."""
        off = counted - passed_s / self.period_s
        half = self.sequence_modulus / 2
        if float(off.min()) < -half or float(off.max()) > half:
            off -= self.sequence_modulus * np.rint(off / self.sequence_modulus)
        return np.asarray(off * self.period_s, dtype=np.float64)


class Judge:
    """Considers odd steps in their order, and remembers what they were."""

    def __init__(self, stream: Stream) -> None:
        """Begin with the first sample's segment."""
        self._stream = stream
        self.begins: list[int] = []  # first samples of new segments
        self.late: list[int] = []
        self.faults: list[ClockFault] = []

    def consider(self, at: int, wraps: int) -> None:
        """Judge the step that leads to a sample.

        Args:
            at: the sample.
            wraps: of the counter inside the step, by host time.
        """
        s = self._stream
        host_s = float(s.host_s[at] - s.host_s[at - 1])
        device_s = (int(s.ticks[at]) - int(s.ticks[at - 1]) + wraps * s.modulus) / s.tick_hz
        follows = self._follows(at, device_s)
        if device_s <= 0.0 and -device_s <= (LATE_SAMPLES + 0.5) * max(s.period_s, 0.0):
            if s.sequence is not None and self._counted(at) > 0.0:
                self._judge_lag(at, wraps, host_s, device_s)  # the counter ran on
            elif follows is not False:
                if device_s < 0.0:
                    self.late.append(at)
            else:
                self._new(FaultKind.RESTART, at)
        elif device_s <= 0.0:
            runs_on = self._ran_on(at, host_s)
            self._new(FaultKind.STEP if runs_on else FaultKind.RESTART, at)
        elif follows is False and not self._ran_on(at, host_s):
            self._new(FaultKind.RESTART, at)
        else:
            self._judge_lag(at, wraps, host_s, device_s)

    def _judge_lag(self, at: int, wraps: int, host_s: float, device_s: float) -> None:
        """Begin a segment if the floor after the step is not the floor before it."""
        s = self._stream
        shift_s, scatter_s, known_s, seen_s = self._floors(at, wraps)
        limit_s = max(0.75 * s.jump_s, 5.0 * scatter_s) + SKEW_LIMIT * host_s
        jumped = (
            s.sequence is not None
            and abs(float(s.off_s(np.array([self._counted(at)]), np.array([device_s]))[0]))
            > s.jump_s + SKEW_LIMIT * device_s
        )
        if not jumped:
            # Only the arrivals are odd; so much they may be by themselves.
            limit_s = max(limit_s, 0.1 + SKEW_LIMIT * host_s)
            if shift_s > 0.0 and seen_s < DRAIN_S + min(shift_s, BEFORE_S):
                return
            # What came first may have waited in a queue, and shown no floor yet.
            if -BEFORE_S < shift_s < 0.0 and known_s < DRAIN_S:
                return
        if abs(shift_s) <= limit_s:
            return
        anew = abs(shift_s) > 0.5 and self._young(at)
        self._new(FaultKind.RESTART if anew else FaultKind.STEP, at, shift_s)

    def _floors(self, at: int, wraps: int) -> tuple[float, float, float, float]:
        """Return the floor's shift over a step, its scatter before, the times before and after."""
        s = self._stream
        begin = self.begins[-1] if self.begins else 0
        first = max(begin, int(np.searchsorted(s.host_s, s.host_s[at - 1] - BEFORE_S)))
        # After a stall the queue drains at once; what stays is no stall.
        wait_s = AFTER_S + min(float(s.host_s[at] - s.host_s[at - 1]), BEFORE_S)
        last = int(np.searchsorted(s.host_s, s.host_s[at] + wait_s, side="right"))
        before = self._lag_s(slice(first, at), at - 1, 0)
        after = self._lag_s(slice(at, last), at - 1, wraps)
        parts = np.array_split(before, max(1, min(10, before.size // 20)))
        floors = np.array([part.min() for part in parts])
        floor_s = float(floors.min())
        scatter_s = float(np.median(floors) - floor_s)
        seen_s = float(s.host_s[min(last, s.host_s.size) - 1] - s.host_s[at])
        known_s = float(s.host_s[at - 1] - s.host_s[first])
        return float(after.min()) - floor_s, scatter_s, known_s, seen_s

    def _lag_s(self, rows: slice, origin: int, wraps: int) -> FloatArray:
        """Return arrival minus device time against a sample, whole wraps taken out."""
        s = self._stream
        passed = s.ticks[rows] - s.ticks[origin] + wraps * s.modulus
        lag_s = (s.host_s[rows] - s.host_s[origin]) - passed / s.tick_hz
        if np.isfinite(s.wrap_s):
            lag_s -= s.wrap_s * np.rint(lag_s / s.wrap_s)
        return np.asarray(lag_s, dtype=np.float64)

    def _counted(self, at: int) -> float:
        """Return the sample counter's step, by the shorter way round."""
        s = self._stream
        if s.sequence is None:
            return 0.0
        half = s.sequence_modulus // 2
        step = int(s.sequence[at]) - int(s.sequence[at - 1])
        return float((step + half) % s.sequence_modulus - half)

    def _follows(self, at: int, passed_s: float) -> bool | None:
        """Return whether the sample counter agrees with a time, None where it cannot say."""
        s = self._stream
        slack_s = 2.5 * s.period_s + SEQUENCE_SLACK * abs(passed_s)
        if s.sequence is None or slack_s > 0.125 * s.sequence_modulus * s.period_s:
            return None
        off_s = s.off_s(np.array([self._counted(at)]), np.array([passed_s]))
        return bool(abs(float(off_s[0])) <= slack_s)

    def _ran_on(self, at: int, host_s: float) -> bool:
        """Return whether the sample counter went on, whatever its clock did.

        It went no further than the host's time, which a stall may have stretched.
        """
        s = self._stream
        if self._young(at):
            return False
        passed_s = self._counted(at) * s.period_s
        return 0.0 < passed_s <= host_s + 2.5 * s.period_s or bool(self._follows(at, host_s))

    def _young(self, at: int) -> bool:
        """Return whether clock and counter, as far as there is one, may have just begun."""
        s = self._stream
        counted = 0 if s.sequence is None else int(s.sequence[at])
        return int(s.ticks[at]) < YOUNG_S * s.tick_hz and counted * s.period_s < YOUNG_S

    def _new(self, kind: FaultKind, at: int, shift_s: float = float("nan")) -> None:
        self.begins.append(at)
        self.faults.append(ClockFault(kind, at, shift_s))
