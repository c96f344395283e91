"""A session that a fault interrupted, in the solver: the data after the fault are excluded.

Row 2 of docs/faults.md.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_protocol.recording.messages import EventKind, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.check import examine_recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.reference import read_pan_tilt_reference

PROGRAM = """
name: broken-off
steps:
  - rest: {seconds: 2.0, phase: static}
  - move: {pan_deg: 20.0, speed_deg_s: 20.0}
  - move: {pan_deg: 150.0, speed_deg_s: 10.0}
"""
FAULT_S = 9.0  # after the daemon's start, in the last move
AWAY_S = 60.0


def pull(bench: Any) -> None:
    begin_ns = bench.hub.now_ns()
    bench.hub.unplug("ptu", begin_ns + int(FAULT_S * 1e9), begin_ns + int((FAULT_S + AWAY_S) * 1e9))


def meet_a_limit(bench: Any) -> None:
    bench.at(FAULT_S, lambda: bench.hub._push(bench.hub.now_ns(), "ptu", b"!P"))


LIMIT = pytest.param(
    meet_a_limit,
    marks=pytest.mark.xfail(
        strict=True,
        reason="the orders of a unit that reached a limit are not believed, its counts alone show "
        "a fifth of the time before",
    ),
)


def broken_off(make_bench: Callable[..., Any], break_off: Callable[[Any], None]) -> Any:
    """A session with a fault in its last move, and when that was, s on the samples' axis."""
    bench = make_bench()
    bench.put(PROGRAM)
    break_off(bench)
    bench.serve(40.0)
    recording = read_recording(*bench.recordings())
    (board,) = recording.board_ids
    faults_ns = [
        int(event.host_time_ns)
        for event in recording.messages("/session/event")
        if isinstance(event, SessionEvent) and event.kind == EventKind.FAULT
    ]
    samples = load_samples(recording, board)
    broke_off_s = (faults_ns[0] - samples.origin_ns) * 1e-9
    last_s = float(samples.time_s[-1])
    assert last_s > broke_off_s + 5.0  # the recording goes on
    return recording, samples, broke_off_s


@pytest.mark.parametrize(
    ("break_off", "words"), [(pull, "disconnected"), (meet_a_limit, "reached a limit")]
)
def test_the_solver_leaves_out_what_came_after(
    make_bench: Callable[..., Any], break_off: Callable[[Any], None], words: str
) -> None:
    recording, samples, broke_off_s = broken_off(make_bench, break_off)
    reference = read_pan_tilt_reference(recording, samples.origin_ns)
    after = np.arange(broke_off_s, float(samples.time_s[-1]), 0.01)
    assert np.all(np.isnan(reference.evaluate(after, derivatives=False).rate_rad_s))
    assert any(words in fault for fault in examine_recording(recording, recording.board_ids).faults)


@pytest.mark.parametrize("break_off", [pull, LIMIT])
def test_what_was_before_is_known(
    make_bench: Callable[..., Any], break_off: Callable[[Any], None]
) -> None:
    recording, samples, broke_off_s = broken_off(make_bench, break_off)
    reference = read_pan_tilt_reference(recording, samples.origin_ns)
    before = np.arange(1.0, broke_off_s - 1.0, 0.01)
    known = np.isfinite(reference.evaluate(before, derivatives=False).rate_rad_s).all(axis=1)
    assert known.mean() > 0.9
