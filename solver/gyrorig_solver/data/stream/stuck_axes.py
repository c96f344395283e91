"""Check for axes that stay at one count: stuck axes and clipping at full scale.

A run of equal counts is reported if the noise of the axis makes such a run with a probability
below 1e-9. A run at the highest or lowest count of the axis is clipping.
"""

import math

import numpy as np

from gyrorig_solver.data.stream.count_stream import (
    AXES,
    CheckResult,
    CountStream,
    StreamFinding,
    true_runs,
)

STUCK_CHECK_NAME, CLIPPING_CHECK_NAME = "stuck axes", "clipping"
MAX_RUN_PROBABILITY = 1e-9
MIN_RUN_LENGTH = 8
STUCK_REMEDY = "check the register address and the power mode of that axis, and the sensor itself"
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


def _check_axis(stream: CountStream, axis: int) -> tuple[list[StreamFinding], list[StreamFinding]]:
    share = float(stream.repeat_share[axis])
    min_length = max(
        MIN_RUN_LENGTH, math.ceil(math.log(MAX_RUN_PROBABILITY / stream.size) / math.log(share))
    )
    lowest, highest = stream.samples.counts[:, axis].min(), stream.samples.counts[:, axis].max()
    if lowest == highest:
        if stream.samples.counts.min() == stream.samples.counts.max():
            return [], []  # no axis has a signal; this is not a defect of one axis
        return [_stuck_axis_finding(stream, axis, stream.size, (0.0,))], []
    stuck_count, clipped_count = 0, 0
    stuck_rows: list[int] = []
    clipped_rows: list[int] = []
    for rows, counts in stream.pieces():
        is_repeat = np.diff(counts, axis=0) == 0
        for first, stop in true_runs(is_repeat[:, axis]):
            length = stop - first + 1
            if length < min_length:
                continue
            value, row = counts[first, axis], rows.start + first
            if value in (lowest, highest):
                clipped_count += length
                clipped_rows.append(row)
            elif not is_repeat[first:stop, (axis + 1) % 3].all():
                stuck_count += length
                stuck_rows.append(row)
    stuck = (
        [_stuck_axis_finding(stream, axis, stuck_count, stream.times_s(np.array(stuck_rows)))]
        if stuck_count
        else []
    )
    clipped = []
    if clipped_count:
        limit = max(abs(int(lowest)), abs(int(highest))) * stream.samples.quantum_rad_s
        clipped = [
            _clipping_finding(
                stream, axis, clipped_count, limit, stream.times_s(np.array(clipped_rows))
            )
        ]
    return stuck, clipped


def _stuck_axis_finding(
    stream: CountStream, axis: int, count: int, times_s: tuple[float, ...]
) -> StreamFinding:
    share = count / stream.size
    return StreamFinding(
        "stuck_axis", "sensor", (AXES[axis],), count, stream.size, MAX_RUN_PROBABILITY,
        "share", share, "1",
        f"axis {AXES[axis]} keeps the same count for {count} samples "
        f"({100.0 * share:.2g} %) while the other axes change",
        STUCK_REMEDY, times_s,
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
    limit = (
        float(np.abs(samples.counts[unusable_rows].astype(np.int64)).max()) * samples.quantum_rad_s
    )
    return StreamFinding(
        "saturation", "sensor", (), count, stream.size, 0.0, "limit", limit, "rad/s",
        f"{count} samples are at the end of the sensor's range, {math.degrees(limit):.4g} deg/s",
        CLIPPING_REMEDY, stream.times_s(unusable_rows),
    )  # fmt: skip
