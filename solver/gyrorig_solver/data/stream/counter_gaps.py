"""Check for lost samples, board restarts and clock steps, by the counters of the board."""

import numpy as np

from gyrorig_solver.data.link_remedies import CLOCK_STEP, LOST_SAMPLES, RESTART
from gyrorig_solver.data.stream.count_stream import CheckResult, CountStream, StreamFinding

CHECK_NAME = "gaps and restarts"


def check_counter_gaps(stream: CountStream) -> CheckResult:
    """Check the sample counter and the segments of the clock."""
    samples, total = stream.samples, stream.size + stream.samples.lost
    findings = []
    if samples.lost:
        share = samples.lost / total
        is_gap = np.diff(samples.number.astype(np.int64)) > 1
        is_gap &= np.diff(samples.segment) == 0
        gaps = np.flatnonzero(is_gap)
        findings.append(
            StreamFinding(
                "lost_samples",
                "clock",
                (),
                samples.lost,
                total,
                0.0,
                "share",
                share,
                "1",
                f"{samples.lost} of {total} samples ({100.0 * share:.2g} %) are missing by the "
                f"board's counter, in {gaps.size} gaps",
                LOST_SAMPLES.for_link(samples.link),
                stream.times_s(gaps + 1),
            )
        )
    clock = samples.clock
    segment_starts = np.flatnonzero(np.diff(samples.segment)) + 1
    if clock.restarts:
        findings.append(
            StreamFinding(
                "board_restart",
                "link",
                (),
                clock.restarts,
                stream.size,
                0.0,
                "count",
                float(clock.restarts),
                "1",
                f"the board restarted {clock.restarts} times",
                RESTART.for_link(samples.link),
                stream.times_s(segment_starts),
            )
        )
    if clock.steps:
        findings.append(
            StreamFinding(
                "clock_step",
                "clock",
                (),
                clock.steps,
                stream.size,
                0.0,
                "count",
                float(clock.steps),
                "1",
                f"the clock of the board or of the host jumped {clock.steps} times without a "
                "gap in the samples",
                CLOCK_STEP.for_link(samples.link),
                stream.times_s(segment_starts),
            )
        )
    summary = "; ".join(finding.seen_as for finding in findings)
    return CheckResult(
        CHECK_NAME, summary or "no sample is missing, no restart, no clock step", tuple(findings)
    )
