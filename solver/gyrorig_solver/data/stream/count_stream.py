"""The raw stream of counts, and the result of a check."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.count_columns import CountColumn, stored_column
from gyrorig_solver.data.samples import GyroSamples

PIECE_ROWS = 1 << 17  # rows per piece; 8 h at 800 Hz are 23 million
MAX_P_VALUE = 1e-6  # significance level of a finding
WINDOW_SAMPLES = 64  # samples over which noise and motion are assumed to be constant
AXES = ("x", "y", "z")
COUNT_FIELDS = ("host_s", "rate_rad_s", "accel_m_s2", "temperature_degc")
NOISE_ROWS = 1 << 14
MIN_INSIDE = WINDOW_SAMPLES // 4  # samples of a window that are not clipped
MAX_REPEAT_SHARE = 0.9
MIN_MOTION_STEPS = 64  # of the rounding; noise that hides in one step has a smaller span
_MAX_EXAMPLES = 50


@dataclass(frozen=True, slots=True)
class StreamFinding:
    """A defect of the samples."""

    cause: str  # id of the cause in the catalogue
    part: str  # of the rig, as in the catalogue of causes
    where: tuple[str, ...]  # sensor axes, () for all of them
    count: int  # affected samples or words
    total: int  # of this number
    p_value: float  # probability of the finding by chance
    quantity: str  # the name of `size`
    size: float
    unit: str
    seen_as: str  # one sentence on the evidence
    remedy: str
    times_s: tuple[float, ...] = ()  # times of some affected samples, s since the start

    @property
    def share(self) -> float:
        """Affected share, 0 to 1."""
        return self.count / self.total if self.total else 0.0


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of one check; `findings` is empty if there is no defect."""

    check: str
    summary: str
    findings: tuple[StreamFinding, ...] = field(default=())
    testable_causes: tuple[str, ...] = ()  # causes that this check can detect in this recording


@dataclass(frozen=True, eq=False)
class CountStream:
    """The counts of one board, read in pieces without gaps."""

    samples: GyroSamples

    @property
    def size(self) -> int:
        """The number of samples."""
        return int(self.samples.number.size)

    @cached_property
    def count_step(self) -> IntArray:
        """The quantum of each axis, in counts, shape (3,).

        It is 1 if the counts are the words as sent, and larger if physical values of a file
        were converted to finer counts.
        """
        count_steps = []
        for axis in range(3):
            values = np.unique(self.samples.counts[:PIECE_ROWS, axis])
            steps = np.diff(values.astype(np.int64))
            count_steps.append(int(steps.min()) if steps.size else 0)
        return np.array(count_steps, dtype=np.int64)

    def pieces(self) -> Iterator[tuple[slice, IntArray]]:
        """Yield slices without a gap, and their counts, shape (n, 3)."""
        for contiguous in self.samples.contiguous_slices(1):
            for start in range(contiguous.start, contiguous.stop, PIECE_ROWS):
                # four samples of overlap, so that each neighbourhood is checked once
                rows = slice(
                    max(contiguous.start, start - 4), min(start + PIECE_ROWS, contiguous.stop)
                )
                yield rows, self.samples.counts[rows].astype(np.int64)

    @cached_property
    def repeat_share(self) -> FloatArray:
        """Share of samples that equal the previous one by noise and quantisation, shape (3,).

        It is the larger of two values: twice the share for white noise of the axis' standard
        deviation, and the upper quartile over windows. A clipped motion repeats its ends; these
        samples show neither noise nor quantisation and are left out.
        """
        shares: list[list[FloatArray]] = [[], [], []]
        differences: list[list[FloatArray]] = [[], [], []]
        for _, counts in self.pieces():
            is_inside = self._is_inside(counts)
            for axis in range(3):
                inside = is_inside[:, axis]
                shares[axis].append(_window_shares(counts[:, axis], inside))
                rows = slice(0, NOISE_ROWS)
                differences[axis].append(_fourth_differences(counts[rows, axis], inside[rows]))
        return np.array(
            [
                _repeat_share(np.concatenate(shares[k]), np.concatenate(differences[k]) / step)
                for k, step in enumerate(np.maximum(self.count_step, 1))
            ]
        )

    def _is_inside(self, counts: IntArray) -> BoolArray:
        """Return which counts are not at an end of an axis that moves, shape (n, 3)."""
        lowest, highest = self._ends
        is_end = (counts == lowest) | (counts == highest)
        moves = highest - lowest > MIN_MOTION_STEPS * np.maximum(self.count_step, 1)
        return np.asarray(~(is_end & moves), dtype=np.bool_)

    @cached_property
    def _ends(self) -> tuple[IntArray, IntArray]:
        """The lowest and the highest count of each axis, each (3,)."""
        counts = self.samples.counts
        return counts.min(axis=0).astype(np.int64), counts.max(axis=0).astype(np.int64)

    def times_s(self, rows: IntArray) -> tuple[float, ...]:
        """Return the times of at most `_MAX_EXAMPLES` samples, s since the first."""
        first = self.samples.time_s[0]
        return tuple(float(self.samples.time_s[k] - first) for k in rows[:_MAX_EXAMPLES])


def _window_shares(counts: IntArray, is_inside: BoolArray) -> FloatArray:
    """Return the share of repeats in each window with enough samples that are inside."""
    is_inside = is_inside[1:]
    is_repeat = (np.diff(counts) == 0) & is_inside
    size = is_repeat.size // WINDOW_SAMPLES * WINDOW_SAMPLES
    repeats, inside = (
        flags[:size].reshape(-1, WINDOW_SAMPLES).sum(axis=1) for flags in (is_repeat, is_inside)
    )
    is_known = inside >= MIN_INSIDE
    return np.asarray(repeats[is_known] / inside[is_known], dtype=np.float64)


def _fourth_differences(counts: IntArray, is_inside: BoolArray) -> FloatArray:
    """Return the sizes of the fourth differences of samples that are all inside."""
    if counts.size < 5:
        return np.zeros(0)
    are_inside = np.lib.stride_tricks.sliding_window_view(is_inside, 5).all(axis=1)
    return np.abs(np.diff(counts, 4)[are_inside]).astype(np.float64)


def _repeat_share(window_shares: FloatArray, differences: FloatArray) -> float:
    """Return the share of repeats of an axis, from windows and from differences in count steps."""
    if not window_shares.size or not differences.size:
        return MAX_REPEAT_SHARE
    # sum of squares of (1, -4, 6, -4, 1) is 70; equal readings of a normal: 1/(2 sqrt(pi) s)
    deviation = float(np.median(differences)) / 0.6745 / math.sqrt(70.0)
    white_share = 2.0 * 0.2821 / max(deviation, 1e-3)
    usual_share = float(np.quantile(window_shares, 0.75))
    return float(np.clip(max(white_share, usual_share), 1.0 / WINDOW_SAMPLES, MAX_REPEAT_SHARE))


def replace_usable(
    samples: GyroSamples, usable: BoolArray, repeated: int | None = None
) -> GyroSamples:
    """Return samples with another mask of usable ones.

    Args:
        samples: their counts are shared.
        usable: the mask, (n,).
        repeated: number of repeated samples; None: unchanged.
    """
    count_fields: dict[str, Any] = {
        name: stored_column(samples, name) for name in COUNT_FIELDS
    }  # not as values, because `replace` would read them
    count = samples.repeated if repeated is None else repeated
    return replace(samples, usable=usable, repeated=count, **count_fields)


def subtract_rates(
    samples: GyroSamples, change_rad_s: Callable[[FloatArray], FloatArray]
) -> GyroSamples:
    """Return samples with a known part of the rates subtracted.

    Args:
        samples: the other columns are shared.
        change_rad_s: returns this part at times (n,), shape (n, 3).
    """
    count_fields: dict[str, Any] = {name: stored_column(samples, name) for name in COUNT_FIELDS}
    gyro = samples.gyro
    counts = np.empty((samples.time_s.size, 3))
    for start in range(0, counts.shape[0], PIECE_ROWS):
        rows = slice(start, start + PIECE_ROWS)
        counts[rows] = gyro.counts[rows] - change_rad_s(samples.time_s[rows]) / gyro.scale
    count_fields["rate_rad_s"] = CountColumn(counts, gyro.scale)
    return replace(samples, **count_fields)


def poisson_tail(count: int, expected: float) -> float:
    """Return the Poisson probability of `count` or more events for `expected` on average."""
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


def true_runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return the runs [first, stop) of set flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in list(pairwise(edges))[::2]]
