"""Number a board's samples by its own counter, and set aside what came twice or late.

Each segment counts from 0. A sample is kept when its number is larger than all before it:
repeats and late ones are not, and what the numbers leave out was lost. Where the counter
stands still (a source without one) the order counts.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.clocks.faults import CounterArray
from gyrorig_solver.clocks.unwrap import PIECE, counted_since, sequence_modulus

_LARGEST = np.iinfo(np.int32).max
_STRETCH = 1 << 12  # samples that say what the period is


@dataclass(frozen=True, slots=True, eq=False)
class Numbered:
    """The samples' numbers, and which of them to keep."""

    number: CounterArray  # (n,), of the samples as they came; of those kept increasing
    keep: BoolArray | None  # (n,), None: all
    lost: int


def number_samples(
    sequence: CounterArray, time_s: FloatArray, segment: IntArray, *, overwrite: bool = False
) -> Numbered:
    """Return the samples' numbers.

    Args:
        sequence: the sample counter as sent, shape (n,).
        time_s: of each sample, shape (n,); tells how often the counter began anew in a gap.
        segment: of each sample, not decreasing, shape (n,).
        overwrite: the memory of a `sequence` of 32 bits may be taken for the result.
    """
    edges = np.searchsorted(segment, np.arange(int(segment[-1]) + 2)).tolist()
    parts = [_Segment.of(sequence[a:b], time_s[a:b]) for a, b in pairwise(edges)]
    small = sequence.dtype.itemsize == 4 and all(part.span <= _LARGEST for part in parts)
    number: CounterArray
    if small:
        number = sequence.view(np.int32) if overwrite else np.empty(sequence.size, np.int32)
    else:
        number = np.empty(sequence.size, np.int64)
    keep: BoolArray | None = None
    lost = 0
    for part, (a, b) in zip(parts, pairwise(edges), strict=True):
        aside, missing = part.number_into(number[a:b])
        lost += missing
        if aside.size:
            keep = np.ones(sequence.size, dtype=np.bool_) if keep is None else keep
            keep[a + aside] = False
    return Numbered(number, keep, lost)


@dataclass(frozen=True, slots=True, eq=False)
class _Segment:
    """One segment's counter and how to read it."""

    sequence: CounterArray
    time_s: FloatArray
    period_s: float
    modulus: int
    plain: bool  # the order is the number
    least: int = 0  # of the numbers since the first sample
    span: int = 0

    @classmethod
    def of(cls, sequence: CounterArray, time_s: FloatArray) -> "_Segment":
        n, modulus, period_s = sequence.size, sequence_modulus(sequence), _period_s(time_s)
        steps = _common_step(sequence, modulus)
        passed = (time_s[-1] - time_s[0]) / period_s
        plain = steps == 0 or (steps == 1 and abs(passed - (n - 1)) < modulus / 2)
        found = cls(sequence, time_s, period_s, modulus, plain)
        if plain:
            return found
        counts = [(int(count.min()), int(count.max())) for _, count in found.counts()]
        least = min(low for low, _ in counts)
        span = max(high for _, high in counts) - least
        return cls(sequence, time_s, period_s, modulus, plain, least, span)

    def counts(self) -> Iterator[tuple[slice, IntArray]]:
        """Yield the samples since the first one, piece by piece."""
        first, begin_s = int(self.sequence[0]), self.time_s[0]
        for start in range(0, self.sequence.size, PIECE):
            rows = slice(start, start + PIECE)
            expected = (self.time_s[rows] - begin_s) / self.period_s
            yield rows, counted_since(first, self.sequence[rows], expected, self.modulus)

    def number_into(self, number: CounterArray) -> tuple[IntArray, int]:
        """Write the numbers; return which samples to set aside, and how many are missing."""
        if self.plain:
            for start in range(0, number.size, PIECE):
                piece = number[start : start + PIECE]
                piece[...] = np.arange(start, start + piece.size)
            return np.zeros(0, np.int64), 0
        largest = self.least - 1
        aside: list[IntArray] = []
        twice: list[IntArray] = []
        for rows, count in self.counts():
            before = np.maximum.accumulate(np.concatenate([[largest], count]))
            largest = int(before[-1])
            out = np.flatnonzero(count <= before[:-1])
            aside.append(rows.start + out)
            twice.append(count[out] - self.least)
            number[rows] = count - self.least
        out, late = np.concatenate(aside), np.unique(np.concatenate(twice))
        if not out.size:
            return out, self.span + 1 - number.size
        # A late one was missed until it came; the numbers kept increase, so they can be searched.
        kept = np.delete(number, out)
        at = np.minimum(np.searchsorted(kept, late), kept.size - 1)
        came = kept.size + int(np.count_nonzero(kept[at] != late))
        return out, self.span + 1 - came


def _period_s(time_s: FloatArray) -> float:
    """Return the median step of some stretches; it need not be good, only near."""
    n = time_s.size
    if n < 2:
        return 1.0
    starts = [0] if n <= 4 * _STRETCH else [0, n // 2, n - _STRETCH]
    length = n if n <= 4 * _STRETCH else _STRETCH
    steps = np.concatenate([np.diff(time_s[start : start + length]) for start in starts])
    return max(float(np.median(steps)), 1e-9)


def _common_step(sequence: CounterArray, modulus: int) -> int | None:
    """Return by how much the counter goes on from each sample to the next, if always alike."""
    common: int | None = None
    for start in range(0, sequence.size - 1, PIECE):
        step = np.diff(sequence[start : start + PIECE + 1].astype(np.int64))
        if common is None:
            common = int(step[0]) % modulus
        if np.any((step != common) & (step != common - modulus)):
            return None
    return common
