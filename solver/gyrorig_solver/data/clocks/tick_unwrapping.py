"""Unwrapping of a tick counter, in segments between restarts and clock steps.

Wraps are counted by host time and not by decreasing timestamps, because a swapped sample that
counts as a wrap is an error of 71.6 min. Between two samples the number of wraps is the nearest
integer to (host interval - device interval) / period. This is safe while skew x gap is below half a
period.

A first pass over all samples, in pieces of bounded size, finds the suspect steps; `clock_faults`
then classifies each of them.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import (
    ClockFault,
    ClockFaultKind,
    CounterArray,
    FaultClassifier,
    TickStream,
)

PIECE_SAMPLES = 1 << 16  # samples per piece, which stay in the processor cache
# A step in which host and device agree within this is not suspect.
MAX_PLAIN_DISAGREEMENT_S = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class UnwrappedTicks:
    """Continuous device time, in segments between restarts and steps of the clock."""

    device_s: FloatArray  # (n,), seconds since the segment's first sample, nominal tick rate
    segment: IntArray  # (n,), counts segments from 0
    late_mask: BoolArray  # (n,), True if a later sample arrived before
    wraps: int
    faults: tuple[ClockFault, ...] = ()

    def count(self, kind: ClockFaultKind) -> int:
        """Return the number of faults of a kind."""
        return sum(fault.kind is kind for fault in self.faults)

    @property
    def restarts(self) -> int:
        """Number of restarts of the device."""
        return self.count(ClockFaultKind.RESTART)

    @property
    def steps(self) -> int:
        """Number of clock steps without a restart."""
        return self.count(ClockFaultKind.STEP)


def unwrap_ticks(
    ticks: IntArray,
    host_s: FloatArray,
    tick_hz: float,
    counter_bits: int,
    sequence: CounterArray | None = None,
    *,
    sequence_bits: int | None = None,
    overwrite: bool = False,
) -> UnwrappedTicks:
    """Return continuous device time.

    Args:
        ticks: raw counter values as sent, shape (n,), in the order of arrival.
        host_s: arrival times on the capture clock, shape (n,), not decreasing.
        tick_hz: nominal ticks per second.
        counter_bits: width of the counter.
        sequence: the sample counter as sent, shape (n,), if there is one.
        sequence_bits: width of the sample counter; None: 16 if no value exceeds 65535,
            otherwise 32.
        overwrite: allows the use of the memory of `ticks` for the result.
    """
    if ticks.size == 0:
        return UnwrappedTicks(np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.bool_), 0)
    stream = TickStream.of(
        ticks.astype(np.int64, copy=False), host_s, tick_hz, counter_bits, sequence, sequence_bits
    )
    wraps, suspects = _find_suspect_steps(stream)
    classifier = FaultClassifier(stream)
    for index in suspects.tolist():
        classifier.classify_step(index, int(wraps.get(index, 0)))
    device_s, segment, wrap_count = _assemble_device_time(
        stream, wraps, classifier.segment_starts, overwrite
    )
    faults = list(classifier.faults)
    for index in _find_floor_drops(device_s, segment, host_s):
        segment[index:] += 1
        end = int(np.searchsorted(segment, segment[index], side="right"))
        device_s[index:end] -= device_s[index]
        faults.append(ClockFault(ClockFaultKind.STEP, index))
    late_mask = np.zeros(ticks.size, dtype=np.bool_)
    late_mask[classifier.late_samples] = True
    faults.sort(key=lambda fault: fault.index)
    return UnwrappedTicks(device_s, segment, late_mask, wrap_count, tuple(faults))


def _find_suspect_steps(stream: TickStream) -> tuple[dict[int, int], IntArray]:
    """Return the wraps by the sample that follows them, and the suspect steps."""
    wraps: dict[int, int] = {}
    suspects: list[IntArray] = []
    for start in range(0, stream.ticks.size - 1, PIECE_SAMPLES):
        rows = slice(start, min(start + PIECE_SAMPLES + 1, stream.ticks.size))
        host_s = np.diff(stream.host_s[rows])
        device_s = np.diff(stream.ticks[rows]) / stream.tick_hz
        ahead_s = device_s - host_s
        half_s = stream.wrap_s / 2.0
        if float(ahead_s.min()) < -half_s or float(ahead_s.max()) > half_s:
            turns = np.rint(ahead_s / -stream.wrap_s)
            for index in np.flatnonzero(turns).tolist():
                wraps[start + index + 1] = int(turns[index])
            device_s += turns * stream.wrap_s
            ahead_s = device_s - host_s
        np.abs(ahead_s, out=ahead_s)
        is_suspect = (device_s <= 0.0) | (ahead_s > MAX_PLAIN_DISAGREEMENT_S)
        if stream.sequence is not None:
            counter_steps = np.diff(stream.sequence[rows].astype(np.int64)).astype(np.float64)
            counter_lead_s = stream.counter_lead_s(counter_steps, device_s)
            is_suspect |= np.abs(counter_lead_s) > stream.max_disagreement_s + 1e-3 * device_s
        suspects.append(np.flatnonzero(is_suspect).astype(np.int64) + start + 1)
    suspect_index = np.concatenate(suspects) if suspects else np.zeros(0, np.int64)
    return wraps, np.union1d(suspect_index, np.array(sorted(wraps), dtype=np.int64)).astype(
        np.int64
    )


def _assemble_device_time(
    stream: TickStream, wraps: dict[int, int], segment_starts: list[int], overwrite: bool
) -> tuple[FloatArray, IntArray, int]:
    """Return device time, segment numbers and the number of wraps inside segments."""
    n = stream.ticks.size
    device_s = stream.ticks.view(np.float64) if overwrite else np.empty(n, dtype=np.float64)
    segment = np.zeros(n, dtype=np.int64)  # takes memory only in pages that are written
    starts = set(segment_starts)
    cuts = [0, *sorted(starts | set(wraps)), n]
    first_tick, wraps_so_far, wrap_count, number = int(stream.ticks[0]), 0, 0, 0
    for a, b in pairwise(cuts):
        if a in starts:
            first_tick, wraps_so_far, number = int(stream.ticks[a]), 0, number + 1
        elif a in wraps:
            wraps_so_far += wraps[a]
            wrap_count += wraps[a]
        shift = wraps_so_far * stream.modulus - first_tick
        for start in range(a, b, PIECE_SAMPLES):
            rows = slice(start, min(start + PIECE_SAMPLES, b))
            # The right side is computed before the ticks are overwritten.
            device_s[rows] = (stream.ticks[rows] + shift) / stream.tick_hz
        if number:
            segment[a:b] = number
    return device_s, segment, wrap_count


# A minimum latency cannot decrease. The minimum latencies of USB frames and of FTDI's latency timer
# seem to decrease by 1 and by 16 ms when their beat with the stream wraps.
_MIN_FLOOR_DROP_S = 0.02
_FLOOR_WINDOWS = 15
_WINDOW_S = 1.0


def _find_floor_drops(device_s: FloatArray, segment: IntArray, host_s: FloatArray) -> list[int]:
    """Return the samples at which the floor drops, because the host clock was stepped."""
    drops: list[int] = []
    edges = np.searchsorted(segment, np.arange(int(segment[-1]) + 2))
    for a, b in pairwise(edges.tolist()):
        # Use only windows with samples: with a far timestamp, the number of other windows is huge.
        window = np.floor((host_s[a:b] - host_s[a]) / _WINDOW_S)
        rows = a + np.concatenate([[0], np.flatnonzero(np.diff(window) > 0.0) + 1])
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
        window_gap_s = np.diff(host_s[rows])[_FLOOR_WINDOWS - 1 :]
        limit_s = np.maximum(_MIN_FLOOR_DROP_S, 5.0 * scatter_s) + 2e-3 * window_gap_s
        is_drop = lag_s[_FLOOR_WINDOWS:] < floor_s - limit_s
        last = -_FLOOR_WINDOWS
        for w in np.flatnonzero(is_drop).tolist():
            if w - last >= _FLOOR_WINDOWS:
                i = int(rows[w + _FLOOR_WINDOWS])
                j = int(rows[w + _FLOOR_WINDOWS + 1]) if w + _FLOOR_WINDOWS + 1 < rows.size else b
                is_below = host_s[i:j] - device_s[i:j] < floor_s[w] - _MIN_FLOOR_DROP_S
                drops.append(i + int(np.argmax(is_below)))
            last = w
    return drops


def counter_modulus(sequence: CounterArray, bits: int | None = None) -> int:
    """Return the modulus of a sample counter, from its width or, if unknown, from its values."""
    if bits is not None:
        return 1 << bits
    return 2**16 if int(sequence.max()) < 2**16 else 2**32


def samples_since(
    first: int, sequence: CounterArray, expected: FloatArray, modulus: int
) -> IntArray:
    """Return the number of samples since the counter was `first`, without wraps.

    Args:
        first: counter of the reference sample.
        sequence: the counters as sent, shape (n,).
        expected: the numbers by the clock, shape (n,), which determine the wraps.
        modulus: of the counter.
    """
    since = sequence.astype(np.int64) - first
    wraps = np.rint((expected - since) / modulus).astype(np.int64)
    return np.asarray(since + wraps * modulus, dtype=np.int64)
