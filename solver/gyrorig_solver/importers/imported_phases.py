"""Rests and known turns of an import: the samples that they contain, and their times.

What to use when: `find_phases` for the phases of one board, by the times of its samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import IntArray
from gyrorig_solver.importers.import_times import nanoseconds
from gyrorig_solver.importers.measured_streams import MeasuredPhase
from gyrorig_solver.importers.sample_encoding import ImuStream

# A turn that begins earlier, or ends later, than the samples by more than this is refused. It is
# the largest gap in a turn that the solver accepts.
MAX_OUTSIDE_S = 0.1


@dataclass(frozen=True, slots=True)
class SessionPhase:
    """One phase of the session."""

    name: str  # "static" or "turn"
    begin_ns: int
    end_ns: int
    text: str = ""


def find_phases(
    phases: Sequence[MeasuredPhase], imu: ImuStream, sample_ns: IntArray
) -> list[SessionPhase]:
    """Return the phases in the order of their samples.

    A phase lasts from its first sample to its last one. If a known turn begins or ends in a gap of
    the samples, it keeps its stated begin or end, because the board turns in the gap, too.

    Args:
        phases: rests and known turns of one board.
        imu: the samples of this board.
        sample_ns: the times of these samples, shape (n,).

    Raises:
        InputError: a phase is outside the data, or contains too few samples.
    """
    parts = sorted(
        ((*_find_samples(phase, imu), phase) for phase in phases), key=lambda part: part[:2]
    )
    session_phases = []
    for first, last, phase in parts:
        begin_ns, end_ns = int(sample_ns[first]), int(sample_ns[last])
        if phase.name == "turn":
            begin_ns = _turn_begin_ns(phase, first, imu, sample_ns)
            end_ns = _turn_end_ns(phase, last, imu, sample_ns)
        session_phases.append(SessionPhase(phase.name, begin_ns, end_ns, phase.text))
    return session_phases


def _find_samples(phase: MeasuredPhase, imu: ImuStream) -> tuple[int, int]:
    """Return the first and the last sample that a phase contains.

    Raises:
        InputError: it is outside the data, or contains too few samples.
    """
    span = phase.span
    first, end = 0, imu.row.size
    if span.start is not None:
        first = int(np.searchsorted(imu.row, span.start))
    if span.end is not None:
        if span.end > imu.row[-1] + 1:
            raise InputError(
                f"a {phase.name} section ends at row {span.end}, but the last row of the data is "
                f"row {imu.row[-1]}",
                "correct the end of the section in the import map",
            )
        end = int(np.searchsorted(imu.row, span.end))
    if span.begin_s is not None:
        first = max(first, int(np.searchsorted(imu.time_s, span.begin_s)))
    if span.end_s is not None:
        end = min(end, int(np.searchsorted(imu.time_s, span.end_s)))
    if end - first < 2:
        raise InputError(
            f"the {phase.name} section from sample {first} to sample {end} contains too few "
            "samples",
            "correct the start and the end of the section in the import map",
        )
    return first, end - 1


def _turn_begin_ns(phase: MeasuredPhase, first: int, imu: ImuStream, sample_ns: IntArray) -> int:
    """Return the begin of a turn: its first sample, or earlier in a gap before this sample."""
    first_ns, period_ns = int(sample_ns[first]), _period_ns(sample_ns)
    stated_ns = []
    if phase.span.begin_s is not None:
        outside_s = float(imu.time_s[0]) - phase.span.begin_s
        _check_outside(outside_s, period_ns, "begins", "before the first")
        stated_ns.append(_time_ns(phase.span.begin_s, imu))
    if phase.span.start is not None:
        outside_s = 1e-9 * (int(imu.row[0]) - phase.span.start) * period_ns
        _check_outside(outside_s, period_ns, "begins", "before the first")
        stated_ns.append(first_ns - (int(imu.row[first]) - phase.span.start) * period_ns)
    if not stated_ns:
        return first_ns
    begin_ns = max(stated_ns)
    if first > 0:  # a sample represents one period
        begin_ns = max(begin_ns, int(sample_ns[first - 1]) + period_ns)
    return min(begin_ns, first_ns)


def _turn_end_ns(phase: MeasuredPhase, last: int, imu: ImuStream, sample_ns: IntArray) -> int:
    """Return the end of a turn: its last sample, or later in a gap after this sample."""
    last_ns, period_ns = int(sample_ns[last]), _period_ns(sample_ns)
    stated_ns = []
    if phase.span.end_s is not None:
        outside_s = phase.span.end_s - float(imu.time_s[-1])
        _check_outside(outside_s, period_ns, "ends", "after the last")
        stated_ns.append(_time_ns(phase.span.end_s, imu))
    if phase.span.end is not None:
        stated_ns.append(last_ns + (phase.span.end - 1 - int(imu.row[last])) * period_ns)
    if not stated_ns:
        return last_ns
    end_ns = min(stated_ns)
    if last + 1 < sample_ns.size:
        end_ns = min(end_ns, int(sample_ns[last + 1]) - period_ns)
    return max(end_ns, last_ns)


def _check_outside(outside_s: float, period_ns: int, what: str, where: str) -> None:
    """Check that the samples reach the begin or the end of a turn.

    Raises:
        InputError: they do not, so the total angle of the turn would be too small.
    """
    if outside_s > max(MAX_OUTSIDE_S, 1e-9 * period_ns):
        raise InputError(
            f"a turn section {what} {outside_s:.4g} s {where} sample that has a rate, so "
            "the samples do not contain the whole turn",
            "correct the start and the end of the section in the import map, or remove the turn",
        )


def _period_ns(sample_ns: IntArray) -> int:
    return int(np.median(np.diff(sample_ns)))


def _time_ns(time_s: float, imu: ImuStream) -> int:
    """Return a time of the source on the time axis of the recording, ns."""
    origin_ns = int(imu.host_time_ns[0]) - int(nanoseconds(imu.time_s[:1])[0])
    return origin_ns + int(nanoseconds(np.array([time_s]))[0])
