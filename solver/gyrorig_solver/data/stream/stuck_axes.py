"""Check for axes that stay at one count: stuck axes and clipping at full scale.

A run of equal counts is reported if the noise of the axis makes such a run with a probability
below 1e-9. A run at the highest or lowest count of the axis is clipping.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data.arrays import BoolArray
from gyrorig_solver.data.link_remedies import STUCK_AXIS
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.data.stream.count_stream import (
    AXES,
    MIN_MOTION_STEPS,
    PIECE_ROWS,
    CheckResult,
    CountStream,
    StreamFinding,
    replace_usable,
    true_runs,
)

STUCK_CHECK_NAME, CLIPPING_CHECK_NAME = "stuck axes", "clipping"
MAX_RUN_PROBABILITY = 1e-9
MIN_RUN_LENGTH = 8
CLIPPING_MARGIN_S = 0.1
CLIPPING_REMEDY = "use a larger full scale, or turn more slowly"


def check_stuck_axes(stream: CountStream) -> tuple[CheckResult, CheckResult]:
    """Check for stuck axes and for clipping."""
    stuck, clipped = [], []
    for axis in range(3):
        stuck_findings, clipping_findings = _check_axis(stream, axis)
        stuck += stuck_findings
        clipped += clipping_findings
    reported = _saturation_status_finding(stream)
    if reported is not None and not clipped:
        clipped = [reported]
    return (
        CheckResult(
            STUCK_CHECK_NAME,
            _join_descriptions(stuck) or "no axis is stuck",
            tuple(stuck),
        ),
        CheckResult(
            CLIPPING_CHECK_NAME,
            _join_descriptions(clipped) or "no axis stays at its highest or lowest value",
            tuple(clipped),
        ),
    )


def _join_descriptions(findings: list[StreamFinding]) -> str:
    return "; ".join(finding.seen_as for finding in findings)


def without_clipping(samples: GyroSamples) -> GyroSamples:
    """Return samples with clipped ones, and their neighbours, marked as not usable.

    A sample is clipped if a rate is at the end at which its axis stays: the true rate is larger.
    Near that end, only samples with a negative noise are not clipped. Samples that are less than
    `CLIPPING_MARGIN_S` from a clipped one are therefore not usable either.
    """
    stream = CountStream(samples)
    clipped = np.zeros(stream.size, dtype=np.bool_)
    for axis in range(3):
        for limit in {run.value for run in _long_runs(stream, axis) if run.is_extreme}:
            for start in range(0, stream.size, PIECE_ROWS):
                rows = slice(start, start + PIECE_ROWS)
                clipped[rows] |= samples.counts[rows, axis] == limit
    if not clipped.any():
        return samples
    margin = math.ceil(CLIPPING_MARGIN_S / samples.period_s)
    return replace_usable(samples, samples.usable & ~_widen(clipped, margin))


def require_changing_axes(samples: GyroSamples) -> None:
    """Raise an error if an axis keeps one value although another axis shows a motion.

    Such an axis did not measure, and a fit to the motion would state a gain of zero. At rest, a
    value that does not change can be right, because noise below the rounding does not show.

    Raises:
        InputError: an axis did not measure.
    """
    stream = CountStream(samples)
    counts = samples.counts
    span = counts.max(axis=0).astype(np.int64) - counts.min(axis=0)
    is_still = span == 0
    if is_still.any() and np.any(span > MIN_MOTION_STEPS * np.maximum(stream.count_step, 1)):
        names = " and ".join(AXES[k] for k in np.flatnonzero(is_still))
        raise InputError(
            f"axis {names} of board {samples.board} keeps the same value for all {stream.size} "
            "samples while another axis turns, so it did not measure",
            STUCK_AXIS.for_link(samples.link),
        )


def _widen(mask: BoolArray, margin: int) -> BoolArray:
    """Return which samples are at most `margin` samples from a sample of a mask."""
    count = np.cumsum(np.pad(mask, margin, mode="constant"), dtype=np.int32)
    before = np.concatenate([[0], count])[: mask.size]
    return np.asarray(count[2 * margin :] - before > 0, dtype=np.bool_)


@dataclass(frozen=True, slots=True)
class _Run:
    """Successive equal counts of an axis, more than its noise makes by chance."""

    row: int  # of the first count
    length: int
    value: int  # counts
    is_extreme: bool  # the highest or lowest count of the axis
    others_change: bool  # whether another axis changes during the run


def _long_runs(stream: CountStream, axis: int) -> list[_Run]:
    """Return the runs of equal counts that the noise of an axis does not explain."""
    share = float(stream.repeat_share[axis])
    min_length = max(
        MIN_RUN_LENGTH, math.ceil(math.log(MAX_RUN_PROBABILITY / stream.size) / math.log(share))
    )
    lowest, highest = stream.samples.counts[:, axis].min(), stream.samples.counts[:, axis].max()
    if lowest == highest:
        return []
    runs = []
    for rows, counts in stream.pieces():
        is_repeat = np.diff(counts, axis=0) == 0
        for first, stop in true_runs(is_repeat[:, axis]):
            length = stop - first + 1
            if length < min_length:
                continue
            value = int(counts[first, axis])
            others = [other for other in range(3) if other != axis]
            others_change = not is_repeat[first:stop, others].all(axis=0).all()
            is_extreme = value in (lowest, highest)
            runs.append(_Run(rows.start + first, length, value, is_extreme, others_change))
    return runs


def _check_axis(stream: CountStream, axis: int) -> tuple[list[StreamFinding], list[StreamFinding]]:
    counts = stream.samples.counts
    if counts[:, axis].min() == counts[:, axis].max():
        if counts.min() == counts.max():
            return [], []  # no axis has a signal; this is not a defect of one axis
        return [_stuck_axis_finding(stream, axis, stream.size, (0.0,))], []
    runs = _long_runs(stream, axis)
    clipped_runs = [run for run in runs if run.is_extreme]
    stuck_runs = [run for run in runs if not run.is_extreme and run.others_change]
    stuck, clipped = [], []
    if stuck_runs:
        stuck = [
            _stuck_axis_finding(
                stream, axis, sum(run.length for run in stuck_runs), _times_s(stream, stuck_runs)
            )
        ]
    if clipped_runs:
        limit = max(abs(run.value) for run in clipped_runs) * stream.samples.gyro.scale
        clipped = [
            _clipping_finding(
                stream,
                axis,
                sum(run.length for run in clipped_runs),
                limit,
                _times_s(stream, clipped_runs),
            )
        ]
    return stuck, clipped


def _times_s(stream: CountStream, runs: Sequence[_Run]) -> tuple[float, ...]:
    return stream.times_s(np.array([run.row for run in runs]))


def _stuck_axis_finding(
    stream: CountStream, axis: int, count: int, times_s: tuple[float, ...]
) -> StreamFinding:
    share = count / stream.size
    return StreamFinding(
        "stuck_axis", "sensor", (AXES[axis],), count, stream.size, MAX_RUN_PROBABILITY,
        "share", share, "1",
        f"axis {AXES[axis]} keeps the same count for {count} samples "
        f"({100.0 * share:.3g} %) while the other axes change",
        STUCK_AXIS.for_link(stream.samples.link), times_s,
    )  # fmt: skip


def _clipping_finding(
    stream: CountStream, axis: int, count: int, limit_rad_s: float, times_s: tuple[float, ...]
) -> StreamFinding:
    return StreamFinding(
        "saturation", "sensor", (AXES[axis],), count, stream.size, MAX_RUN_PROBABILITY, "limit",
        limit_rad_s, "rad/s",
        f"axis {AXES[axis]} stays at its extreme of {math.degrees(limit_rad_s):.4g} deg/s for "
        f"{count} samples, because the motion is clipped there",
        CLIPPING_REMEDY, times_s,
    )  # fmt: skip


def _saturation_status_finding(stream: CountStream) -> StreamFinding | None:
    """Return a finding from the saturation status of the board, None without saturation."""
    samples = stream.samples
    unusable_rows = np.flatnonzero(~samples.usable)
    count = max(0, int(unusable_rows.size) - samples.repeated)
    if not count:
        return None
    limit = float(np.abs(samples.counts[unusable_rows].astype(np.int64)).max()) * samples.gyro.scale
    return StreamFinding(
        "saturation", "sensor", (), count, stream.size, 0.0, "limit", limit, "rad/s",
        f"{count} samples are at the end of the sensor's range, {math.degrees(limit):.4g} deg/s",
        CLIPPING_REMEDY, stream.times_s(unusable_rows),
    )  # fmt: skip
