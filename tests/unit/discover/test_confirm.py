"""What a fit can do without is no cause, and what it itself can follow is none either."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover import testable_terms
from gyrorig_solver.discover.backward_elimination import eliminate_backward
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.checks.typical_noise import whittle_log_likelihood
from gyrorig_solver.discover.exact_fit import fit_candidate
from gyrorig_solver.discover.extended_fit import GainChange, refit_gain_exactly
from gyrorig_solver.discover.fit_space import SearchEffort
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import ConvergedFit, FittedTerm, NuisanceProjector, refit_with_terms
from gyrorig_solver.model import find_term, value_indices

Fit = Callable[[str], ConvergedFit]


@pytest.fixture(scope="module")
def base(hidden: Callable[..., Any]) -> Fit:
    """Return a function that fits the base model to a session, once each."""
    made: dict[str, ConvergedFit] = {}

    def fit(hide: str) -> ConvergedFit:
        if hide not in made:
            session = hidden(hide) if hide else hidden()
            made[hide] = fit_base_model([session.recording], session.board)
        return made[hide]

    return fit


def term_on_residual(solution: ConvergedFit, cause: str) -> FittedTerm:
    projection, term = NuisanceProjector.at_fit(solution), find_term(cause)
    best = fit_best_place(
        projection, scan_catalogue(projection, [term], 1, all_templates(projection, term))
    )
    assert best is not None
    return best[0].extension


@pytest.mark.long
def test_what_the_fit_can_do_without_is_refused(base: Fit) -> None:
    plain = base("backlash@tilt:0.0012")
    gap = term_on_residual(plain, "backlash")
    worm = find_term("worm_error")
    idle = FittedTerm(
        worm,
        worm.template_bank(NuisanceProjector.at_fit(plain).states[0])[0].copy(),
        np.array([0, 1]),
    )
    terms = testable_terms.testable_terms(NuisanceProjector.at_fit(plain))
    both = MotionFitSpace(refit_with_terms(plain, [gap, idle]))
    reduced = eliminate_backward(both, (), testable_terms.count_tests(terms))
    assert reduced.eliminated == {"worm_error"}
    assert [fitted_term.term.cause for fitted_term in reduced.space.fitted_terms] == ["backlash"]
    assert reduced.delta_log_likelihood["backlash"] > 100.0


@pytest.mark.long
def test_what_stays_needs_a_move_on_either_side(base: Fit) -> None:
    """A board that slips before its first move has another gain, and that is all."""
    projection, slip = NuisanceProjector.at_fit(base("")), find_term("board_slip")
    setting = projection.states[0].context
    first = min(float(course.end_s) for _, course in setting.motion_profiles)
    last = max(float(course.start_s[0]) for _, course in setting.motion_profiles)
    for before, at in ((setting.begin_s, first), (setting.end_s, last)):
        candidate = fit_candidate(projection, slip, None, [np.array([0.0, 0.0, 0.0, before])])
        assert candidate is not None
        assert first <= candidate.extension.values[3] <= last
        assert candidate.infeasible or candidate.extension.values[3] != at


def test_a_gain_that_changes_is_the_gain(base: Fit) -> None:
    scene = NuisanceProjector.at_fit(base("")).states[0]
    change = 0.01 * np.arange(1.0, 10.0).reshape(3, 3)
    effect = GainChange().effect(scene, change.ravel())
    assert np.allclose(effect, scene.measure_sensor_rate(scene.rate_rad_s @ change.T), atol=1e-12)


@pytest.mark.long
def test_the_gain_is_looked_for_where_rates_are_cut_off(base: Fit) -> None:
    plain = base("dead_zone:0.009")
    effort = SearchEffort()
    assert refit_gain_exactly(plain, effort) is plain
    assert effort.evaluations == 0
    term = find_term("dead_zone")
    sizes = np.array(value_indices(term, role="size"))
    lame = refit_with_terms(plain, [FittedTerm(term, np.full(3, 0.009), sizes)])
    refitted = refit_gain_exactly(lame, effort)
    assert refitted is lame or whittle_log_likelihood(refitted) > whittle_log_likelihood(lame)
    threshold = refitted.fitted_terms[0].values
    assert threshold == pytest.approx(np.full(3, 0.009), rel=0.05)
