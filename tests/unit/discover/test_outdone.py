"""A name that a free function of what is left makes needless is not said."""

from collections.abc import Callable

import pytest
from tests.support.board_fits import fit_base_model
from tests.unit.discover.conftest import HiddenRecording

from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_ranking import rank_against_alternatives
from gyrorig_solver.discover.cause_search import SearchResult
from gyrorig_solver.discover.checks.model_check import JudgedModel
from gyrorig_solver.discover.checks.redundancy import (
    dominated_by_nonparametric,
    find_partial_explanations,
)
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue

TESTS = 60
OF_RATES = DependenceTest("own_rate", "on the rates about the axes", 200.0, 24, 0.0)


def _named(hidden: HiddenRecording, cause: str) -> JudgedModel[MotionFitSpace]:
    """Return where a search ends that knows this cause alone."""
    base = fit_base_model([hidden.recording], hidden.board)
    term = catalogue()[cause]
    projector = NuisanceProjector.at_fit(base)
    best = fit_best_place(
        projector, scan_catalogue(projector, [term], TESTS, all_templates(projector, term))
    )
    assert best is not None
    space = MotionFitSpace(base).refit([best[0].extension])
    standing = rank_against_alternatives(space, 0, [term], TESTS)
    return JudgedModel(
        MotionFitSpace(base), SearchResult(space, (standing,), space.projector(), ())
    )


@pytest.mark.long
def test_a_slip_is_not_said_for_what_hangs_on_the_rates(
    hidden: Callable[..., HiddenRecording],
) -> None:
    named = _named(hidden("scale_asymmetry:0.01"), "board_slip")
    assert named.result.ranked_causes[0].candidate.delta_log_likelihood > 20.0  # nats
    assert find_partial_explanations(named, [OF_RATES]) == [
        False
    ]  # the rest is none of its own kind
    assert dominated_by_nonparametric(named, [OF_RATES]) == [True]


@pytest.mark.long
def test_a_right_name_beside_what_hangs_on_the_rates_is_said(
    hidden: Callable[..., HiddenRecording],
) -> None:
    named = _named(hidden("eccentricity@pan:0.002", "scale_quadratic:0.003"), "eccentricity")
    assert dominated_by_nonparametric(named, [OF_RATES]) == [False]
