"""Several large causes in one recording: each of them is found in spite of the others."""

from pathlib import Path

import numpy as np
import pytest
from tests.hidden.truth.draws import draw_session
from tests.hidden.truth.make import make_case
from tests.hidden.truth.session import BOARD, RigDraw, record
from tests.support.board_fits import explain_recordings, fit_base_model

from gyrorig_daemon.emulator.emulator_settings import InjectionRequest
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector, refit_with_terms
from gyrorig_solver.model.catalogue import catalogue

pytestmark = pytest.mark.long

CLOCK_STEP_S = 8e-3  # of the session below; a pulse of lost steps is 10 ms long


def recording_of(seed: int, tmp_path: Path) -> Path:
    """Return the recording of a session with four to eight causes."""
    session = draw_session(seed, "many")
    assert session is not None
    make_case(tmp_path, session)
    return tmp_path / "recording.mcap"


def test_lost_steps_are_looked_for_when_a_clock_step_has_moved_them(tmp_path: Path) -> None:
    """The steps were lost 40 s after the clock stepped by 8 ms."""
    recording = read_recording(recording_of(12400032, tmp_path))
    base = fit_base_model([recording], BOARD)
    step = catalogue()["clock_step"]
    stepped = refit_with_terms(
        base, [FittedTerm(step, np.array([-CLOCK_STEP_S, 46.92]), np.array([0]))]
    )
    lost_steps = catalogue()["lost_steps"]
    before, after = (
        all_templates(NuisanceProjector.at_fit(solution), lost_steps)[0][0, -1]
        for solution in (base, stepped)
    )
    assert after - before == pytest.approx(CLOCK_STEP_S, abs=6e-3)
    findings = explain_recordings([recording], BOARD).findings
    assert {"clock_step", "lost_steps", "g_sensitivity", "axis_nonorthogonality"} <= {
        cause.cause for cause in findings.causes
    }
    assert findings.unexplained is None


def test_a_dead_band_next_to_the_rate_of_a_long_move_is_fitted(tmp_path: Path) -> None:
    """The likelihood jumps where a width passes the rate of a long move."""
    recording = read_recording(recording_of(12400009, tmp_path))
    findings = explain_recordings([recording], BOARD).findings
    assert {cause.cause for cause in findings.causes} >= {"dead_zone", "tilt_sag"}
    assert findings.unexplained is None


def test_a_base_that_twists_behind_a_gap_has_both_names(tmp_path: Path) -> None:
    """The stage starts when the motor has crossed the gap, and then the base twists."""
    gap_rad, compliance_s2 = 9e-4, 5e-5
    hide = (
        InjectionRequest("backlash", "pan", gap_rad),
        InjectionRequest("base_compliance", "pan", compliance_s2),
    )
    path = tmp_path / "recording.mcap"
    record(RigDraw(77, "survey-130", hide=hide), path)
    findings = explain_recordings([read_recording(path)], BOARD).findings
    assert findings.unexplained is None
    assert {cause.candidates for cause in findings.causes} == {("backlash",), ("base_compliance",)}
    values = {value.name: value.value for cause in findings.causes for value in cause.values}
    assert values["gap.pan"] == pytest.approx(gap_rad, rel=0.03)
    # A jump of the speed takes the emulated motor 2 % of the time constant of the low-pass.
    assert values["coefficient.pan"] == pytest.approx(compliance_s2, rel=0.04)


def test_a_loss_of_steps_in_saturated_samples_is_not_called_a_slip_alone(tmp_path: Path) -> None:
    """Only the lean of the stage after the loss is visible, as after a slip of the board."""
    hide = (
        InjectionRequest("lost_steps", "tilt", 8.0),
        InjectionRequest("saturation", "x", 0.3),
    )
    path = tmp_path / "recording.mcap"
    record(RigDraw(6, "survey-130", hide=hide), path)
    (lost,) = [
        cause
        for cause in explain_recordings([read_recording(path)], BOARD).findings.causes
        if cause.cause != "saturation"
    ]
    assert set(lost.candidates) == {"lost_steps", "board_slip"}
