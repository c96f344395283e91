"""Ramps that are not as steep as told, against what the emulated unit was made to do."""

from collections.abc import Callable
from typing import Any

import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.cause_search import SearchResult
from gyrorig_solver.discover.checks.model_check import JudgedModel
from gyrorig_solver.discover.checks.ramp_check import RampCheck, detect_ramp_error
from gyrorig_solver.discover.law_candidates import fit_law_cause
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, scan_catalogue
from gyrorig_solver.model.causes.base_speed_jump import BaseSpeedJump

TESTS = 45


@pytest.mark.long
def test_ramps_that_are_not_as_told_have_a_name(hidden: Callable[..., Any]) -> None:
    session = hidden("acceleration_error@tilt:-0.01", seed=7)
    solution = fit_base_model([session.recording], session.board)
    (named,) = detect_ramp_error(solution, TESTS).named
    assert named.where == ("tilt",)
    tilt = named.values[1]
    assert tilt.value == pytest.approx(-0.01, abs=4.0 * tilt.std)
    assert tilt.std < 1e-3
    assert not named.extension.free_indices.size  # the base model has them: nothing to fit


def test_ramps_as_told_have_none_and_a_limit(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    ramps = detect_ramp_error(fit_base_model([session.recording], session.board), TESTS)
    assert not ramps.named
    assert [detection_limit.where for detection_limit in ramps.detection_limits] == ["pan", "tilt"]
    assert all(1e-5 < detection_limit.size < 1e-2 for detection_limit in ramps.detection_limits)


@pytest.mark.long
def test_the_replies_name_a_base_speed_for_the_search(hidden: Callable[..., Any]) -> None:
    session = hidden("base_speed_jump:0.15", seed=7)
    space = MotionFitSpace(fit_base_model([session.recording], session.board))
    (score, *_) = scan_catalogue(space.projector(), [BaseSpeedJump()], TESTS)
    assert score.p_value < FALSE_ALARM_RATE
    candidate = fit_law_cause(space, BaseSpeedJump()).candidate
    assert candidate is not None
    assert candidate.extension.values == pytest.approx([0.15, 0.15], abs=4.0 * candidate.std.max())


@pytest.mark.parametrize("cause", [(), ("acceleration_error@tilt:-0.01",)])
def test_ramps_of_the_base_model_are_no_candidate(
    hidden: Callable[..., Any], cause: tuple[str, ...]
) -> None:
    session = hidden(*cause, seed=7)
    space = MotionFitSpace(fit_base_model([session.recording], session.board))
    laws = [term for term in space.terms.values() if term.law_quantity is not None]
    scores = scan_catalogue(space.projector(), laws, TESTS)
    assert len(scores) == 9  # three quantities, each on pan, on tilt and on both
    assert all(score.p_value > FALSE_ALARM_RATE for score in scores)


@pytest.mark.long
def test_a_base_speed_of_the_grid_is_stated_without_uncertainty(
    hidden: Callable[..., Any],
) -> None:
    session = hidden("base_speed_jump:0.15", seed=7)
    base = fit_base_model([session.recording], session.board)
    space = MotionFitSpace(base)
    model = JudgedModel(space, SearchResult(space, (), space.projector(), ()))
    (stated,) = RampCheck().judge(model).named
    assert stated.term.cause == "base_speed_jump"
    assert all(value.std == float("inf") for value in stated.values)
