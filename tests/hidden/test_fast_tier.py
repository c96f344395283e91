"""A few sessions of the fast tier: the finder as it ships meets the goals, worse finders do not.

Sessions come from fast_tier.json: what the truth drew and sized (`make.py --tier ladder
--rungs 3`, `--tier nulls`, `--tier outside`), recorded anew by another process. The bars are
those of the long tier, `scoring/goals.py`: of so few sessions they allow hardly a miss.
The whole tier is in test_whole_fast_tier.py.
"""

from collections.abc import Iterator

import pytest
from tests.hidden.fast import Sessions, sessions
from tests.hidden.scoring import goals
from tests.hidden.scoring.figures import figures, missed
from tests.hidden.scoring.variants import REAL, VARIANTS

NULLS = [line for line in sessions() if line["kind"] == "null"]
CAUSES = [line for line in sessions() if line["kind"] == "one"]
OUTSIDE = [line for line in sessions() if line["kind"] == "outside"]
# A few of each, on which the finder as it ships makes no mistake and a worse one does.
FEW = ("axis_nonorthogonality", "backlash", "board_slip", "scale_quadratic")
WANDERING = (17, 22)  # nulls whose bias wanders enough to matter
# An upper limit needs more than a few.
BARS = [goal for goal in goals.GOALS if goal.name != "false_alarms_upper"]
SMALL = [
    *NULLS[:1],
    *(line for line in NULLS if line["seed"] in WANDERING),
    *(line for line in CAUSES if line["cause"] in FEW),
    *OUTSIDE[:1],
]


@pytest.fixture(scope="module")
def recorded_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    made = Sessions(tmp_path_factory.mktemp("fast"), SMALL)
    yield made
    made.close()


def test_every_cause_that_can_be_sized_is_in_the_tier() -> None:
    assert len(NULLS) == 20
    assert len({line["cause"] for line in CAUSES}) == len(CAUSES) >= 30
    # Steps are lost whole: a single one may be more than was asked for.
    assert all(line["times"] is None or line["times"] > 2.9 for line in CAUSES)


@pytest.mark.long
def test_the_finder_as_it_ships_meets_the_goals_on_a_few(recorded_sessions: Sessions) -> None:
    assert missed(figures([recorded_sessions.outcome(line) for line in SMALL]), BARS) == []


@pytest.mark.long
@pytest.mark.parametrize("variant", sorted(set(VARIANTS) - {REAL}))
def test_a_finder_made_worse_misses_a_goal(recorded_sessions: Sessions, variant: str) -> None:
    outcomes = []
    for line in SMALL:
        outcomes.append(recorded_sessions.outcome(line, variant))
        if missed(figures(outcomes), BARS):
            return
    pytest.fail(f"nothing caught a finder that {VARIANTS[variant].words}")
