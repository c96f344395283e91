"""A clock that drifts and is set right at intervals: one name, and none without it."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover import explain_fit
from gyrorig_solver.discover.lag_series import LagSeries, lag_templates
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.model import find_term

GROWTH = 3e-4


@pytest.fixture(scope="module")
def session(hidden: Callable[..., Any]) -> Any:
    return hidden(f"clock_sawtooth:{GROWTH}", seed=4, program="survey-40")


@pytest.mark.long
def test_a_sawtooth_has_one_name_and_its_values(session: Any) -> None:
    explanation = explain_fit(fit_base_model([session.recording], session.board), session.board)
    (named,) = explanation.findings.causes
    assert named.cause == "clock_sawtooth"
    parameters = session.truth[0]["parameters"]
    rate, period, _ = named.extension.values
    assert rate == pytest.approx(parameters["lag_growth"]["value"], rel=0.1)
    assert period == pytest.approx(parameters["period"]["value"], rel=0.02)


@pytest.mark.long
def test_the_lag_by_time_shows_it(session: Any, hidden: Callable[..., Any]) -> None:
    projector = MotionFitSpace(fit_base_model([session.recording], session.board)).projector()
    assert LagSeries.at(projector).p_value < 1e-6
    best = lag_templates(projector, find_term("clock_sawtooth"))[0][0]
    assert best[1] == pytest.approx(session.truth[0]["parameters"]["period"]["value"], rel=0.1)
    plain = hidden(seed=4, program="survey-40")
    without = MotionFitSpace(fit_base_model([plain.recording], plain.board)).projector()
    assert LagSeries.at(without).p_value > 1e-3


def test_shapes_are_scored_as_their_windows(session: Any) -> None:
    projector = MotionFitSpace(fit_base_model([session.recording], session.board)).projector()
    series = LagSeries.at(projector)
    shapes_s = np.eye(series.edges_s.size - 1)[:3]
    score, information = series.statistics.score, np.diag(series.statistics.information)
    is_seen = information[:3] > 1e-6 * series.statistics.energy[:3]
    expected = np.where(is_seen, score[:3] ** 2 / np.where(is_seen, information[:3], 1.0), 0.0)
    assert series.score_shapes(shapes_s) == pytest.approx(expected)


@pytest.mark.long
def test_one_step_is_no_sawtooth(hidden: Callable[..., Any]) -> None:
    """A saw-tooth with one correction is a step and a skew: the data cannot show its period."""
    session = hidden("clock_step:0.01", seed=33, program="survey-40")
    explanation = explain_fit(fit_base_model([session.recording], session.board), session.board)
    assert [named.cause for named in explanation.findings.causes] == ["clock_step"]
