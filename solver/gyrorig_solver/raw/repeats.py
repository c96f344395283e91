"""Samples that come twice: all words alike to the bit.

Chance does so too where counts are coarse. How often is found window by window from how often
each axis repeats itself, the axes being independent; where the board has an accelerometer
all six words have to be alike, which chance hardly ever does.
"""

import numpy as np

from gyrorig_solver.arrays import BoolArray, IntArray
from gyrorig_solver.raw.result import CHANCE, WINDOW, Look, RawFinding, Stream, poisson_tail

CHECK = "repeated samples"
SLACK = 1.25  # axes are not wholly independent: one motion drives them all
FEWEST = 3
REMEDY = (
    "read the sensor at its data-ready line or at its own rate, and look for a lossy radio "
    "link that holds the last sample"
)


def look(stream: Stream) -> Look:
    """Count exact repeats, by the rates alone and with the accelerations."""
    flagged = stream.samples.repeated
    rates, by_rates = _counted(stream, with_accel=False)
    best, expected = rates, by_rates
    if stream.samples.accel_m_s2 is not None:
        both, by_both = _counted(stream, with_accel=True)
        if poisson_tail(both.size, by_both) < poisson_tail(rates.size, by_rates):
            best, expected = both, by_both
    chance = poisson_tail(best.size, expected)
    if best.size < FEWEST or chance > CHANCE:
        if not flagged:
            return Look(CHECK, f"{rates.size} repeats of all three words, {by_rates:.1f} by chance")
        best, chance = np.zeros(flagged, dtype=np.int64), 0.0
    count = max(int(best.size), flagged)
    share = count / stream.size
    said = f"{count} of {stream.size} samples ({100.0 * share:.2g} %) repeat the one before"
    if expected >= 0.5:
        said += f"; chance makes {expected:.1f}"
    return Look(
        CHECK,
        said,
        (
            RawFinding(
                cause="repeated_samples",
                part="clock",
                where=(),
                count=count,
                total=stream.size,
                p_value=chance,
                name="share",
                size=share,
                unit="1",
                seen_as=said,
                remedy=REMEDY,
                times_s=stream.times_s(best),
            ),
        ),
    )


def _counted(stream: Stream, with_accel: bool) -> tuple[IntArray, float]:
    """Return which samples repeat the one before, and how many do so by chance."""
    found, expected = [np.zeros(0, dtype=np.int64)], 0.0
    acceleration = stream.samples.accel_m_s2 if with_accel else None
    for rows, counts in stream.pieces():
        same: BoolArray = np.diff(counts, axis=0) == 0
        if acceleration is not None:
            same = np.hstack([same, np.diff(acceleration[rows], axis=0) == 0])
        found.append(rows.start + 1 + np.flatnonzero(same.all(axis=1)))
        for start in range(0, same.shape[0], WINDOW):
            part = same[start : start + WINDOW]
            expected += float(np.prod(part.mean(axis=0))) * part.shape[0]
    again = np.unique(np.concatenate(found))
    return again, SLACK * expected
