"""How well the time of something that happened once is known."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.bench.accuracy.profile import RAD_PER_STEP
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover import explain_fit
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.candidate_objective import CandidateObjective
from gyrorig_solver.discover.exact_fit import FittedCandidate, event_std, fit_candidate
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import find_term


@pytest.fixture(scope="module")
def weighed(hidden: Callable[..., Any]) -> Callable[[str], FittedCandidate]:
    """Return a function that fits the cause that a session hides."""

    def fit(hide: str) -> FittedCandidate:
        session = hidden(hide)
        projection = NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))
        term = find_term(hide.partition(":")[0].partition("@")[0])
        place = fit_best_place(
            projection, scan_catalogue(projection, [term], 1, all_templates(projection, term))
        )
        assert place is not None
        return place[0]

    return fit


@pytest.mark.long
def test_a_loss_in_a_move_is_timed_as_finely_as_its_pulse(
    weighed: Callable[[str], FittedCandidate],
) -> None:
    place = weighed("lost_steps@pan:8")
    assert place.event_std is not None
    assert 1e-6 < place.event_std < 0.01


@pytest.mark.long
def test_a_slip_is_timed_no_finer_than_the_noise_lets_it(
    weighed: Callable[[str], FittedCandidate],
) -> None:
    """A turn of 0.7 deg shows 1 % of a rate elsewhere: the noise hides a good while of it."""
    place = weighed("board_slip:0.012")
    assert place.event_std is not None
    assert 0.01 < place.event_std < 5.0


@pytest.mark.long
def test_a_smaller_step_is_timed_worse(weighed: Callable[[str], FittedCandidate]) -> None:
    large, small = weighed("bias_step:0.01"), weighed("bias_step:0.002")
    assert large.event_std is not None
    assert small.event_std is not None
    assert large.event_std < small.event_std


@pytest.mark.long
def test_a_time_without_information_is_not_known(hidden: Callable[..., Any]) -> None:
    """A pseudo-inverse sets a tiny information to zero, and its inverse too."""
    session = hidden("clock_step:0.01")
    projection = NuisanceProjector.at_fit(fit_base_model([session.recording], session.board))
    candidate = fit_candidate(projection, find_term("clock_step"), None, [np.array([0.01, 19.0])])
    assert candidate is not None
    objective = CandidateObjective(projection, find_term("clock_step"), None)
    free = np.array([*objective.sizes, *objective.events])
    expansion = objective.expand(candidate.extension.values, free)
    lost = np.array([[expansion.curvature[0, 0], 1e-9], [1e-9, 3e-24]])
    assert event_std(objective, replace(expansion, curvature=lost)) > 1e-3


def test_what_is_always_there_has_no_time(weighed: Callable[[str], FittedCandidate]) -> None:
    place = weighed("backlash@tilt:0.0012")
    assert place.event_std is None
    assert np.isfinite(place.std).all()


@pytest.mark.long
def test_a_large_loss_is_fitted_until_its_time_stays(hidden: Callable[..., Any]) -> None:
    """After two fits, the time was wrong by 13 of its standard uncertainties.

    The search then named the low-pass as well, and the angle was 6 standard uncertainties wrong.
    """
    session = hidden("lost_steps@pan:16", seed=52, program="survey-40")
    base = fit_base_model([session.recording], session.board)
    (loss,) = explain_fit(base, session.board).findings.causes
    angle_rad = float(loss.extension.values[0])
    assert abs(angle_rad) == pytest.approx(16.0 * RAD_PER_STEP, abs=4.0 * loss.values[0].std)
