"""An axis that stands still while the others go on: stuck, or cut off at the top.

A run of equal counts is odd where the axis' own noise makes such runs less than once in a
thousand million recordings. At the axis' own highest or lowest value it is a flat top.
"""

import math

import numpy as np

from gyrorig_solver.raw.result import AXES, Look, RawFinding, Stream, runs

STUCK_CHECK, TOP_CHECK = "stuck axes", "flat tops"
CHANCE = 1e-9
SHORTEST = 8
STUCK_REMEDY = "look at that axis' register address and power mode, and at the part itself"
TOP_REMEDY = "use a larger full scale, or turn slower"


def look(stream: Stream) -> tuple[Look, Look]:
    """Look for axes that stand still, and for flat tops."""
    stuck, tops = [], []
    for axis in range(3):
        found, flat = _axis(stream, axis)
        stuck += found
        tops += flat
    told = _told(stream)
    if told is not None and not tops:
        tops = [told]
    return (
        Look(STUCK_CHECK, _said(stuck) or "every axis lives all the time", tuple(stuck)),
        Look(TOP_CHECK, _said(tops) or "no axis stays at its highest or lowest value", tuple(tops)),
    )


def _said(findings: list[RawFinding]) -> str:
    return "; ".join(one.seen_as for one in findings)


def _axis(stream: Stream, axis: int) -> tuple[list[RawFinding], list[RawFinding]]:
    share = float(stream.still_share[axis])
    least = max(SHORTEST, math.ceil(math.log(CHANCE / stream.size) / math.log(share)))
    lowest, highest = stream.samples.counts[:, axis].min(), stream.samples.counts[:, axis].max()
    if lowest == highest:
        if stream.samples.counts.min() == stream.samples.counts.max():
            return [], []  # nothing at all: no board's fault to name by itself
        return [_stuck(stream, axis, stream.size, (0.0,))], []
    still, top = 0, 0
    still_at: list[int] = []
    top_at: list[int] = []
    for rows, counts in stream.pieces():
        same = np.diff(counts, axis=0) == 0
        for first, stop in runs(same[:, axis]):
            length = stop - first + 1
            if length < least:
                continue
            value, at = counts[first, axis], rows.start + first
            if value in (lowest, highest):
                top += length
                top_at.append(at)
            elif not same[first:stop, (axis + 1) % 3].all():
                still += length
                still_at.append(at)
    stuck = [_stuck(stream, axis, still, stream.times_s(np.array(still_at)))] if still else []
    tops = []
    if top:
        limit = max(abs(int(lowest)), abs(int(highest))) * stream.samples.quantum_rad_s
        tops = [_top(stream, axis, top, limit, stream.times_s(np.array(top_at)))]
    return stuck, tops


def _stuck(stream: Stream, axis: int, count: int, times_s: tuple[float, ...]) -> RawFinding:
    share = count / stream.size
    return RawFinding(
        "stuck_axis", "sensor", (AXES[axis],), count, stream.size, CHANCE, "share", share, "1",
        f"axis {AXES[axis]} gives one and the same count for {count} samples "
        f"({100.0 * share:.2g} %) while the others go on",
        STUCK_REMEDY, times_s,
    )  # fmt: skip


def _top(
    stream: Stream, axis: int, count: int, limit_rad_s: float, times_s: tuple[float, ...]
) -> RawFinding:
    return RawFinding(
        "saturation", "sensor", (AXES[axis],), count, stream.size, CHANCE, "limit",
        limit_rad_s, "rad/s",
        f"axis {AXES[axis]} stays at its extreme of {math.degrees(limit_rad_s):.4g} deg/s for "
        f"{count} samples: the tops of the motion are cut off",
        TOP_REMEDY, times_s,
    )  # fmt: skip


def _told(stream: Stream) -> RawFinding | None:
    """Return what the board's own status says of the end of its range."""
    samples = stream.samples
    bad = np.flatnonzero(~samples.good)
    count = max(0, int(bad.size) - samples.repeated)
    if not count:
        return None
    limit = float(np.abs(samples.counts[bad].astype(np.int64)).max()) * samples.quantum_rad_s
    return RawFinding(
        "saturation", "sensor", (), count, stream.size, 0.0, "limit", limit, "rad/s",
        f"{count} samples are at the end of the sensor's range, {math.degrees(limit):.4g} deg/s",
        TOP_REMEDY, stream.times_s(bad),
    )  # fmt: skip
