"""Explain a board: checks of the raw stream, search for causes, findings document and report.

What to use when: `explain_boards` for several boards, `explain_board` for one, `explain_data`
where its recordings are loaded already; `write_explanation` for the folder of findings.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version as installed_version
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.calibration.calibration_builder import level_record
from gyrorig_solver.calibration.calibration_wording import level_sentence
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.data.stream.stream_checks import check_stream
from gyrorig_solver.discover import (
    CauseFindings,
    FitExplanation,
    HeldOutGain,
    explain_fit,
    explain_jointly,
)
from gyrorig_solver.discover.attitude.attitude_space import AttitudeRecording
from gyrorig_solver.discover.attitude.explain_attitudes import explain_attitudes
from gyrorig_solver.discover.fit_criticism import findings_without_rates
from gyrorig_solver.discover.held_out_gain import gain_on_recording
from gyrorig_solver.estimate import ConvergedFit, GyroFit
from gyrorig_solver.findings import (
    FindingsDocument,
    build_findings_document,
    to_yaml,
    write_findings,
)
from gyrorig_solver.findings.findings_builder import FindingsOrigin, RawChecks
from gyrorig_solver.findings.findings_document import BoardEntry, InputEntry
from gyrorig_solver.findings.findings_files import PAGE_NAME, figure_path
from gyrorig_solver.pipeline.board_data import (
    ATTITUDE_TOPIC,
    BoardData,
    check_given_once,
    has_unit,
    load_board,
)
from gyrorig_solver.pipeline.fit_board import attitude_reference, fit_board, missing_data
from gyrorig_solver.pipeline.joint_data import JointData, load_jointly
from gyrorig_solver.pipeline.prepare_board import fit_base, prepare_held_out, stage_level
from gyrorig_solver.pipeline.recording_contexts import read_contexts
from gyrorig_solver.report import ReportSeries, draw_findings_figures, render_findings
from gyrorig_solver.report.figure_layout import standalone_svg
from gyrorig_solver.report.report_series import (
    series_of_attitudes,
    series_of_explanation,
)

NO_RATES_REMARK = (
    "the program did not test the residual over time, because the reference gives angles but not "
    "the motion between them"
)
NO_CAUSE_REMARK = "the search named no cause, so the program tested no cause on {}"
ALL_RECORDINGS = "all recordings"  # whose common gain a check is of


@dataclass(frozen=True, slots=True, eq=False)
class BoardExplanation:
    """The findings of one board, with what its document and its report need."""

    board: BoardId
    recordings: tuple[Recording, ...]
    findings: CauseFindings
    raw_checks: tuple[RawChecks, ...]
    report_series: ReportSeries | None  # None: no residual to draw
    remarks: tuple[str, ...]
    fit_explanation: FitExplanation | None  # None where the reference is no unit's motion
    fit: GyroFit | None = None  # where the reference gives no rate at each moment


@dataclass(frozen=True, slots=True)
class WrittenFindings:
    """The files of one board's findings."""

    document: FindingsDocument
    path: Path
    page: Path


def explain_boards(
    recordings: Mapping[BoardId, Sequence[Recording]], held_out: Recording | None = None
) -> Iterator[tuple[BoardId, BoardExplanation | GyrorigError]]:
    """Explain several boards; those on one unit in the same recordings together.

    The named causes are tested on `held_out`; nothing is fitted to it.

    Yields:
        Each board with its explanation, or the error that prevents it.
    """
    groups: dict[tuple[str, ...], list[BoardId]] = {}
    for board, shared_recordings in recordings.items():
        groups.setdefault(tuple(sorted(r.sha256 for r in shared_recordings)), []).append(board)
    for boards in groups.values():
        shared_recordings = recordings[boards[0]]
        if len(boards) > 1 and has_unit(shared_recordings):
            try:
                _check_held_out(shared_recordings, held_out)
                joint_data = load_jointly(shared_recordings, boards)
            except GyrorigError as fault:
                yield from ((board, fault) for board in boards)
                continue
            yield from explain_unit_boards(joint_data, held_out).items()
            continue
        for board in boards:
            try:
                yield board, explain_board(recordings[board], board, held_out)
            except GyrorigError as fault:
                yield board, fault


def explain_board(
    recordings: Sequence[Recording], board: BoardId, held_out: Recording | None = None
) -> BoardExplanation:
    """Explain one board; see `explain_data`.

    Raises:
        InputError: the board is not in a recording, or there is no reference.
        UsageError: the recordings cannot be fitted together.
    """
    return explain_data(load_board(recordings, board), held_out)


def explain_recordings(recordings: Sequence[Recording], board: str) -> FitExplanation:
    """Search for causes in one board's recordings on a pan-tilt unit."""
    start_s = time.monotonic()
    return explain_fit(fit_base(load_board(recordings, board)), board, start_s)


def explain_data(data: BoardData, held_out: Recording | None = None) -> BoardExplanation:
    """Explain one board whose recordings have the same settings.

    The named causes are tested on `held_out`; nothing is fitted to it.

    Raises:
        InputError: there is no reference.
        UsageError: the recordings cannot be fitted together, or `held_out` is one of them.
    """
    _check_held_out(data.recordings, held_out)
    if data.has_unit:
        return _explain_on_unit(data, explain_fit(fit_base(data), data.board), held_out)
    if data.rests_throughout:
        explanation = _explain_on_unit(data, explain_fit(fit_base(data), data.board), None)
        return replace(explanation, remarks=(*explanation.remarks, *fit_board(data).warnings))
    if data.has_attitudes:
        return _explain_with_attitudes(data, held_out)
    fit = fit_board(data)
    return BoardExplanation(
        board=BoardId(data.board),
        recordings=data.recordings,
        findings=findings_without_rates(fit),
        raw_checks=(*_raw_checks(data), _gain_checks(data, fit.gain)),
        report_series=None,
        remarks=(*fit.warnings, *fit.limited_reasons, NO_RATES_REMARK),
        fit_explanation=None,
        fit=fit,
    )


def explain_unit_boards(
    joint_data: JointData, held_out: Recording | None = None
) -> dict[BoardId, BoardExplanation | GyrorigError]:
    """Explain several boards on one pan-tilt unit together: causes of the unit, and of a board.

    The named causes are tested on `held_out`; nothing is fitted to it.

    Returns:
        Each board's explanation, or the error that prevents it.
    """
    bases: dict[str, ConvergedFit] = {}
    explanations: dict[BoardId, BoardExplanation | GyrorigError] = {
        BoardId(board): fault for board, fault in joint_data.errors.items()
    }
    for board, data in joint_data.boards.items():
        try:
            bases[board] = fit_base(data)
        except GyrorigError as fault:
            explanations[BoardId(board)] = fault
    joint = explain_jointly(bases)
    for board, explanation in joint.items():
        try:
            data = joint_data.boards[board]
            explanations[BoardId(board)] = _explain_on_unit(data, explanation, held_out)
        except GyrorigError as fault:
            explanations[BoardId(board)] = fault
    return explanations


def _check_held_out(recordings: Sequence[Recording], held_out: Recording | None) -> None:
    if held_out is not None:
        check_given_once([*recordings, held_out])


def _explain_on_unit(
    data: BoardData, fit_explanation: FitExplanation, held_out: Recording | None
) -> BoardExplanation:
    gain_checks = _gain_checks(data, fit_explanation.solution_extended.gain)
    held_out_gain, held_out_remarks = _test_held_out(fit_explanation, held_out)
    return BoardExplanation(
        board=BoardId(data.board),
        recordings=data.recordings,
        findings=replace(fit_explanation.findings, other_recording_gain=held_out_gain),
        raw_checks=(*_raw_checks(data), gain_checks),
        report_series=series_of_explanation(fit_explanation),
        remarks=(
            *_convergence_remarks(fit_explanation),
            *_setup_remarks(data, fit_explanation),
            *held_out_remarks,
        ),
        fit_explanation=fit_explanation,
    )


def _convergence_remarks(fit_explanation: FitExplanation) -> list[str]:
    """State that the fit of the base model did not converge, and what was left out therefore."""
    remarks = list(fit_explanation.remarks)
    base, extended = fit_explanation.solution_base, fit_explanation.solution_extended
    if not base.converged:
        without = "" if extended is base else " without the causes"
        remarks.append(
            f"{without} {base.convergence.reason}, so its values are not a result".strip()
        )
    return remarks


def _setup_remarks(data: BoardData, fit_explanation: FitExplanation) -> list[str]:
    """Describe the stage's level, and the bias and time offset of each of several recordings."""
    remarks = []
    sessions = fit_explanation.solution_extended.sessions
    level = stage_level(data.samples[-1], sessions[-1].reference)
    if level is not None:
        remarks.append(level_sentence(level_record(level)))
    if len(data.recordings) > 1:
        for recording, session in zip(data.recordings, sessions, strict=True):
            bias = ", ".join(f"{v:+.4f}" for v in np.degrees(session.bias_rad_s))
            remarks.append(
                f"{recording.path.name}: bias {bias} deg/s, "
                f"time offset {1e3 * session.time_offset_s:.2f} ms"
            )
    return remarks


def _test_held_out(
    fit_explanation: FitExplanation, held_out: Recording | None
) -> tuple[HeldOutGain | None, tuple[str, ...]]:
    """Return the named causes' gain on a recording held out, and a remark where none is named."""
    if held_out is None:
        return None, ()
    if not fit_explanation.findings.causes:
        return None, (NO_CAUSE_REMARK.format(held_out.path.name),)
    base, extended = fit_explanation.solution_base, fit_explanation.solution_extended
    prepared = prepare_held_out(held_out, fit_explanation.board, extended)
    return gain_on_recording(base, extended, prepared), ()


def _raw_checks(data: BoardData) -> list[RawChecks]:
    return [
        RawChecks(recording.path.name, check_stream(samples))
        for recording, samples in zip(data.recordings, data.samples, strict=True)
    ]


def _gain_checks(data: BoardData, gain: FloatArray) -> RawChecks:
    first = data.recordings[0]
    name = first.path.name if len(data.recordings) == 1 else ALL_RECORDINGS
    sensor = first.metadata.get(f"gyrorig.board.{data.board}", {}).get("sensor", "")
    profile = find_profile(sensor)
    tolerance = None if profile is None else profile.scale_tolerance
    return RawChecks(name, check_gain(np.asarray(gain), tolerance))


def load_attitude_recordings(data: BoardData) -> list[AttitudeRecording]:
    """Return a board's recordings that have reference attitudes, ready to be explained.

    Raises:
        InputError: no attitude of a recording is usable.
    """
    loaded = [
        (recording, samples, None)
        for recording, samples in zip(data.recordings, data.samples, strict=True)
        if ATTITUDE_TOPIC in recording.topics
    ]
    return [
        AttitudeRecording(
            recording.path.name, samples, attitude_reference(recording, samples), context
        )
        for (recording, samples, _), context in zip(loaded, read_contexts(loaded), strict=True)
    ]


def _explain_with_attitudes(data: BoardData, held_out: Recording | None) -> BoardExplanation:
    usable = tuple(r for r in data.recordings if ATTITUDE_TOPIC in r.topics)
    other = None
    if held_out is not None:
        (other,) = load_attitude_recordings(load_board([held_out], data.board))
    explanation = explain_attitudes(load_attitude_recordings(data), other)
    fit, remarks = explanation.fit, list(explanation.remarks)
    if held_out is not None and explanation.findings.other_recording_gain is None:
        remarks.append(NO_CAUSE_REMARK.format(held_out.path.name))
    left_out = [
        f"the recording {recording.path.name} was left out, because it has no reference attitudes"
        for recording in data.recordings
        if recording not in usable
    ]
    return BoardExplanation(
        board=BoardId(data.board),
        recordings=usable,
        findings=explanation.findings,
        raw_checks=(*_raw_checks(data), _gain_checks(data, fit.gain)),
        report_series=series_of_attitudes(explanation),
        remarks=(*left_out, *fit.warnings, *fit.limited_reasons, *remarks),
        fit_explanation=None,
        fit=replace(fit, warnings=(*missing_data(data.recordings), *fit.warnings)),
    )


def write_explanation(out: Path, explanation: BoardExplanation) -> WrittenFindings:
    """Write findings, figures and page of one board below `out`.

    Raises:
        MachineError: the folder cannot be written.
    """
    figures = _draw_figures(explanation)
    document = build_document(explanation, {key: figure_path(key) for key in figures})
    path = write_findings(
        out,
        explanation.board,
        to_yaml(document),
        render_findings(document, figures),
        {key: standalone_svg(text) for key, text in figures.items()},
    )
    return WrittenFindings(document, path, path.with_name(PAGE_NAME))


def findings_page(explanation: BoardExplanation) -> tuple[FindingsDocument, str]:
    """Return the document without figure files, and the page with the figures inside."""
    document = build_document(explanation)
    return document, render_findings(document, _draw_figures(explanation))


def build_document(
    explanation: BoardExplanation, figures: Mapping[str, str] | None = None
) -> FindingsDocument:
    """Build the findings document of one board; `figures`: the figures' files by key."""
    metadata = explanation.recordings[0].metadata.get(f"gyrorig.board.{explanation.board}", {})
    origin = FindingsOrigin(
        board=BoardEntry(str(explanation.board), metadata.get("sensor", "")),
        recordings=[InputEntry(r.path.name, r.sha256) for r in explanation.recordings],
        created=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        software=installed_version("gyrorig"),
    )
    return build_findings_document(
        explanation.findings, explanation.raw_checks, origin, figures, explanation.remarks
    )


def _draw_figures(explanation: BoardExplanation) -> dict[str, str]:
    if explanation.report_series is None:
        return {}
    return draw_findings_figures(explanation.report_series, explanation.findings)
