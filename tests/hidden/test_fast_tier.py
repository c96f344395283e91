"""On a few sessions of the fast tier the shipped solver meets the goals, and its variants do not.

The causes and sizes are from fast_tier.json. Its lines are from `make.py --tier ladder --rungs 3`,
`--tier nulls` and `--tier outside`. Another process records the sessions. The goals are those of
the long tier, `scoring/goals.py`; with so few sessions they allow almost no miss.
test_whole_fast_tier.py tests the whole tier.
"""

from collections.abc import Iterator

import pytest
from tests.hidden.fast import Sessions, read_sessions
from tests.hidden.scoring import goals
from tests.hidden.scoring.figures import compute_figures, find_missed_goals
from tests.hidden.scoring.variants import REAL, VARIANTS

NULLS = [line for line in read_sessions() if line["kind"] == "null"]
CAUSES = [line for line in read_sessions() if line["kind"] == "one"]
OUTSIDE = [line for line in read_sessions() if line["kind"] == "outside"]
# A few sessions of each kind. Only the degraded variants make mistakes in them.
FEW = ("axis_nonorthogonality", "backlash", "board_slip", "scale_quadratic")
WANDERING = (17, 22)  # nulls with a large random walk of the bias
# The upper limit needs more sessions.
SMALL_GOALS = [goal for goal in goals.GOALS if goal.name != "false_alarms_upper"]
SMALL = [
    *NULLS[:1],
    *(line for line in NULLS if line["seed"] in WANDERING),
    *(line for line in CAUSES if line["cause"] in FEW),
    *OUTSIDE[:1],
]


@pytest.fixture(scope="module")
def recorded_sessions(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Sessions]:
    sessions = Sessions(tmp_path_factory.mktemp("fast"), SMALL)
    yield sessions
    sessions.close()


def test_every_cause_with_a_size_is_in_the_tier() -> None:
    assert len(NULLS) == 20
    assert len({line["cause"] for line in CAUSES}) == len(CAUSES) >= 30
    # Lost steps are a whole number, so one step may be larger than the wanted size.
    assert all(line["times"] is None or line["times"] > 2.9 for line in CAUSES)


@pytest.mark.long
def test_the_shipped_solver_meets_the_goals(recorded_sessions: Sessions) -> None:
    assert (
        find_missed_goals(
            compute_figures([recorded_sessions.judge(line) for line in SMALL]), SMALL_GOALS
        )
        == []
    )


@pytest.mark.long
@pytest.mark.parametrize("variant", sorted(set(VARIANTS) - {REAL}))
def test_a_degraded_variant_misses_a_goal(recorded_sessions: Sessions, variant: str) -> None:
    outcomes = []
    for line in SMALL:
        outcomes.append(recorded_sessions.judge(line, variant))
        if find_missed_goals(compute_figures(outcomes), SMALL_GOALS):
            return
    pytest.fail(f"no goal is missed by a variant that {VARIANTS[variant].words}")
