"""A right name holds against free functions of its covariates, a wrong one does not."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_ranking import RankedCause, rank_against_alternatives
from gyrorig_solver.discover.cause_search import SearchResult
from gyrorig_solver.discover.checks.model_check import JudgedModel, judge_model
from gyrorig_solver.discover.checks.redundancy import find_partial_explanations
from gyrorig_solver.discover.checks.smooth_alternatives import modulated_effects, smooth_families
from gyrorig_solver.discover.checks.specification_tests import (
    REJECTION_LEVEL,
    SpecificationCheck,
    nonparametric_specification_test,
)
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import ConvergedFit, NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue

Base = Callable[..., ConvergedFit]


@pytest.fixture(scope="module")
def base(hidden: Callable[..., Any]) -> Base:
    """Return the fit of the base model to a session with something hidden."""

    made: dict[tuple[str, ...], ConvergedFit] = {}

    def fit(*hide: str) -> ConvergedFit:
        if hide not in made:
            session = hidden(*hide, program="survey-40")
            made[hide] = fit_base_model([session.recording], session.board)
        return made[hide]

    return fit


def _model(
    base: ConvergedFit, space: MotionFitSpace, ranked: RankedCause
) -> JudgedModel[MotionFitSpace]:
    return JudgedModel(MotionFitSpace(base), SearchResult(space, (ranked,), space.projector(), ()))


def _checked(
    model: JudgedModel[MotionFitSpace],
) -> tuple[JudgedModel[MotionFitSpace], tuple[DependenceTest, ...]]:
    """Return the model after the check, and the tests that take its name away."""
    after = judge_model(model, [SpecificationCheck()])
    (verdict,) = after.verdicts.values()
    return after, verdict.rejecting_tests


def _named(base: ConvergedFit, cause: str) -> JudgedModel[MotionFitSpace]:
    """Return where a search ends that knows this cause alone."""
    term = catalogue()[cause]
    projector = NuisanceProjector.at_fit(base)
    best = fit_best_place(
        projector, scan_catalogue(projector, [term], 60, all_templates(projector, term))
    )
    assert best is not None
    space = MotionFitSpace(base).refit([best[0].extension])
    return _model(base, space, rank_against_alternatives(space, 0, [term], 60))


ACCELERATION_COVARIATES = catalogue()["acceleration_error"].covariates or ()


@pytest.mark.long
@pytest.mark.parametrize(
    ("hide", "cause"),
    [
        ("eccentricity@pan:0.002", "eccentricity"),
        ("s_curve@pan:0.04", "s_curve"),
    ],
)
def test_a_right_name_holds(base: Base, hide: str, cause: str) -> None:
    named = _named(base(hide), cause)
    after, fallen = _checked(named)
    assert fallen == ()
    assert after is named


@pytest.mark.long
@pytest.mark.parametrize(
    ("hide", "cause", "covariates"),
    [
        (
            "s_curve@pan:0.04",
            "acceleration_error",
            set(ACCELERATION_COVARIATES),
        ),
        ("worm_error@pan:0.0005", "eccentricity", {"pan_angle"}),
    ],
)
def test_a_wrong_name_falls_by_what_it_hangs_on(
    base: Base, hide: str, cause: str, covariates: set[str]
) -> None:
    fit = base(hide)
    after, fallen = _checked(_named(fit, cause))
    assert after.result.ranked_causes == ()
    assert after.space.solution is fit
    assert [test.p_value < REJECTION_LEVEL for test in fallen] == [True]
    assert fallen[0].covariate in covariates | {"time", "speed", "pan_angle", "tilt_angle"}


def test_chances_are_uniform_at_most_where_the_name_is_right(base: Base) -> None:
    named = _named(base("eccentricity@pan:0.002"), "eccentricity")
    (fitted_term,) = named.space.fitted_terms
    projection = named.result.projector
    every = [(family, False) for family in smooth_families(projection.states)]
    every += [(family, True) for family in modulated_effects(fitted_term, projection.states)]
    heard = [
        nonparametric_specification_test(projection, fitted_term, family, itself)
        for family, itself in every
    ]
    chances = np.array([h.p_value for h in heard if h is not None])
    assert chances.size > 12
    assert chances.min() > REJECTION_LEVEL / chances.size


@pytest.mark.long
def test_a_slip_of_less_than_a_step_is_no_lost_step(base: Base) -> None:
    right = _named(base("lost_steps:1"), "lost_steps")
    assert _checked(right)[1] == ()
    (standing,) = right.result.ranked_causes
    (fitted_term,) = right.space.fitted_terms
    sizes = fitted_term.values.copy()
    sizes[:2] *= 0.4
    less = right.space.refit([type(fitted_term)(fitted_term.term, sizes, fitted_term.free_indices)])
    # As a fit would end where the jump itself is as small.
    object.__setattr__(less.fitted_terms[0], "values", sizes)
    after, fallen = _checked(_model(base("lost_steps:1"), less, standing))
    assert after.result.ranked_causes == ()
    assert "less than one step" in fallen[0].description


def test_a_name_falls_by_a_rest_of_its_own_kind_alone(base: Base) -> None:
    fit = base("eccentricity@pan:0.002")
    named = _named(fit, "eccentricity")
    large = 2.0 * named.result.ranked_causes[0].candidate.delta_log_likelihood
    of_pan = DependenceTest("pan_angle", "on pan (the gain changes)", large, 24, 0.0)
    of_time = DependenceTest("bias_time", "on the time (the bias changes)", large, 24, 0.0)
    assert find_partial_explanations(named, [of_pan]) == [True]
    assert find_partial_explanations(named, [of_time]) == [False]
    assert named.without([True]).space.solution is fit
