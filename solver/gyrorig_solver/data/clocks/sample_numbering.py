"""Sample numbers from the counter of a board, without repeated and late samples.

Each segment counts from 0. A sample is kept if its number is larger than all before it.
Therefore repeated and late samples are excluded, and missing numbers are lost samples. If the
counter does not change (a source without one), the order of the samples is used.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.clocks.clock_faults import CounterArray
from gyrorig_solver.data.clocks.tick_unwrapping import PIECE_SAMPLES, counter_modulus, samples_since

_MAX_INT32 = np.iinfo(np.int32).max
_PERIOD_SAMPLES = 1 << 12  # samples for the estimate of the period


@dataclass(frozen=True, slots=True, eq=False)
class SampleNumbering:
    """The numbers of the samples, and the mask of those to keep."""

    numbers: CounterArray  # (n,), in the order of arrival; increasing for the kept samples
    keep_mask: BoolArray | None  # (n,), None: all samples
    lost: int


def number_samples(
    sequence: CounterArray,
    time_s: FloatArray,
    segment: IntArray,
    *,
    sequence_bits: int | None = None,
    overwrite: bool = False,
) -> SampleNumbering:
    """Return the numbers of the samples.

    Args:
        sequence: the sample counter as sent, shape (n,).
        time_s: of each sample, shape (n,); determines the wraps of the counter in a gap.
        segment: of each sample, not decreasing, shape (n,).
        sequence_bits: width of the sample counter; None: 16 in a segment in which no value
            exceeds 65535, otherwise 32.
        overwrite: allows the use of the memory of a 32-bit `sequence` for the result.
    """
    edges = np.searchsorted(segment, np.arange(int(segment[-1]) + 2)).tolist()
    parts = [
        _NumberedSegment.of(sequence[a:b], time_s[a:b], sequence_bits) for a, b in pairwise(edges)
    ]
    fits_32_bits = sequence.dtype.itemsize == 4 and all(part.span <= _MAX_INT32 for part in parts)
    number: CounterArray
    if fits_32_bits:
        number = sequence.view(np.int32) if overwrite else np.empty(sequence.size, np.int32)
    else:
        number = np.empty(sequence.size, np.int64)
    keep_mask: BoolArray | None = None
    lost = 0
    for part, (a, b) in zip(parts, pairwise(edges), strict=True):
        discarded, missing = part.write_numbers(number[a:b])
        lost += missing
        if discarded.size:
            keep_mask = np.ones(sequence.size, dtype=np.bool_) if keep_mask is None else keep_mask
            keep_mask[a + discarded] = False
    return SampleNumbering(number, keep_mask, lost)


@dataclass(frozen=True, slots=True, eq=False)
class _NumberedSegment:
    """The counter of one segment, with its width and period."""

    sequence: CounterArray
    time_s: FloatArray
    period_s: float
    modulus: int
    is_in_order: bool  # the order of the samples is their number
    min_number: int = 0  # smallest number since the first sample
    span: int = 0

    @classmethod
    def of(
        cls, sequence: CounterArray, time_s: FloatArray, sequence_bits: int | None
    ) -> "_NumberedSegment":
        n, period_s = sequence.size, _period_s(time_s)
        modulus = counter_modulus(sequence, sequence_bits)
        steps = _common_step(sequence, modulus)
        expected_steps = (time_s[-1] - time_s[0]) / period_s
        is_in_order = steps == 0 or (steps == 1 and abs(expected_steps - (n - 1)) < modulus / 2)
        segment = cls(sequence, time_s, period_s, modulus, is_in_order)
        if is_in_order:
            return segment
        counts = [(int(count.min()), int(count.max())) for _, count in segment.counts()]
        min_number = min(low for low, _ in counts)
        span = max(high for _, high in counts) - min_number
        return cls(sequence, time_s, period_s, modulus, is_in_order, min_number, span)

    def counts(self) -> Iterator[tuple[slice, IntArray]]:
        """Yield the sample counts since the first sample, piece by piece."""
        first, begin_s = int(self.sequence[0]), self.time_s[0]
        for start in range(0, self.sequence.size, PIECE_SAMPLES):
            rows = slice(start, start + PIECE_SAMPLES)
            expected = (self.time_s[rows] - begin_s) / self.period_s
            yield rows, samples_since(first, self.sequence[rows], expected, self.modulus)

    def write_numbers(self, number: CounterArray) -> tuple[IntArray, int]:
        """Write the numbers; return the samples to exclude and the number of missing ones."""
        if self.is_in_order:
            for start in range(0, number.size, PIECE_SAMPLES):
                piece = number[start : start + PIECE_SAMPLES]
                piece[...] = np.arange(start, start + piece.size)
            return np.zeros(0, np.int64), 0
        largest = self.min_number - 1
        discarded: list[IntArray] = []
        discarded_numbers: list[IntArray] = []
        for rows, count in self.counts():
            largest_before = np.maximum.accumulate(np.concatenate([[largest], count]))
            largest = int(largest_before[-1])
            discarded_rows = np.flatnonzero(count <= largest_before[:-1])
            discarded.append(rows.start + discarded_rows)
            discarded_numbers.append(count[discarded_rows] - self.min_number)
            number[rows] = count - self.min_number
        discarded_rows = np.concatenate(discarded)
        late_numbers = np.unique(np.concatenate(discarded_numbers))
        if not discarded_rows.size:
            return discarded_rows, self.span + 1 - number.size
        # A late sample is not missing. The kept numbers increase, therefore they can be searched.
        kept_numbers = np.delete(number, discarded_rows)
        positions = np.minimum(np.searchsorted(kept_numbers, late_numbers), kept_numbers.size - 1)
        received = kept_numbers.size + int(
            np.count_nonzero(kept_numbers[positions] != late_numbers)
        )
        return discarded_rows, self.span + 1 - received


def _period_s(time_s: FloatArray) -> float:
    """Return a rough sample period, the median step at three places."""
    n = time_s.size
    if n < 2:
        return 1.0
    starts = [0] if n <= 4 * _PERIOD_SAMPLES else [0, n // 2, n - _PERIOD_SAMPLES]
    length = n if n <= 4 * _PERIOD_SAMPLES else _PERIOD_SAMPLES
    steps = np.concatenate([np.diff(time_s[start : start + length]) for start in starts])
    return max(float(np.median(steps)), 1e-9)


def _common_step(sequence: CounterArray, modulus: int) -> int | None:
    """Return the step of the counter if it is constant, otherwise None."""
    common: int | None = None
    for start in range(0, sequence.size - 1, PIECE_SAMPLES):
        step = np.diff(sequence[start : start + PIECE_SAMPLES + 1].astype(np.int64))
        if common is None:
            common = int(step[0]) % modulus
        if np.any((step != common) & (step != common - modulus)):
            return None
    return common
