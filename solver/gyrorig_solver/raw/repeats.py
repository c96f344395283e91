"""Samples that come twice: all words alike to the bit.

Chance does so too where counts are coarse. How often is found window by window from how often
each axis repeats itself, the axes being independent; where the board has an accelerometer
all six words have to be alike, which chance hardly ever does.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gyrorig_solver.arrays import BoolArray, IntArray
from gyrorig_solver.columns import column_of
from gyrorig_solver.raw.result import CHANCE, WINDOW, Look, RawFinding, Stream, poisson_tail
from gyrorig_solver.samples import GyroSamples

CHECK = "repeated samples"
BY_CHANCE = 0.2  # of the repeats: where chance makes more, none is set aside
SLACK = 1.25  # axes are not wholly independent: one motion drives them all
FEWEST = 3
MOST_WITH_ACCEL = 4_000_000  # samples
AS_SENT = ("host_s", "rate_rad_s", "accel_m_s2", "temperature_degc")
REMEDY = (
    "read the sensor at its data-ready line or at its own rate, and look for a lossy radio "
    "link that holds the last sample"
)


@dataclass(frozen=True, slots=True, eq=False)
class _Repeats:
    """Which samples repeat the one before, by the words that tell it best."""

    rows: IntArray
    by_chance: float  # so many
    p_value: float

    @property
    def real(self) -> bool:
        """Whether they are no chance."""
        return self.rows.size >= FEWEST and self.p_value <= CHANCE


def look(stream: Stream) -> Look:
    """Count exact repeats, by the rates alone and with the accelerations."""
    flagged, best = stream.samples.repeated, _found(stream)
    if not best.real:
        if not flagged:
            return Look(
                CHECK,
                f"{best.rows.size} repeats of all words, {best.by_chance:.1f} by chance",
                (),
                ("repeated_samples",),
            )
        best = _Repeats(np.zeros(flagged, dtype=np.int64), 0.0, 0.0)
    count = max(int(best.rows.size), flagged)
    share = count / stream.size
    said = f"{count} of {stream.size} samples ({100.0 * share:.2g} %) repeat the one before"
    if best.by_chance >= 0.5:
        said += f"; chance makes {best.by_chance:.1f}"
    finding = RawFinding(
        cause="repeated_samples",
        part="clock",
        where=(),
        count=count,
        total=stream.size,
        p_value=best.p_value,
        name="share",
        size=share,
        unit="1",
        seen_as=said,
        remedy=REMEDY,
        times_s=stream.times_s(best.rows),
    )
    return Look(CHECK, said, (finding,))


def without_repeats(samples: GyroSamples) -> GyroSamples:
    """Return samples with true repeats set aside: they tell of an earlier moment.

    Left in, they are late by a period wherever the rate changes, and look like lost steps.
    """
    best = _found(Stream(samples))
    if not best.real or best.by_chance > BY_CHANCE * best.rows.size:
        return samples
    good = samples.good.copy()
    fresh = int(np.count_nonzero(good[best.rows]))
    good[best.rows] = False
    as_sent: dict[str, Any] = {
        name: column_of(samples, name) for name in AS_SENT
    }  # `replace` reads values
    return replace(samples, good=good, repeated=samples.repeated + fresh, **as_sent)


def _found(stream: Stream) -> _Repeats:
    rates = _judged(stream, with_accel=False)
    # Hours of accelerations are not worth their memory.
    if stream.size > MOST_WITH_ACCEL or column_of(stream.samples, "accel_m_s2") is None:
        return rates
    both = _judged(stream, with_accel=True)
    return both if both.p_value < rates.p_value else rates


def _judged(stream: Stream, with_accel: bool) -> _Repeats:
    rows, expected = _counted(stream, with_accel)
    return _Repeats(rows, expected, poisson_tail(rows.size, expected))


def _counted(stream: Stream, with_accel: bool) -> tuple[IntArray, float]:
    """Return which samples repeat the one before, and how many do so by chance."""
    found, expected = [np.zeros(0, dtype=np.int64)], 0.0
    acceleration = column_of(stream.samples, "accel_m_s2") if with_accel else None
    for rows, counts in stream.pieces():
        same: BoolArray = np.diff(counts, axis=0) == 0
        if acceleration is not None:
            same = np.hstack([same, np.diff(acceleration.counts[rows], axis=0) == 0])
        found.append(rows.start + 1 + np.flatnonzero(same.all(axis=1)))
        for start in range(0, same.shape[0], WINDOW):
            part = same[start : start + WINDOW]
            expected += float(np.prod(part.mean(axis=0))) * part.shape[0]
    again = np.unique(np.concatenate(found))
    return again, SLACK * expected
