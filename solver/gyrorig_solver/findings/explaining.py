"""One board, all the way: the raw stream, the search for causes, the document, the page.

What to use when: `explain_into` for a folder with everything, `explain_board` where the parts
are to be used otherwise; `explain_together` for several boards, those of one unit together.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version as installed_version
from pathlib import Path

import numpy as np

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.profiles import find_profile
from gyrorig_solver.calibration.wording import level_words
from gyrorig_solver.discover.attitude import explain_attitudes
from gyrorig_solver.discover.boards import explain_boards
from gyrorig_solver.discover.finder import explain
from gyrorig_solver.discover.gain import held_out_by
from gyrorig_solver.discover.result import Explained, Findings, Gain
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.findings.build import Origin, RawEvidence, document_of
from gyrorig_solver.findings.document import FindingsDocument, Input, Subject, to_yaml
from gyrorig_solver.findings.plain import findings_of_fit
from gyrorig_solver.findings.writing import PAGE, figure_name, write_findings
from gyrorig_solver.on_unit import level_of, rests_throughout, unit_solution
from gyrorig_solver.raw.checks import look_at
from gyrorig_solver.raw.gain import look_at_gain
from gyrorig_solver.raw.result import Look
from gyrorig_solver.report.course import Course, course_of, course_of_attitudes, course_of_fit
from gyrorig_solver.report.drawing import alone
from gyrorig_solver.report.explain_html import figures_of, render_findings
from gyrorig_solver.samples import load_samples
from gyrorig_solver.solve import solve_recordings

UNJUDGED = "nothing here judges the residual over time: the reference has angles, no motion"
NOTHING = "no cause was named, so {} had nothing to measure"
TOGETHER = "all recordings"  # what a look at the common gain is of


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """What is known of one board before it is written."""

    board: BoardId
    recordings: tuple[Recording, ...]
    findings: Findings
    raw: tuple[RawEvidence, ...]
    course: Course | None  # None: nothing to draw from
    remarks: tuple[str, ...]
    explained: Explained | None  # None where the reference is no unit's motion


@dataclass(frozen=True, slots=True)
class Written:
    """One board's findings, as they lie in the folder."""

    document: FindingsDocument
    path: Path
    page: Path


def explain_into(
    out: Path,
    recordings: Sequence[Recording],
    board: BoardId,
    held_out: Recording | None = None,
) -> Written:
    """Explain one board, and write its findings, figures and page below `out`.

    `held_out`: see `explain_board`.

    Raises:
        InputError: the recordings hold no board of that name, or nothing to compare it with.
        UsageError: recordings that cannot be looked at together.
        MachineError: the folder cannot be written.
    """
    return write_explanation(out, explain_board(recordings, board, held_out))


def explain_together(
    recordings: Mapping[BoardId, Sequence[Recording]], held_out: Recording | None = None
) -> Iterator[tuple[BoardId, Explanation | GyrorigError]]:
    """Look at several boards, those that were on one unit in the same recordings together.

    Args:
        recordings: those of each board, in any order.
        held_out: a recording on which the named causes are measured, and nothing else.

    Yields:
        Each board with what is known of it, or why it could not be looked at.
    """
    groups: dict[tuple[str, ...], list[BoardId]] = {}
    for board, own in recordings.items():
        groups.setdefault(tuple(sorted(r.sha256 for r in own)), []).append(board)
    for boards in groups.values():
        own = recordings[boards[0]]
        if len(boards) > 1 and _of_a_unit(own):
            yield from explain_unit(own, boards, held_out).items()
            continue
        for board in boards:
            try:
                yield board, explain_board(recordings[board], board, held_out)
            except GyrorigError as fault:
                yield board, fault


def explain_board(
    recordings: Sequence[Recording], board: BoardId, held_out: Recording | None = None
) -> Explanation:
    """Look at one board of one or more recordings of the same settings.

    Args:
        recordings: in any order.
        board: in each of them.
        held_out: a recording on which the named causes are measured, and nothing else.

    Raises:
        InputError: the recordings hold no board of that name, or nothing to compare it with.
        UsageError: recordings that cannot be looked at together.
    """
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    if _of_a_unit(ordered):
        return _on_unit(ordered, explain(ordered, board), held_out)
    if rests_throughout(ordered, board):
        found = _on_unit(ordered, explain(ordered, board), None)
        return replace(found, remarks=(*found.remarks, *solve_recordings(ordered, board).warnings))
    raw = _raw(ordered, board)
    if any("/reference/attitude" in r.topics for r in ordered):
        return _beside_attitudes(ordered, board, raw, held_out)
    fit = solve_recordings(ordered, board)
    raw.append(RawEvidence(_together(ordered), _judged(fit.gain, ordered[0], board)))
    return Explanation(
        board=board,
        recordings=tuple(ordered),
        findings=findings_of_fit(fit),
        raw=tuple(raw),
        course=course_of_fit(fit),
        remarks=(*fit.warnings, *fit.distrust, *(() if fit.diagnostics else (UNJUDGED,))),
        explained=None,
    )


def explain_unit(
    recordings: Sequence[Recording], boards: Sequence[BoardId], held_out: Recording | None = None
) -> dict[BoardId, Explanation | GyrorigError]:
    """Look at several boards on one pan-tilt unit: what is the unit's, and what each board's.

    Args:
        recordings: in any order.
        boards: in each of them.
        held_out: a recording on which the named causes are measured, and nothing else.

    Returns:
        Each board's findings, or why it could not be looked at.
    """
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    bases: dict[BoardId, Solution] = {}
    found: dict[BoardId, Explanation | GyrorigError] = {}
    for board in boards:
        try:
            bases[board] = unit_solution(ordered, board)
        except GyrorigError as fault:
            found[board] = fault
    together = explain_boards({str(board): base for board, base in bases.items()})
    for board in bases:
        try:
            found[board] = _on_unit(ordered, together[str(board)], held_out)
        except GyrorigError as fault:
            found[board] = fault
    return found


def _on_unit(
    ordered: Sequence[Recording], explained: Explained, held_out: Recording | None
) -> Explanation:
    """Put together what is known of a board on a unit."""
    board = BoardId(explained.board)
    gain = explained.solution_extended.gain
    judged = RawEvidence(_together(ordered), _judged(gain, ordered[0], board))
    return Explanation(
        board=board,
        recordings=tuple(ordered),
        findings=replace(explained.findings, elsewhere=_elsewhere(explained, held_out)),
        raw=(*_raw(ordered, board), judged),
        course=course_of(explained),
        remarks=(*_stands(ordered, explained), *_no_gain(explained, held_out)),
        explained=explained,
    )


def _stands(ordered: Sequence[Recording], explained: Explained) -> tuple[str, ...]:
    """Say how the unit stands, and what is each recording's own where there are several."""
    said = []
    reference = explained.solution_extended.sessions[-1].reference
    level = level_of(load_samples(ordered[-1], explained.board), reference)
    if level is not None:
        zero = level.tilt_zero_rad, level.tilt_zero_std_rad
        said.append(level_words(zero, level.lean_rad, level.lean_std_rad, level.rests))
    if len(ordered) > 1:
        for recording, session in zip(ordered, explained.solution_extended.sessions, strict=True):
            bias = ", ".join(f"{v:+.4f}" for v in np.degrees(session.bias_rad_s))
            offset_ms = 1e3 * session.time_offset_s
            said.append(
                f"{recording.path.name} by itself: bias {bias} deg/s, "
                f"time offset {offset_ms:.2f} ms"
            )
    return tuple(said)


def _raw(ordered: Sequence[Recording], board: BoardId) -> list[RawEvidence]:
    return [RawEvidence(r.path.name, look_at(load_samples(r, board))) for r in ordered]


def _of_a_unit(recordings: Sequence[Recording]) -> bool:
    return any("/ptu/position" in r.topics for r in recordings)


def _beside_attitudes(
    ordered: Sequence[Recording],
    board: BoardId,
    raw: Sequence[RawEvidence],
    held_out: Recording | None,
) -> Explanation:
    """Look at a board that a reference told the attitude of, a camera say."""
    some = [r for r in ordered if "/reference/attitude" in r.topics]
    found = explain_attitudes(some, board, held_out)
    fit = found.fit
    none = held_out is not None and found.findings.elsewhere is None
    gone = [f"{r.path.name} has no reference attitude: left out" for r in ordered if r not in some]
    nothing = () if not none or held_out is None else (NOTHING.format(held_out.path.name),)
    return Explanation(
        board=board,
        recordings=tuple(some),
        findings=found.findings,
        raw=(*raw, RawEvidence(_together(ordered), _judged(fit.gain, some[0], board))),
        course=course_of_attitudes(found),
        remarks=(*gone, *fit.warnings, *fit.distrust, *found.remarks, *nothing),
        explained=None,
    )


def _elsewhere(explained: Explained, held_out: Recording | None) -> Gain | None:
    """Return what the named causes are worth on a recording held out."""
    if held_out is None or not explained.findings.causes:
        return None
    base, extended = explained.solution_base, explained.solution_extended
    return held_out_by(base, extended, held_out, explained.board)


def _no_gain(explained: Explained, held_out: Recording | None) -> tuple[str, ...]:
    if held_out is None or explained.findings.causes:
        return ()
    return (NOTHING.format(held_out.path.name),)


def write_explanation(out: Path, found: Explanation) -> Written:
    """Write findings, figures and page of one board below `out`.

    Raises:
        MachineError: the folder cannot be written.
    """
    figures = _figures(found)
    document = document_of_found(found, {key: figure_name(key) for key in figures})
    path = write_findings(
        out,
        found.board,
        to_yaml(document),
        render_findings(document, figures),
        {key: alone(text) for key, text in figures.items()},
    )
    return Written(document, path, path.with_name(PAGE))


def page_of_found(found: Explanation) -> tuple[FindingsDocument, str]:
    """Return the document without files of figures, and the page with them in it."""
    document = document_of_found(found)
    return document, render_findings(document, _figures(found))


def document_of_found(
    found: Explanation, figures: Mapping[str, str] | None = None
) -> FindingsDocument:
    """Return the document of one board; `figures`: their files by key."""
    return document_of(found.findings, found.raw, origin_of(found), figures, found.remarks)


def _figures(found: Explanation) -> dict[str, str]:
    return {} if found.course is None else figures_of(found.course, found.findings)


def origin_of(found: Explanation) -> Origin:
    """Return what the findings are of."""
    metadata = found.recordings[0].metadata.get(f"gyrorig.board.{found.board}", {})
    return Origin(
        board=Subject(str(found.board), metadata.get("sensor", "")),
        recordings=[Input(r.path.name, r.sha256) for r in found.recordings],
        created=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        software=installed_version("gyrorig"),
    )


def _judged(gain: FloatArray, recording: Recording, board: BoardId) -> tuple[Look, ...]:
    sensor = recording.metadata.get(f"gyrorig.board.{board}", {}).get("sensor", "")
    profile = find_profile(sensor)
    tolerance = None if profile is None else profile.scale_tolerance
    return look_at_gain(np.asarray(gain), tolerance)


def _together(recordings: Sequence[Recording]) -> str:
    return recordings[0].path.name if len(recordings) == 1 else TOGETHER
