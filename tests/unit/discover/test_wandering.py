"""A bias that wanders gets no name; what made it seem to wander does."""

from collections.abc import Callable
from typing import Any

from gyrorig_solver.discover.finder import explain
from gyrorig_solver.discover.wandering import CALM, calmed, is_calm, wandering
from gyrorig_solver.estimate.noise import ordinary_levels
from gyrorig_solver.solve import unit_solution


def test_a_bias_that_wanders_much_is_odd_and_has_no_name(hidden: Callable[..., Any]) -> None:
    session = hidden("bias_random_walk:0.001")
    findings = explain([session.recording], session.board).findings
    assert findings.verdict == "unexplained"
    assert findings.unexplained is not None
    assert findings.unexplained.best.covariate in ("bias_time", "wandering")
    assert not findings.causes


def test_an_ordinary_part_is_calm(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    solution = unit_solution([session.recording], session.board)
    assert is_calm(solution)
    assert wandering(solution).signature.p_value == 1.0


def test_a_hidden_step_raises_the_levels_and_is_found(hidden: Callable[..., Any]) -> None:
    session = hidden("bias_step@y:0.002")
    solution = unit_solution([session.recording], session.board)
    assert not is_calm(solution)
    (noise,) = solution.noises
    for axis in calmed(noise).levels:
        assert axis[1] <= CALM * ordinary_levels(float(axis[0]))[1] * 1.001
    causes = explain([session.recording], session.board).findings.causes
    assert [cause.candidates for cause in causes] == [("bias_step",)]
