"""Several recordings of one board: what happened in one of them, and what all of them have."""

from collections.abc import Callable
from typing import Any

import pytest
from tests.support.board_fits import explain_recordings

from gyrorig_solver.discover import NamedCause
from gyrorig_solver.findings import build_findings_document
from gyrorig_solver.findings.findings_builder import FindingsOrigin
from gyrorig_solver.findings.findings_document import BoardEntry

pytestmark = pytest.mark.long

FAR = 4.0  # standard deviations


def test_a_step_is_found_in_the_recording_in_which_it_was(hidden: Callable[..., Any]) -> None:
    plain, stepped = hidden(program="survey-40"), hidden("bias_step:0.01")
    explained = explain_recordings([plain.recording, stepped.recording], plain.board)
    (named,) = explained.findings.causes
    assert named.candidates == ("bias_step",)
    name = stepped.recording.path.name
    assert named.recording == name
    assert named.sentence.endswith(f", in {name}")
    # The time is that recording's own: the same as where it is looked at alone.
    (alone,) = explain_recordings([stepped.recording], stepped.board).findings.causes
    assert alone.recording is None
    time_s, alone_s = ({v.name: v.value for v in cause.values}["time"] for cause in (named, alone))
    assert time_s == pytest.approx(alone_s, abs=0.5)
    origin = FindingsOrigin(BoardEntry("GY80-1", ""), [], "2026-01-31T02:30:00Z", "0")
    (cause,) = build_findings_document(explained.findings, [], origin).causes
    assert cause.recording == name


def _named(explained: Any, cause: str) -> NamedCause:
    (named_cause,) = (named for named in explained.findings.causes if named.cause == cause)
    assert isinstance(named_cause, NamedCause)
    return named_cause


def test_what_all_have_is_known_the_better_for_it(hidden: Callable[..., Any]) -> None:
    hide = "worm_error@pan:0.0006"
    first, two = hidden(hide, program="survey-40"), hidden(hide)
    alone = _named(explain_recordings([first.recording], first.board), "worm_error")
    both = _named(explain_recordings([first.recording, two.recording], first.board), "worm_error")
    assert both.recording is None
    assert set(both.where) == {"pan"}
    better = 0
    for single, joint in zip(alone.values, both.values, strict=True):
        if single.std < float("inf"):
            assert joint.value == pytest.approx(single.value, abs=FAR * single.std)
            better += joint.std < single.std
    assert better
