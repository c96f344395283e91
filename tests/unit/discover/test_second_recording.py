"""What a model is worth on a recording that had no part in it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings, fit_base_model

from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.discover.held_out_gain import gain_on_recording
from gyrorig_solver.pipeline.prepare_board import prepare_held_out

pytestmark = pytest.mark.long

BEND = "scale_quadratic:0.004"


@pytest.fixture(scope="module")
def pair(hidden: Callable[..., Any]) -> tuple[Any, Any]:
    """Two programs on one rig that bends its scale, and steps its bias in the first."""
    return hidden(BEND, "bias_step:0.01"), hidden(BEND, program="survey-40")


def test_a_lasting_cause_is_worth_something_there(pair: tuple[Any, Any]) -> None:
    first, second = pair
    explanation = explain_recordings([first.recording], first.board)
    causes = {cause.cause for cause in explanation.findings.causes}
    assert causes == {"scale_quadratic", "bias_step"}
    held_out = prepare_held_out(second.recording, second.board, explanation.solution_extended)
    gain = gain_on_recording(explanation.solution_base, explanation.solution_extended, held_out)
    assert gain.log_likelihood.low > 0.0
    assert gain.rms_after < gain.rms_before
    assert gain.turn_error_after_rad < gain.turn_error_before_rad
    assert gain.turn_change is not None
    assert gain.turn_change.high < 0.0
    assert second.recording.path.name in gain.how
    assert "without the causes that only the other recording has: bias_step" in gain.how


def test_a_right_model_leaves_noise(pair: tuple[Any, Any]) -> None:
    """Half the squared whitened residual is half the number of values, as of any noise."""
    first, second = pair
    solution = explain_recordings([first.recording], first.board).solution_extended
    judged = prepare_held_out(second.recording, second.board, solution).fit_model(solution)
    many = sum(3 * int(used.sum()) for used in judged.session.used)
    assert -2.0 * judged.log_likelihood / many == pytest.approx(1.0, abs=0.03)


def test_samples_less_a_known_effect_are_taken(pair: tuple[Any, Any]) -> None:
    """A constant rate that is taken off all samples is a bias, and costs nothing."""
    first, second = pair
    base = fit_base_model([first.recording], first.board)
    recording: Recording = second.recording
    plain = prepare_held_out(recording, second.board, base).fit_model(base)
    second_samples = load_samples(recording, second.board)
    less = replace(second_samples, rate_rad_s=np.asarray(second_samples.rate_rad_s) - 0.01)
    other = prepare_held_out(recording, second.board, base, less).fit_model(
        base, same_noise_as=plain
    )
    assert other.log_likelihood == pytest.approx(plain.log_likelihood, abs=0.05)
    assert other.session.bias_rad_s == pytest.approx(plain.session.bias_rad_s - 0.01, abs=1e-6)
