"""The whole fast tier: nulls, every cause once at three times its detectable size, effects outside.

The sessions and the bars are those of test_fast_tier.py.
"""

import math
from collections.abc import Iterator

import pytest
from tests.hidden.fast import Line, Sessions, name_of, sessions
from tests.hidden.scoring import goals
from tests.hidden.scoring.figures import sole_right

pytestmark = pytest.mark.long
NULLS = [line for line in sessions() if line["kind"] == "null"]
CAUSES = [line for line in sessions() if line["kind"] == "one"]
OUTSIDE = [line for line in sessions() if line["kind"] == "outside"]

# What the finder gets wrong: each a miss of a goal, told in docs/discovery-scores.md. Whoever
# mends one takes its line out.
KNOWN = {
    "step_resolution": "called tilt's sag or eccentricity, from which this motion hardly tells it",
}
NOT_ALONE = {*KNOWN, "bias_ramp", "warm_up"}  # a ramp and a long warm-up: one set of the two


def known(line: Line) -> object:
    reason = KNOWN.get(str(line["cause"]))
    marks = [pytest.mark.xfail(reason=reason, strict=True)] if reason else []
    return pytest.param(line, marks=marks, id=str(line["cause"]))


@pytest.fixture(scope="module")
def recorded_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    made = Sessions(tmp_path_factory.mktemp("fast"), sessions())
    yield made
    made.close()


@pytest.mark.parametrize("line", NULLS, ids=name_of)
def test_no_false_alarm_on_a_null(recorded_sessions: Sessions, line: Line) -> None:
    """Of 20, one in a hundred allows none."""
    outcome = recorded_sessions.outcome(line)
    assert not outcome.alarmed, (outcome.sets, outcome.rest)


@pytest.mark.parametrize("line", [known(line) for line in CAUSES])
def test_a_cause_is_found_and_no_other_is_named(recorded_sessions: Sessions, line: Line) -> None:
    outcome = recorded_sessions.outcome(line)
    assert outcome.alarmed
    assert not outcome.misled, outcome.sets


def not_alone(recorded_sessions: Sessions) -> set[str]:
    """Return the causes whose name was not right, or not the only one."""
    return {
        str(line["cause"]) for line in CAUSES if not sole_right(recorded_sessions.outcome(line))
    }


def test_no_other_cause_lacks_its_right_name(recorded_sessions: Sessions) -> None:
    assert not_alone(recorded_sessions) - NOT_ALONE == set()


@pytest.mark.xfail(condition=bool(KNOWN), reason="see KNOWN", strict=True)
def test_causes_have_their_right_name_alone(recorded_sessions: Sessions) -> None:
    assert len(not_alone(recorded_sessions)) <= math.floor((1.0 - goals.SOLE_RIGHT) * len(CAUSES))


@pytest.mark.parametrize("line", OUTSIDE, ids=lambda line: str(line["shape"]))
def test_what_is_in_no_catalogue_gets_no_name(recorded_sessions: Sessions, line: Line) -> None:
    outcome = recorded_sessions.outcome(line)
    assert not outcome.wrong_sole, outcome.sets
    assert outcome.rest
