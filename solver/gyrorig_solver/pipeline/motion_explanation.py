"""The findings of a fit to a motion whose rate is known at each time."""

from dataclasses import replace

import numpy as np

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration.calibration_builder import level_record
from gyrorig_solver.calibration.calibration_wording import level_sentence
from gyrorig_solver.discover import FitExplanation, HeldOutGain
from gyrorig_solver.discover.held_out_gain import gain_on_recording
from gyrorig_solver.pipeline.board_data import BoardData
from gyrorig_solver.pipeline.board_results import (
    NO_CAUSE_REMARK,
    BoardExplanation,
    check_fitted_gain,
    check_raw_streams,
)
from gyrorig_solver.pipeline.prepare_board import last_stage_level, prepare_held_out
from gyrorig_solver.report.report_series import series_of_explanation


def explain_motion(
    data: BoardData, fit_explanation: FitExplanation, held_out: Recording | None
) -> BoardExplanation:
    """Return the findings of a fit to a motion; the named causes are tested on `held_out`.

    Raises:
        InputError: the board is not in `held_out`, or has too few samples there.
        UsageError: the reference of `held_out` does not give the rate at each time.
    """
    gain_checks = check_fitted_gain(data, fit_explanation.solution_extended.gain)
    held_out_gain, held_out_remarks = _test_held_out(fit_explanation, held_out)
    return BoardExplanation(
        board=BoardId(data.board),
        recordings=data.recordings,
        findings=replace(fit_explanation.findings, other_recording_gain=held_out_gain),
        raw_checks=(*check_raw_streams(data), gain_checks),
        report_series=series_of_explanation(fit_explanation),
        remarks=(
            *_convergence_remarks(fit_explanation),
            *_setup_remarks(data, fit_explanation),
            *held_out_remarks,
        ),
        fit_explanation=fit_explanation,
    )


def _convergence_remarks(fit_explanation: FitExplanation) -> list[str]:
    """State that the fit of the base model did not converge, and what was therefore left out."""
    remarks = list(fit_explanation.remarks)
    base, extended = fit_explanation.solution_base, fit_explanation.solution_extended
    if not base.converged:
        without = "" if extended is base else " without the causes"
        remarks.append(
            f"{without} {base.convergence.reason}, so its values are not a result".strip()
        )
    if extended is not base and not extended.converged:
        remarks.append(
            f"with the causes, {extended.convergence.reason}, so its values are not a result"
        )
    return remarks


def _setup_remarks(data: BoardData, fit_explanation: FitExplanation) -> list[str]:
    """Describe the stage's level, and the bias and time offset of each of several recordings."""
    remarks = []
    sessions = fit_explanation.solution_extended.sessions
    references = [session.reference for session in sessions]
    level = last_stage_level(zip(data.samples, references, strict=True))
    if level is not None:
        remarks.append(level_sentence(level_record(level)))
    if len(data.recordings) > 1:
        for name, session in zip(data.names, sessions, strict=True):
            bias = ", ".join(f"{v:+.4f}" for v in np.degrees(session.bias_rad_s))
            remarks.append(
                f"{name}: bias {bias} deg/s, time offset {1e3 * session.time_offset_s:.2f} ms"
            )
    return remarks


def _test_held_out(
    fit_explanation: FitExplanation, held_out: Recording | None
) -> tuple[HeldOutGain | None, tuple[str, ...]]:
    """Return the named causes' gain on a held-out recording, and a remark if no cause is named."""
    if held_out is None:
        return None, ()
    if not fit_explanation.findings.causes:
        return None, (NO_CAUSE_REMARK.format(held_out.path.name),)
    base, extended = fit_explanation.solution_base, fit_explanation.solution_extended
    prepared = prepare_held_out(held_out, fit_explanation.board, extended)
    return gain_on_recording(base, extended, prepared), ()
