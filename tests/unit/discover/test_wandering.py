"""A bias that wanders is named as such, and what only made it seem to wander as what it is."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.finder import explain
from gyrorig_solver.discover.walks import leaps, look_for_walk
from gyrorig_solver.discover.wandering import CALM, calmed, is_calm, wandering
from gyrorig_solver.estimate.noise import ordinary_levels
from gyrorig_solver.on_unit import unit_solution


@pytest.mark.long
def test_where_flicker_says_it_as_well_there_is_no_name(hidden: Callable[..., Any]) -> None:
    """Over 40 s the two are nearly alike: what is odd is told, and by what it depends on."""
    session = hidden("bias_random_walk:0.001")
    findings = explain([session.recording], session.board).findings
    assert findings.verdict == "unexplained"
    assert findings.unexplained is not None
    assert findings.unexplained.best.covariate in ("bias_time", "wandering")
    assert not findings.causes


def test_over_longer_it_is_named(hidden: Callable[..., Any]) -> None:
    session = hidden("bias_random_walk:0.0003", program="survey-130")
    solution = unit_solution([session.recording], session.board)
    cause = look_for_walk(solution, tests=80, alpha=0.0075)
    assert cause is not None
    assert cause.candidates == ("bias_random_walk",)
    assert all(0.0 < one.std < one.value for one in cause.values[:2])  # hardly any on z


def test_any_level_might_have_been_the_one(hidden: Callable[..., Any]) -> None:
    """Flicker and walk of three axes are looked at: six chances to be odd."""
    session = hidden("bias_random_walk:0.0003", program="survey-130")
    one = wandering(unit_solution([session.recording], session.board)).signature
    alone = chi2_tail(one.statistic, one.degrees_of_freedom)
    assert 0.0 < alone < 0.1
    assert one.p_value == pytest.approx(min(1.0, 6.0 * alone), rel=1e-9, abs=0.0)


def test_leaps_are_no_random_walk() -> None:
    """Between two values, here for 8 s on average; a walk of the same size does not leap."""
    rng = np.random.default_rng(3)
    rate_hz, n = 100.0, 13_000
    noise = 4e-3 * rng.standard_normal((n, 1))
    sides = np.cumsum(rng.random(n) < 1.0 / (8.0 * rate_hz)) % 2
    assert leaps(noise + 4e-3 * sides[:, None], rate_hz)
    walk = 4e-5 * np.cumsum(rng.standard_normal((n, 1)), axis=0)
    assert not leaps(noise + walk, rate_hz)


def test_an_ordinary_part_is_calm(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    solution = unit_solution([session.recording], session.board)
    assert is_calm(solution)
    assert wandering(solution).signature.p_value == 1.0
    assert look_for_walk(solution, tests=80, alpha=0.0075) is None


def test_levels_are_calm_by_ratio_however_small(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    solution = unit_solution([session.recording], session.board)
    (noise,) = solution.noises
    levels = noise.levels * np.array([1.0, 1.0, 300.0, 1.0])  # of 1e-10: less than any atol
    assert not is_calm(replace(solution, noises=(replace(noise, levels=levels),)))


def test_a_hidden_step_raises_the_levels_and_is_found(hidden: Callable[..., Any]) -> None:
    session = hidden("bias_step@y:0.002")
    solution = unit_solution([session.recording], session.board)
    assert not is_calm(solution)
    (noise,) = solution.noises
    for axis in calmed(noise).levels:
        assert axis[1] <= CALM * ordinary_levels(float(axis[0]))[1] * 1.001
    causes = explain([session.recording], session.board).findings.causes
    assert [cause.candidates for cause in causes] == [("bias_step",)]
