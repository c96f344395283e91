"""A right name holds against free functions of its covariates, a wrong one does not."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.free_shapes import families, swells
from gyrorig_solver.discover.name_tests import (
    LEVEL,
    OWN,
    fillers,
    held_against,
    kept,
    without,
)
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import Found, best_fit, standing_of
from gyrorig_solver.estimate.likelihood import Solution, solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.on_unit import unit_solution

Base = Callable[..., Solution]


@pytest.fixture(scope="module")
def base(hidden: Callable[..., Any]) -> Base:
    """Return the fit of the base model to a session with something hidden."""

    made: dict[tuple[str, ...], Solution] = {}

    def fit(*hide: str) -> Solution:
        if hide not in made:
            session = hidden(*hide, program="survey-40")
            made[hide] = unit_solution([session.recording], session.board)
        return made[hide]

    return fit


def _named(base: Solution, cause: str) -> Found:
    """Return where a search ends that knows this cause alone."""
    term = catalogue()[cause]
    beside = Projection.of(base)
    best = best_fit(beside, sights(beside, [term], 60, all_rows(beside, term)))
    assert best is not None
    solution = solve_again(base, [best[0].extension])
    standing = standing_of(solution, 0, [term], 60)
    return Found(solution, (standing,), Projection.of(solution), ())


@pytest.mark.parametrize(
    ("hide", "cause"),
    [
        ("eccentricity@pan:0.002", "eccentricity"),
        ("s_curve@pan:0.04", "s_curve"),
    ],
)
def test_a_right_name_holds(base: Base, hide: str, cause: str) -> None:
    found = _named(base(hide), cause)
    after, fallen = kept(base(hide), found)
    assert fallen == ()
    assert after is found


@pytest.mark.parametrize(
    ("hide", "cause", "covariates"),
    [
        ("s_curve@pan:0.04", "acceleration_error", {*OWN["acceleration_error"]}),
        ("worm_error@pan:0.0005", "eccentricity", {"pan_angle"}),
    ],
)
def test_a_wrong_name_falls_by_what_it_hangs_on(
    base: Base, hide: str, cause: str, covariates: set[str]
) -> None:
    fit = base(hide)
    after, fallen = kept(fit, _named(fit, cause))
    assert after.standings == ()
    assert after.solution is fit
    assert [one.p_value < LEVEL for one in fallen] == [True]
    assert fallen[0].covariate in covariates | {"time", "speed", "pan_angle", "tilt_angle"}


def test_chances_are_uniform_at_most_where_the_name_is_right(base: Base) -> None:
    found = _named(base("eccentricity@pan:0.002"), "eccentricity")
    (one,) = found.solution.extensions
    projection = found.last
    every = [(family, False) for family in families(projection.scenes)]
    every += [(family, True) for family in swells(one, projection.scenes)]
    heard = [held_against(projection, one, family, itself) for family, itself in every]
    chances = np.array([h.p_value for h in heard if h is not None])
    assert chances.size > 12
    assert chances.min() > LEVEL / chances.size


@pytest.mark.long
def test_a_slip_of_less_than_a_step_is_no_lost_step(base: Base) -> None:
    right = _named(base("lost_steps:1"), "lost_steps")
    assert kept(base("lost_steps:1"), right)[1] == ()
    (standing,) = right.standings
    (one,) = right.solution.extensions
    sizes = one.values.copy()
    sizes[:2] *= 0.4
    less = solve_again(right.solution, [type(one)(one.term, sizes, one.free)])
    # As a fit would end where the jump itself is as small.
    object.__setattr__(less.extensions[0], "values", sizes)
    after, fallen = kept(base("lost_steps:1"), Found(less, (standing,), Projection.of(less), ()))
    assert after.standings == ()
    assert "less than one step" in fallen[0].words


def test_a_name_falls_by_a_rest_of_its_own_kind_alone(base: Base) -> None:
    fit = base("eccentricity@pan:0.002")
    found = _named(fit, "eccentricity")
    large = 2.0 * found.standings[0].best.won
    of_pan = Signature("pan_angle", "on pan, as a gain", large, 24, 0.0)
    of_time = Signature("bias_time", "on the time, as a bias", large, 24, 0.0)
    assert fillers(found, [of_pan], 0.8) == [True]
    assert fillers(found, [of_time], 0.8) == [False]
    assert without(fit, found, [True]).solution is fit
