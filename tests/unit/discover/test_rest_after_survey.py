"""A recording at rest after a survey: the calibration states the time offset of the survey."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings, fit_base_model
from tests.unit.discover.conftest import CONFIG
from tests.unit.discover.test_motor_vibration import with_motor_noise

from gyrorig_solver.data.samples import GyroSamples, load_samples
from gyrorig_solver.discover import CALIBRATION_PARAMETERS, MotionFitSpace
from gyrorig_solver.discover.cause_findings import CauseFindings
from gyrorig_solver.discover.checks.residual_dependence import residual_dependence_tests
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.estimate import UNIT_REMEDIES, ParameterLayout, fit_boards_jointly
from gyrorig_solver.estimate.motion_fit import summarize_motion_fit
from gyrorig_solver.pipeline.board_data import load_board
from gyrorig_solver.pipeline.prepare_board import fit_base, prepare_held_out

pytestmark = pytest.mark.long

OFFSET = CALIBRATION_PARAMETERS.index("time_offset")


def test_a_change_of_the_survey_changes_the_stated_time_offset(pair: tuple[Any, Any]) -> None:
    survey, resting = pair
    space = MotionFitSpace(fit_base_model([survey.recording, resting.recording], survey.board))
    layout = ParameterLayout.of([()], 2)
    offset_s = np.zeros(layout.size)
    offset_s[layout.index(0)[-1]] = 1e-3
    stated = space.calibration().propagate(offset_s)
    assert stated[OFFSET] == pytest.approx(1e-3)
    offset_s = np.zeros(layout.size)
    offset_s[layout.index(1)[-1]] = 1e-3
    assert not space.calibration().propagate(offset_s).any()


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


def test_two_boards_at_rest_are_solved_together(hidden: Callable[..., Any], tmp_path: Path) -> None:
    """Before, a recording that shows no move ended with a fault in the program."""
    text = CONFIG.read_text(encoding="utf-8")
    board = "  - {id: GY80-2, port: emulated, baud: 460800, format: gcb1}\n"
    rig = tmp_path / "rig.yaml"
    rig.write_text(text.replace("boards:\n", f"boards:\n{board}"), encoding="utf-8")
    recordings = [hidden(program=name, config=rig).recording for name in ("quick", "static")]
    boards = [str(board) for board in recordings[0].board_ids]
    assert len(boards) == 2
    for chosen in (recordings, recordings[1:]):
        joint = fit_boards_jointly({board: fit_base_model(chosen, board) for board in boards})
        assert set(joint.solutions) == set(boards)
        assert not joint.left_out


def test_the_noise_in_motion_is_that_of_the_survey(hidden: Callable[..., Any]) -> None:
    survey = hidden(program="survey-40", seed=23)  # no other test records it: it is the first one
    resting = hidden(program="static", seed=23)
    noisy = with_motor_noise(load_board([survey.recording], survey.board), 2.0)
    both = load_board([survey.recording, resting.recording], survey.board)
    assert both.recordings[0].path == survey.recording.path
    both = replace(both, samples=(*noisy.samples, both.samples[1]))
    alone, together = (
        summarize_motion_fit(fit_base(data), data.samples, UNIT_REMEDIES) for data in (noisy, both)
    )
    for fit in (alone, together):
        assert any("noise in motion is" in warning for warning in fit.warnings)


def test_a_held_out_recording_shows_what_any_of_its_parts_shows(hidden: Callable[..., Any]) -> None:
    """Before, the first part decided, and it can be a rest."""
    survey = hidden("g_sensitivity", program="survey-40")
    other = hidden("g_sensitivity", program="survey-130")
    explanation = explain_recordings([survey.recording], survey.board)
    assert "g_sensitivity" in {named.cause for named in explanation.findings.causes}
    samples = load_samples(other.recording, other.board)
    begins_with_a_rest = without(samples, 1.0, 3.3)
    held_out = prepare_held_out(
        other.recording, other.board, explanation.solution_extended, begins_with_a_rest
    )
    fitted = held_out.fit_model(explanation.solution_extended)
    assert not fitted.left_out


def without(samples: GyroSamples, begin_s: float, end_s: float) -> GyroSamples:
    """Return samples without those between two times."""
    is_used = (samples.time_s < begin_s) | (samples.time_s > end_s)
    names = ("time_s", "host_s", "number", "segment", "rate_rad_s", "usable")
    chosen = {name: getattr(samples, name)[is_used] for name in names}
    return replace(samples, temperature_degc=None, **chosen)
