"""A recording at rest after a survey: the calibration states the time offset of the survey."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings, fit_base_model

from gyrorig_solver.discover import CALIBRATION_PARAMETERS, MotionFitSpace
from gyrorig_solver.discover.cause_findings import CauseFindings
from gyrorig_solver.discover.checks.residual_dependence import residual_dependence_tests
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
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


def test_the_tests_of_the_residual_are_those_of_the_survey(hidden: Callable[..., Any]) -> None:
    """Before, the moves of the first recording counted only, and a rest has none."""
    resting = hidden(program="static", seed=22)  # no other test records it: it is the first one
    survey = hidden(program="survey-40", seed=22)
    assert resting.recording.start_ns < survey.recording.start_ns
    alone, together = (
        MotionFitSpace(fit_base_model(chosen, survey.board))
        for chosen in ([survey.recording], [resting.recording, survey.recording])
    )
    expected, measured = (_statistics_of_moves(space) for space in (alone, together))
    assert len(expected) == 4
    assert measured == pytest.approx(expected, rel=0.01)


def _statistics_of_moves(space: MotionFitSpace) -> dict[str, float]:
    return {
        test.description: test.statistic
        for test in residual_dependence_tests(space.projector())
        if test.covariate in ("pan_transient", "tilt_transient", "move_gain", "move_delay")
    }


def test_each_move_belongs_to_one_recording(hidden: Callable[..., Any]) -> None:
    surveys = [hidden(program=program) for program in ("survey-40", "quick")]
    projector = MotionFitSpace(
        fit_base_model([survey.recording for survey in surveys], surveys[0].board)
    ).projector()
    families = list(smooth_families(projector.states))
    (family,) = (
        family for family in families if family.description.startswith("on the move (the gain")
    )
    recordings_of_move: list[set[int]] = [set() for _ in family.detail]
    for state in projector.states:
        signals = np.concatenate([function(state) for function in family.signals])
        for k, signal in enumerate(signals):
            if signal.any():
                recordings_of_move[k].add(state.context.recording_index)
    assert sum(len(owners) == 1 for owners in recordings_of_move) == family.detail.size
    counts = np.bincount([next(iter(owners)) for owners in recordings_of_move])
    moves = {s.context.recording_index: len(s.context.motion_profiles) for s in projector.states}
    assert counts.tolist() == [moves[0], moves[1]]


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
