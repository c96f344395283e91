"""What one look at a raw stream says, and the stream as the looks see it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.model.terms.protocol import Part
from gyrorig_solver.samples import GyroSamples

ROWS = 1 << 17  # looked at in one go: 8 h at 800 Hz are 23 million
CHANCE = 1e-6  # a look is believed where chance does so in one of a million recordings
WINDOW = 64  # samples over which a board's noise and motion are taken to be alike
AXES = ("x", "y", "z")
ROUGH_ROWS = 1 << 14
MOST_STILL = 0.9
_EXAMPLES = 50


@dataclass(frozen=True, slots=True)
class RawFinding:
    """Something wrong with the samples themselves."""

    cause: str  # id of the catalogue
    part: Part
    where: tuple[str, ...]  # sensor axes, () where it is all of them
    count: int  # samples or words that are touched
    total: int  # of so many
    p_value: float  # that chance alone would do it
    name: str  # of the quantity
    size: float
    unit: str
    seen_as: str  # one sentence
    remedy: str
    times_s: tuple[float, ...] = ()  # some of the places, seconds of the recording

    @property
    def share(self) -> float:
        """Of the samples, 0 to 1."""
        return self.count / self.total if self.total else 0.0


@dataclass(frozen=True, slots=True)
class Look:
    """One check and what it saw; `finding` is None where nothing is wrong."""

    check: str
    said: str
    findings: tuple[RawFinding, ...] = field(default=())
    decides: tuple[str, ...] = ()  # causes that it can tell from none, here


@dataclass(frozen=True, eq=False)
class Stream:
    """The counts of one board, in pieces without gaps."""

    samples: GyroSamples

    @property
    def size(self) -> int:
        """How many samples there are."""
        return int(self.samples.number.size)

    @cached_property
    def grain(self) -> IntArray:
        """The least step between two readings of an axis, in counts, shape (3,).

        1 where the counts are the words as sent; more where a file of physical values was
        turned into finer counts.
        """
        found = []
        for axis in range(3):
            values = np.unique(self.samples.counts[:ROWS, axis])
            steps = np.diff(values.astype(np.int64))
            found.append(int(steps.min()) if steps.size else 0)
        return np.array(found, dtype=np.int64)

    def pieces(self) -> Iterator[tuple[slice, IntArray]]:
        """Yield rows without a gap, and their counts, shape (n, 3)."""
        for stretch in self.samples.stretches(1):
            for start in range(stretch.start, stretch.stop, ROWS):
                # four samples of overlap: what is judged by neighbours is judged once
                rows = slice(max(stretch.start, start - 4), min(start + ROWS, stretch.stop))
                yield rows, self.samples.counts[rows].astype(np.int64)

    @cached_property
    def still_share(self) -> FloatArray:
        """How often an axis repeats itself by noise and steps of the counts, shape (3,).

        The larger of what white noise of the axis' deviation makes, twice, and of what three
        windows of four stay below.
        """
        shares, rough = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for _, counts in self.pieces():
            same = np.diff(counts, axis=0) == 0
            many = same.shape[0] // WINDOW
            if many:
                shares.append(same[: many * WINDOW].reshape(many, WINDOW, 3).mean(axis=1))
            rough.append(np.abs(np.diff(counts[:ROUGH_ROWS], 4, axis=0)))
        found, left = np.concatenate(shares), np.concatenate(rough)
        if not found.shape[0] or not left.shape[0]:
            return np.full(3, MOST_STILL)
        # sum of squares of (1, -4, 6, -4, 1) is 70; equal readings of a normal: 1/(2 sqrt(pi) s)
        deviation = np.median(left, axis=0) / 0.6745 / np.sqrt(70.0) / np.maximum(self.grain, 1)
        white = 2.0 * 0.2821 / np.maximum(deviation, 1e-3)
        usual = np.quantile(found, 0.75, axis=0)
        return np.asarray(np.clip(np.maximum(white, usual), 1.0 / WINDOW, MOST_STILL))

    def times_s(self, rows: IntArray) -> tuple[float, ...]:
        """Return when some samples were taken, of a few of them."""
        first = self.samples.time_s[0]
        return tuple(float(self.samples.time_s[k] - first) for k in rows[:_EXAMPLES])


def poisson_tail(count: int, expected: float) -> float:
    """Return how likely `count` or more are where `expected` are usual."""
    if count <= 0:
        return 1.0
    if expected <= 0.0:
        return 0.0
    term = math.exp(min(0.0, count * math.log(expected) - expected - math.lgamma(count + 1)))
    total, k = 0.0, count
    while term > 1e-18 * total and k < count + 10_000:
        total += term
        k += 1
        term *= expected / k
    return min(1.0, total)


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the stretches [first, stop) where flags are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in list(pairwise(edges))[::2]]
