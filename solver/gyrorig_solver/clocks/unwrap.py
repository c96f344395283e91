"""Make a wrapping tick counter continuous, in segments between restarts and clock steps.

A wrap is counted by host time, not by "the stamp went backwards": one swapped sample
read as a wrap is an error of 71.6 min (time synchronisation notes, section 5). Between
two samples the number of wraps is the nearest integer to
(host interval - device interval) / period, safe while skew x gap is below half a period.

A first pass over all samples, in pieces of bounded size, only asks which steps are not
plainly in order; `faults` then judges those few one by one.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.clocks.faults import ClockFault, CounterArray, FaultKind, Judge, Stream

PIECE = 1 << 16  # samples looked at together: they stay in the processor's cache
# A step in which host and device agree to this needs no second look.
PLAIN_S = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Unwrapped:
    """Continuous device time, in segments between restarts and steps of the clock."""

    device_s: FloatArray  # (n,), seconds since the segment's first sample, nominal tick rate
    segment: IntArray  # (n,), counts segments from 0
    late: BoolArray  # (n,), True where a sample came after a younger one
    wraps: int
    faults: tuple[ClockFault, ...] = ()

    def count(self, kind: FaultKind) -> int:
        """Return how many faults of a kind there are."""
        return sum(fault.kind is kind for fault in self.faults)

    @property
    def restarts(self) -> int:
        """How often the device began anew inside the recording."""
        return self.count(FaultKind.RESTART)

    @property
    def steps(self) -> int:
        """How often a clock jumped although the device ran on."""
        return self.count(FaultKind.STEP)


def unwrap_ticks(
    ticks: IntArray,
    host_s: FloatArray,
    tick_hz: float,
    counter_bits: int,
    sequence: CounterArray | None = None,
    *,
    overwrite: bool = False,
) -> Unwrapped:
    """Return continuous device time.

    Args:
        ticks: raw counter values as sent, shape (n,), in the order of arrival.
        host_s: arrival times on the capture clock, shape (n,), not decreasing.
        tick_hz: nominal ticks per second.
        counter_bits: width of the counter.
        sequence: the sample counter as sent, shape (n,), where there is one: 16 bits
            wide where no value exceeds 65535, else 32.
        overwrite: the memory of `ticks` may be taken for the result.
    """
    if ticks.size == 0:
        return Unwrapped(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.bool_), 0)
    stream = Stream.of(ticks.astype(np.int64, copy=False), host_s, tick_hz, counter_bits, sequence)
    wraps, suspects = _first_pass(stream)
    judge = Judge(stream)
    for at in suspects.tolist():
        judge.consider(at, int(wraps.get(at, 0)))
    device_s, segment, counted = _assemble(stream, wraps, judge.begins, overwrite)
    faults = list(judge.faults)
    for at in _falls(device_s, segment, host_s):
        segment[at:] += 1
        end = int(np.searchsorted(segment, segment[at], side="right"))
        device_s[at:end] -= device_s[at]
        faults.append(ClockFault(FaultKind.STEP, at, float("nan")))
    late = np.zeros(ticks.size, dtype=np.bool_)
    late[judge.late] = True
    faults.sort(key=lambda fault: fault.index)
    return Unwrapped(device_s, segment, late, counted, tuple(faults))


def _first_pass(stream: Stream) -> tuple[dict[int, int], IntArray]:
    """Return the wraps by the sample that follows them, and the steps not plainly in order."""
    wraps: dict[int, int] = {}
    suspects: list[IntArray] = []
    for start in range(0, stream.ticks.size - 1, PIECE):
        rows = slice(start, min(start + PIECE + 1, stream.ticks.size))
        host_s = np.diff(stream.host_s[rows])
        device_s = np.diff(stream.ticks[rows]) / stream.tick_hz
        ahead_s = device_s - host_s
        half_s = stream.wrap_s / 2.0
        if float(ahead_s.min()) < -half_s or float(ahead_s.max()) > half_s:
            turns = np.rint(ahead_s / -stream.wrap_s)
            for at in np.flatnonzero(turns).tolist():
                wraps[start + at + 1] = int(turns[at])
            device_s += turns * stream.wrap_s
            ahead_s = device_s - host_s
        np.abs(ahead_s, out=ahead_s)
        odd = (device_s <= 0.0) | (ahead_s > PLAIN_S)
        if stream.sequence is not None:
            counted = np.diff(stream.sequence[rows].astype(np.int64)).astype(np.float64)
            off_s = stream.off_s(counted, device_s)
            odd |= np.abs(off_s) > stream.jump_s + 1e-3 * device_s
        suspects.append(np.flatnonzero(odd).astype(np.int64) + start + 1)
    found = np.concatenate(suspects) if suspects else np.zeros(0, np.int64)
    return wraps, np.union1d(found, np.array(sorted(wraps), dtype=np.int64)).astype(np.int64)


def _assemble(
    stream: Stream, wraps: dict[int, int], begins: list[int], overwrite: bool
) -> tuple[FloatArray, IntArray, int]:
    """Return device time, segment numbers and the wraps inside segments."""
    n = stream.ticks.size
    device_s = stream.ticks.view(np.float64) if overwrite else np.empty(n, dtype=np.float64)
    segment = np.zeros(n, dtype=np.int64)  # takes memory only where it is written to
    starts = set(begins)
    cuts = [0, *sorted(starts | set(wraps)), n]
    zero, turned, counted, number = int(stream.ticks[0]), 0, 0, 0
    for a, b in pairwise(cuts):
        if a in starts:
            zero, turned, number = int(stream.ticks[a]), 0, number + 1
        elif a in wraps:
            turned += wraps[a]
            counted += wraps[a]
        shift = turned * stream.modulus - zero
        for start in range(a, b, PIECE):
            rows = slice(start, min(start + PIECE, b))
            # Each piece is worked out elsewhere before it may overwrite its ticks.
            device_s[rows] = (stream.ticks[rows] + shift) / stream.tick_hz
        if number:
            segment[a:b] = number
    return device_s, segment, counted


# A latency floor cannot fall (notes, section 5); the floors of USB frames and of FTDI's
# latency timer seem to, by 1 and by 16 ms, when their beat with the stream turns over.
_FALL_S = 0.02
_FLOOR_WINDOWS = 15
_WINDOW_S = 1.0


def _falls(device_s: FloatArray, segment: IntArray, host_s: FloatArray) -> list[int]:
    """Return where a floor fell: the host's clock stepped back under a device that ran on."""
    out: list[int] = []
    edges = np.searchsorted(segment, np.arange(int(segment[-1]) + 2))
    for a, b in pairwise(edges.tolist()):
        rows = a + np.searchsorted(
            host_s[a:b], np.arange(host_s[a], host_s[b - 1] + _WINDOW_S, _WINDOW_S)
        )
        rows = np.unique(rows[rows < b])
        if rows.size <= _FLOOR_WINDOWS:
            continue
        lag_s = np.concatenate(
            [
                np.minimum.reduceat(host_s[i:j] - device_s[i:j], rows[k : k + 512] - i)
                for k in range(0, rows.size, 512)
                for i, j in [(int(rows[k]), int(rows[k + 512]) if k + 512 < rows.size else b)]
            ]
        )
        past = np.lib.stride_tricks.sliding_window_view(lag_s, _FLOOR_WINDOWS)[:-1]
        floor_s = past.min(axis=1)
        scatter_s = np.median(past, axis=1) - floor_s
        apart_s = np.diff(host_s[rows])[_FLOOR_WINDOWS - 1 :]
        limit_s = np.maximum(_FALL_S, 5.0 * scatter_s) + 2e-3 * apart_s
        fell = lag_s[_FLOOR_WINDOWS:] < floor_s - limit_s
        last = -_FLOOR_WINDOWS
        for w in np.flatnonzero(fell).tolist():
            if w - last >= _FLOOR_WINDOWS:
                i = int(rows[w + _FLOOR_WINDOWS])
                j = int(rows[w + _FLOOR_WINDOWS + 1]) if w + _FLOOR_WINDOWS + 1 < rows.size else b
                below = host_s[i:j] - device_s[i:j] < floor_s[w] - _FALL_S
                out.append(i + int(np.argmax(below)))
            last = w
    return out


def sequence_modulus(sequence: CounterArray) -> int:
    """Return after how many samples a counter begins anew, by the values it shows."""
    return 2**16 if int(sequence.max()) < 2**16 else 2**32


def unwrap_sequence(sequence: CounterArray, expected: FloatArray) -> IntArray:
    """Return a sample counter without wraps, shape (n,).

    Args:
        sequence: as sent, shape (n,); 16 bits wide where no value exceeds 65535, else 32.
        expected: how many samples should have passed since the first one by the clock,
            shape (n,); it decides how many wraps lie inside a long gap.
    """
    if sequence.size == 0:
        return sequence.astype(np.int64)
    return counted_since(int(sequence[0]), sequence, expected, sequence_modulus(sequence))


def counted_since(
    first: int, sequence: CounterArray, expected: FloatArray, modulus: int
) -> IntArray:
    """Return the samples since one whose counter was `first`; see `unwrap_sequence`."""
    since = sequence.astype(np.int64) - first
    wraps = np.rint((expected - since) / modulus).astype(np.int64)
    return np.asarray(since + wraps * modulus, dtype=np.int64)
