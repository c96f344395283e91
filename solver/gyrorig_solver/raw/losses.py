"""Samples that never came, restarts and steps of the board's clock, by its own counters."""

import numpy as np

from gyrorig_solver.raw.result import Look, RawFinding, Stream

CHECK = "gaps and restarts"
LOST_REMEDY = "lower the board's output rate, raise the line's baud rate, or free the host"
RESTART_REMEDY = "check the board's supply and its cable"
STEP_REMEDY = "do not suspend the host, and check the board's firmware"


def look(stream: Stream) -> Look:
    """Say what the sample counter and the clock's segments show."""
    samples, total = stream.samples, stream.size + stream.samples.lost
    found = []
    if samples.lost:
        share = samples.lost / total
        step = np.diff(samples.number.astype(np.int64)) > 1
        step &= np.diff(samples.segment) == 0
        gaps = np.flatnonzero(step)
        found.append(
            RawFinding(
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
                f"board's own count, in {gaps.size} gaps",
                LOST_REMEDY,
                stream.times_s(gaps + 1),
            )
        )
    clock = samples.clock
    begins = np.flatnonzero(np.diff(samples.segment)) + 1
    if clock.restarts:
        found.append(
            RawFinding(
                "board_restart",
                "link",
                (),
                clock.restarts,
                stream.size,
                0.0,
                "count",
                float(clock.restarts),
                "1",
                f"the board started anew {clock.restarts} times",
                RESTART_REMEDY,
                stream.times_s(begins),
            )
        )
    if clock.steps:
        found.append(
            RawFinding(
                "clock_step",
                "clock",
                (),
                clock.steps,
                stream.size,
                0.0,
                "count",
                float(clock.steps),
                "1",
                f"the board's clock or the host's jumped {clock.steps} times while samples ran on",
                STEP_REMEDY,
                stream.times_s(begins),
            )
        )
    said = "; ".join(one.seen_as for one in found)
    return Look(CHECK, said or "no sample is missing, no restart, no step", tuple(found))
