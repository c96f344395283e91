"""A recording at rest after a survey: the calibration states the time offset of the survey."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings, fit_base_model

from gyrorig_solver.discover import CALIBRATION_PARAMETERS, MotionFitSpace
from gyrorig_solver.discover.cause_findings import CauseFindings
from gyrorig_solver.estimate import ParameterLayout

OFFSET = CALIBRATION_PARAMETERS.index("time_offset")


@pytest.fixture
def pair(hidden: Callable[..., Any]) -> tuple[Any, Any]:
    """A survey and a rest."""
    return hidden(program="survey-40"), hidden(program="static")


def test_a_change_of_the_survey_changes_the_stated_time_offset(pair: tuple[Any, Any]) -> None:
    survey, resting = pair
    space = MotionFitSpace(fit_base_model([survey.recording, resting.recording], survey.board))
    layout = ParameterLayout.of([()], 2)
    offset_s = np.zeros(layout.size)
    offset_s[layout.index(0)[-1]] = 1e-3
    stated = space.calibration_shift(space.calibration(), offset_s)
    assert stated[OFFSET] == pytest.approx(1e-3)
    offset_s = np.zeros(layout.size)
    offset_s[layout.index(1)[-1]] = 1e-3
    assert not space.calibration_shift(space.calibration(), offset_s).any()


def test_the_detection_limits_include_those_of_the_survey(pair: tuple[Any, Any]) -> None:
    survey, resting = pair
    alone = explain_recordings([survey.recording], survey.board).findings
    together = explain_recordings([survey.recording, resting.recording], survey.board).findings

    def limited(findings: CauseFindings) -> set[tuple[str, str | None]]:
        return {(limit.cause, limit.where) for limit in findings.detection_limits}

    assert limited(alone) <= limited(together)


def test_a_rest_does_not_hide_a_cause_that_needs_moves(hidden: Callable[..., Any]) -> None:
    """Before, the search could not test the true cause, and it named backlash."""
    survey = hidden("base_speed_jump", program="survey-40", seed=21)
    resting = hidden(program="static", seed=21)
    recordings = [survey.recording, resting.recording]
    alone = explain_recordings(recordings[:1], survey.board).findings
    together = explain_recordings(recordings, survey.board).findings
    assert {named.cause for named in together.causes} >= {"base_speed_jump"}
    assert together.verdict == "explained"
    for before, after in zip(alone.causes, together.causes, strict=True):
        assert after.cause == before.cause
        values = [value.value for value in before.values]
        assert [value.value for value in after.values] == pytest.approx(values, rel=1e-6)
