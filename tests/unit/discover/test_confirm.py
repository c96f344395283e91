"""What a fit can do without is no cause, and what it itself can follow is none either."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover import search
from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.confirm import confirmed
from gyrorig_solver.discover.refit import refit
from gyrorig_solver.discover.regain import GainChange, regained
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.wandering import log_likelihood
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution, solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import term
from gyrorig_solver.model.terms.protocol import indices
from gyrorig_solver.on_unit import unit_solution

Fit = Callable[[str], Solution]


@pytest.fixture(scope="module")
def base(hidden: Callable[..., Any]) -> Fit:
    """Return a function that fits the base model to a session, once each."""
    made: dict[str, Solution] = {}

    def fit(hide: str) -> Solution:
        if hide not in made:
            session = hidden(hide) if hide else hidden()
            made[hide] = unit_solution([session.recording], session.board)
        return made[hide]

    return fit


def beside(solution: Solution, cause: str) -> Extension:
    projection, one = Projection.of(solution), term(cause)
    best = search.best_fit(projection, sights(projection, [one], 1, all_rows(projection, one)))
    assert best is not None
    return best[0].extension


@pytest.mark.long
def test_what_the_fit_can_do_without_is_refused(base: Fit) -> None:
    plain = base("backlash@tilt:0.0012")
    gap = beside(plain, "backlash")
    worm = term("worm_error")
    idle = Extension(worm, worm.bank(Projection.of(plain).scenes[0])[0].copy(), np.array([0, 1]))
    tests = search.tests_of(search.testable(Projection.of(plain)))
    found = confirmed(solve_again(plain, [gap, idle]), (), tests, search.ALPHA)
    assert found.refused == {"worm_error"}
    assert [one.term.cause for one in found.solution.extensions] == ["backlash"]
    assert found.won["backlash"] > 100.0


def test_what_stays_needs_a_move_on_either_side(base: Fit) -> None:
    """A board that slips before its first move has another gain, and that is all."""
    projection, slip = Projection.of(base("")), term("board_slip")
    setting = projection.scenes[0].setting
    first = min(float(course.end_s) for _, course in setting.courses)
    last = max(float(course.start_s[0]) for _, course in setting.courses)
    for before, at in ((setting.begin_s, first), (setting.end_s, last)):
        one = refit(projection, slip, None, [np.array([0.0, 0.0, 0.0, before])])
        assert one is not None
        assert first <= one.extension.values[3] <= last
        assert one.impossible or one.extension.values[3] != at


def test_a_gain_that_changes_is_the_gain(base: Fit) -> None:
    scene = Projection.of(base("")).scenes[0]
    change = 0.01 * np.arange(1.0, 10.0).reshape(3, 3)
    effect = GainChange().effect(scene, change.ravel())
    assert np.allclose(effect, scene.seen(scene.rate_rad_s @ change.T), atol=1e-12)


def test_the_gain_is_looked_for_where_rates_are_cut_off(base: Fit) -> None:
    plain = base("dead_zone:0.009")
    assert regained(plain) is plain
    one = term("dead_zone")
    sizes = np.array(indices(one, role="size"))
    lame = solve_again(plain, [Extension(one, np.full(3, 0.009), sizes)])
    found = regained(lame)
    assert found is lame or log_likelihood(found) > log_likelihood(lame)
    threshold = found.extensions[0].values
    assert threshold == pytest.approx(np.full(3, 0.009), rel=0.05)
