"""Explain a board: checks of the raw stream, search for causes, findings document and report.

What to use when: `explain_boards` for several boards, `explain_board` for one, `explain_data` if
its recordings are loaded already; `write_explanation` for the folder of findings.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version as installed_version
from pathlib import Path

import msgspec

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.recording_names import distinct_names
from gyrorig_solver.data.utc_time import utc_text_now
from gyrorig_solver.discover import explain_jointly
from gyrorig_solver.estimate import ConvergedFit
from gyrorig_solver.findings import (
    FindingsDocument,
    build_findings_document,
    to_yaml,
    write_findings,
)
from gyrorig_solver.findings.findings_builder import NEXT_PROGRAM_NAME, FindingsOrigin
from gyrorig_solver.findings.findings_document import BoardEntry, InputEntry
from gyrorig_solver.findings.findings_files import PAGE_NAME, figure_path
from gyrorig_solver.pipeline.board_data import BoardData, check_given_once, has_unit, load_board
from gyrorig_solver.pipeline.board_results import BoardExplanation
from gyrorig_solver.pipeline.joint_data import JointData, load_jointly
from gyrorig_solver.pipeline.motion_explanation import explain_motion
from gyrorig_solver.pipeline.one_board import check_same_board
from gyrorig_solver.pipeline.prepare_board import fit_base
from gyrorig_solver.pipeline.recording_agreement import require_agreement
from gyrorig_solver.plan import program_text, write_new_file
from gyrorig_solver.report import draw_findings_figures, render_findings
from gyrorig_solver.report.figure_layout import standalone_svg


@dataclass(frozen=True, slots=True)
class WrittenFindings:
    """The files of one board's findings."""

    document: FindingsDocument
    path: Path
    page: Path


def explain_boards(
    recordings: Mapping[BoardId, Sequence[Recording]],
    held_out: Recording | None = None,
    allow_contradiction: bool = False,
) -> Iterator[tuple[BoardId, BoardExplanation | GyrorigError]]:
    """Explain several boards; boards on one unit in the same recordings are explained together.

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
                joint_data = load_jointly(shared_recordings, boards, allow_contradiction)
            except GyrorigError as fault:
                yield from ((board, fault) for board in boards)
                continue
            yield from explain_unit_boards(joint_data, held_out).items()
            continue
        for board in boards:
            try:
                data = load_board(recordings[board], board, allow_contradiction)
                yield board, explain_data(data, held_out)
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


def explain_data(data: BoardData, held_out: Recording | None = None) -> BoardExplanation:
    """Explain one board whose recordings have the same settings.

    The named causes are tested on `held_out`; nothing is fitted to it.

    Raises:
        InputError: there is no reference.
        UsageError: the recordings cannot be fitted together or contradict each other, or
            `held_out` is one of them or is of another board.
    """
    _check_held_out(data, held_out)
    data = require_agreement(data)
    return data.kind.explain(data, held_out)


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
            _check_held_out(data, held_out)
            bases[board] = fit_base(data)
        except GyrorigError as fault:
            explanations[BoardId(board)] = fault
    joint = explain_jointly(bases)
    for board, explanation in joint.items():
        try:
            data = joint_data.boards[board]
            explanations[BoardId(board)] = explain_motion(data, explanation, held_out)
        except GyrorigError as fault:
            explanations[BoardId(board)] = fault
    return explanations


def _check_held_out(data: BoardData, held_out: Recording | None) -> None:
    """Refuse a held-out recording that is one of the fitted ones, or of another board."""
    if held_out is None:
        return
    check_given_once([*data.recordings, held_out])
    metadata = held_out.metadata.get(f"gyrorig.board.{data.board}")
    if metadata is not None:  # the reader of its samples refuses a recording without the board
        check_same_board(
            data.board,
            [*data.names, held_out.path.name],
            [*(samples.metadata for samples in data.samples), metadata],
        )


def write_explanation(
    out: Path, explanation: BoardExplanation, program_path: Path | None = None
) -> WrittenFindings:
    """Write findings, figures, page and proposed program of one board below `out`.

    `program_path`: the new file of the program; by default it is in the folder of the findings.

    Raises:
        UsageError: the file of the program exists, or its folder does not.
        MachineError: the folder cannot be written.
    """
    figures = _draw_figures(explanation)
    document = build_document(explanation, {key: figure_path(key) for key in figures}, program_path)
    program = program_document(explanation)
    if program is not None and program_path is not None:
        write_new_file(program_path, program)
        program = None
    path = write_findings(
        out,
        explanation.board,
        to_yaml(document),
        render_findings(document, figures),
        {key: standalone_svg(text) for key, text in figures.items()},
        program,
    )
    return WrittenFindings(document, path, path.with_name(PAGE_NAME))


def program_document(explanation: BoardExplanation) -> str | None:
    """Return the proposed program of an explanation as YAML; None without one."""
    proposed = explanation.next_experiment
    if proposed is None or proposed.program is None:
        return None
    verbs = {1: "shows", 2: "separates"}
    purposes = ", ".join(
        f"{verbs[len(outlook.causes)]} {' from '.join(outlook.causes)}"
        for outlook in proposed.outlooks
        if outlook.is_separated
    )
    return program_text(msgspec.structs.replace(proposed.program, description=purposes))


def findings_page(explanation: BoardExplanation) -> tuple[FindingsDocument, str]:
    """Return the document without figure files, and the page with the figures inside."""
    document = build_document(explanation)
    return document, render_findings(document, _draw_figures(explanation))


def build_document(
    explanation: BoardExplanation,
    figures: Mapping[str, str] | None = None,
    program_path: Path | None = None,
) -> FindingsDocument:
    """Build the findings document of one board.

    Args:
        explanation: of the board.
        figures: the figures' files by key.
        program_path: of the proposed program; by default it is in the folder of the document.
    """
    metadata = explanation.recordings[0].metadata.get(f"gyrorig.board.{explanation.board}", {})
    origin = FindingsOrigin(
        board=BoardEntry(str(explanation.board), metadata.get("sensor", "")),
        recordings=[
            InputEntry(name, recording.sha256)
            for name, recording in zip(
                distinct_names(explanation.recordings), explanation.recordings, strict=True
            )
        ],
        created=utc_text_now(),
        software=installed_version("gyrorig"),
        link=explanation.link,
    )
    return build_findings_document(
        explanation.findings,
        explanation.raw_checks,
        origin,
        figures,
        explanation.remarks,
        explanation.next_experiment,
        NEXT_PROGRAM_NAME if program_path is None else str(program_path),
    )


def _draw_figures(explanation: BoardExplanation) -> dict[str, str]:
    if explanation.report_series is None:
        return {}
    return draw_findings_figures(explanation.report_series, explanation.findings)
