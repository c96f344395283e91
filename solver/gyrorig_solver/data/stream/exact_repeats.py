"""Check for repeated samples: all words equal to those of the previous sample.

With coarse counts this also happens by chance. The expected number is computed per window from
the repeat share of each axis, with independent axes. If the board has an accelerometer, all six
words must be equal, which hardly ever happens by chance.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, IntArray
from gyrorig_solver.data.count_columns import stored_column
from gyrorig_solver.data.link_remedies import REPEATS
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.count_stream import (
    MAX_P_VALUE,
    WINDOW_SAMPLES,
    CheckResult,
    CountStream,
    StreamFinding,
    poisson_tail,
    replace_usable,
)

CHECK_NAME = "repeated samples"
MAX_CHANCE_SHARE = 0.2  # of the repeats; with a larger share by chance, no sample is excluded
CHANCE_FACTOR = 1.25  # the axes are not quite independent: one motion drives all of them
MIN_REPEATS = 3
MAX_SAMPLES_WITH_ACCEL = 4_000_000  # samples


@dataclass(frozen=True, slots=True, eq=False)
class _Repeats:
    """The samples that repeat the previous one, and their significance."""

    rows: IntArray
    expected_by_chance: float  # number of repeats
    p_value: float

    @property
    def is_significant(self) -> bool:
        """Whether there are more repeats than by chance."""
        return self.rows.size >= MIN_REPEATS and self.p_value <= MAX_P_VALUE


def check_repeats(stream: CountStream) -> CheckResult:
    """Check for exact repeats of the rates, and of rates and accelerations."""
    flagged_count, repeats = stream.samples.repeated, _find_repeats(stream)
    if not repeats.is_significant:
        if not flagged_count:
            return CheckResult(
                CHECK_NAME,
                f"{repeats.rows.size} repeats of all words, {repeats.expected_by_chance:.1f} "
                "expected by chance",
                (),
                ("repeated_samples",),
            )
        repeats = _Repeats(np.zeros(flagged_count, dtype=np.int64), 0.0, 0.0)
    count = max(int(repeats.rows.size), flagged_count)
    share = count / stream.size
    description = f"{count} of {stream.size} samples ({100.0 * share:.2g} %) repeat the one before"
    if repeats.expected_by_chance >= 0.5:
        description += f"; {repeats.expected_by_chance:.1f} are expected by chance"
    finding = StreamFinding(
        cause="repeated_samples",
        part="clock",
        where=(),
        count=count,
        total=stream.size,
        p_value=repeats.p_value,
        quantity="share",
        size=share,
        unit="1",
        seen_as=description,
        remedy=REPEATS.for_link(stream.samples.link),
        times_s=stream.times_s(repeats.rows),
    )
    return CheckResult(CHECK_NAME, description, (finding,))


def without_repeats(samples: GyroSamples) -> GyroSamples:
    """Return samples with true repeats marked as not usable.

    A repeat is late by one period; if the rate changes, it has the same effect as lost steps.
    """
    repeats = _find_repeats(CountStream(samples))
    if (
        not repeats.is_significant
        or repeats.expected_by_chance > MAX_CHANCE_SHARE * repeats.rows.size
    ):
        return samples
    usable = samples.usable.copy()
    newly_excluded = int(np.count_nonzero(usable[repeats.rows]))
    usable[repeats.rows] = False
    return replace_usable(samples, usable, samples.repeated + newly_excluded)


def _find_repeats(stream: CountStream) -> _Repeats:
    rates_only = _test_repeats(stream, with_accel=False)
    # Hours of accelerations would need too much memory.
    if stream.size > MAX_SAMPLES_WITH_ACCEL or stored_column(stream.samples, "accel_m_s2") is None:
        return rates_only
    with_acceleration = _test_repeats(stream, with_accel=True)
    return with_acceleration if with_acceleration.p_value < rates_only.p_value else rates_only


def _test_repeats(stream: CountStream, with_accel: bool) -> _Repeats:
    rows, expected = _count_repeats(stream, with_accel)
    return _Repeats(rows, expected, poisson_tail(rows.size, expected))


def _count_repeats(stream: CountStream, with_accel: bool) -> tuple[IntArray, float]:
    """Return the samples that repeat the previous one, and their expected number by chance."""
    repeat_rows, expected = [np.zeros(0, dtype=np.int64)], 0.0
    acceleration = stored_column(stream.samples, "accel_m_s2") if with_accel else None
    for rows, counts in stream.pieces():
        is_equal: BoolArray = np.diff(counts, axis=0) == 0
        if acceleration is not None:
            is_equal = np.hstack([is_equal, np.diff(acceleration.counts[rows], axis=0) == 0])
        repeat_rows.append(rows.start + 1 + np.flatnonzero(is_equal.all(axis=1)))
        for start in range(0, is_equal.shape[0], WINDOW_SAMPLES):
            window = is_equal[start : start + WINDOW_SAMPLES]
            expected += float(np.prod(window.mean(axis=0))) * window.shape[0]
    unique_rows = np.unique(np.concatenate(repeat_rows))
    return unique_rows, CHANCE_FACTOR * expected
