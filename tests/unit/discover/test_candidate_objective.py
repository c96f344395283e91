"""The objective of one candidate: trials together, and starts that explain something."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.candidate_objective import CandidateObjective
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import find_term


@pytest.fixture(scope="module")
def projection(hidden: Callable[..., Any]) -> NuisanceProjector:
    """Return the projector at the base fit of a session with a small backlash."""
    session = hidden("backlash@tilt:0.0012")
    return NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))


@pytest.mark.long
@pytest.mark.parametrize("cause", ["clock_step", "clock_sawtooth", "lost_steps"])
def test_trials_together_have_the_statistics_of_single_ones(
    projection: NuisanceProjector, cause: str
) -> None:
    objective = CandidateObjective(projection, find_term(cause), None)
    begin_s, end_s = objective.context.begin_s, objective.context.end_s
    trials = []
    for time_s in np.linspace(begin_s + 2.0, end_s - 2.0, 30):
        trial = np.array([parameter.start for parameter in objective.parameters])
        trial[objective.sizes] = [objective.parameters[k].typical_size for k in objective.sizes]
        trial[objective.events] = time_s
        trials.append(trial)
    single = [objective.score_test(trial) for trial in trials]
    together = list(objective.score_trials(trials))
    assert [test.statistic for test in together] == pytest.approx(
        [test.statistic for test in single], rel=1e-4, abs=1e-3
    )
    for alone, batched in zip(single, together, strict=True):
        assert batched.one_step_sizes == pytest.approx(alone.one_step_sizes, rel=1e-3, abs=1e-9)


def test_a_start_that_is_worse_than_nothing_gets_other_sizes(
    projection: NuisanceProjector,
) -> None:
    """A template of a hundred times the true size explains nothing, but shows the direction."""
    objective = CandidateObjective(projection, find_term("backlash"), "tilt")
    template = np.array([parameter.start for parameter in objective.parameters])
    template[objective.sizes] = 0.12
    assert objective.expand(template, objective.free).cost > 0.0
    start = objective.useful_start(template)
    assert start.cost < 0.0
    assert objective.minimize_from(start, objective.free).values[objective.sizes] == pytest.approx(
        [0.0012], rel=0.1
    )
