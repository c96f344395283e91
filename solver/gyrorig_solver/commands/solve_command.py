"""`gyrorig solve`: calibrate the boards of recordings; each result is a new version."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import CalibrationStore, calibration_as_mapping
from gyrorig_solver.calibration.calibration_summary import calibration_summary
from gyrorig_solver.commands.board_selection import recordings_by_board
from gyrorig_solver.commands.input_failures import InputFailures, read_with_board
from gyrorig_solver.commands.terminal import (
    NOT_IDENTIFIABLE,
    PARTIAL,
    Terminal,
    board_option,
    choice_option,
    contradiction_option,
    folder_option,
    json_option,
)
from gyrorig_solver.commands.unit_prior_option import read_unit_knowledge, unit_prior_option
from gyrorig_solver.model import plural
from gyrorig_solver.pipeline import (
    AUTO,
    CriticisedFit,
    StoredResult,
    UnitKnowledge,
    fit_together,
    solve_and_store,
)
from gyrorig_solver.storage import Folder, limit_fit_memory, size_of_inputs
from gyrorig_solver.uncertainty import UncertaintySettings, read_settings


@click.command("solve")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@board_option
@choice_option(
    "--method",
    ["likelihood", "paper"],
    "likelihood",
    "likelihood: maximum likelihood; paper: equations 6 to 12 as printed, for comparison.",
)
@click.option(
    "--extend",
    default=AUTO,
    show_default=True,
    metavar="auto|none|CAUSE,...",
    help="Causes to fit in addition to the base model: auto for those that a search finds in the "
    "recordings, names such as thermal_bias, or none. Tests of all other causes always run.",
)
@folder_option(
    "calibrations", "Folder for the results: OUT/<board>/v0001.yaml and v0001.report.html."
)
@click.option(
    "--uncertainty",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="YAML file with prior sizes of the causes and thresholds of the verdict, to replace the "
    "shipped ones (format: docs/units.md).  [default: the shipped ones]",
)
@unit_prior_option
@contradiction_option
@json_option
@click.pass_obj
def solve_command(
    terminal: Terminal,
    recordings: tuple[Path, ...],
    board: str | None,
    method: str,
    extend: str,
    out: Path,
    uncertainty: Path | None,
    unit_prior: str,
    allow_contradiction: bool,
) -> int:
    r"""Calibrate every board in the recordings; write a calibration and a report each.

    All recordings of one board are solved together and give one version; each has its own bias
    and time offset. Recordings whose gains contradict each other are refused. Boards on the same
    pan-tilt unit are solved together: they share the motion and any unit-related error. Boards on
    one CAN bus also share a time base. With --board, one board is solved alone. The exit status is
    4 if the motion did not determine a parameter; the calibration says which, and why.

    \b
    Example:
      gyrorig solve demo/session.mcap --out calibrations
      gyrorig solve static.mcap monday.mcap friday.mcap --extend thermal_bias,g_sensitivity
    """
    request = _SolveRequest(
        method,
        _requested_causes(extend, method),
        out,
        None if uncertainty is None else read_settings(uncertainty),
        read_unit_knowledge(unit_prior, Folder(out)),
        allow_contradiction,
    )
    failures = InputFailures()
    read = read_with_board(terminal, recordings, board, failures)
    name = recordings[0].name if len(recordings) == 1 else f"{len(recordings)} recordings"
    messages = sum(recording.message_count for recording in read)
    with limit_fit_memory(name, size_of_inputs(recordings), messages):
        return _solve_recordings(terminal, read, board, request, failures)


@dataclass(frozen=True, slots=True)
class _SolveRequest:
    """How to solve every board."""

    method: str
    causes: Sequence[str]
    out: Path
    settings: UncertaintySettings | None
    knowledge: UnitKnowledge
    allow_contradiction: bool

    def solve(
        self,
        recordings: Sequence[Recording],
        board: BoardId,
        ready: CriticisedFit | GyrorigError | None,
    ) -> StoredResult:
        """Solve one board, or write its part of a joint solution."""
        if isinstance(ready, GyrorigError):
            raise ready
        return solve_and_store(
            CalibrationStore(self.out),
            recordings,
            board,
            self.method,
            self.causes,
            ready,
            uncertainty=self.settings,
            unit_knowledge=self.knowledge,
            allow_contradiction=self.allow_contradiction,
        )


def _solve_recordings(
    terminal: Terminal,
    recordings: Sequence[Recording],
    board: str | None,
    request: _SolveRequest,
    failures: InputFailures,
) -> int:
    """Solve and print, and return the exit status; `failures`: of the recordings so far."""
    solved: list[StoredResult] = []
    causes = request.causes
    for names, group in _boards_solved_together(
        recordings, board, one_by_one=request.method == "paper"
    ):
        board_text = names[0] if len(names) == 1 else f"{len(names)} boards"
        recording_names = ", ".join(recording.path.name for recording in group)
        terminal.print_progress(f"solving {board_text} of {recording_names}")
        ready = fit_together(group, names, request.method, causes, request.allow_contradiction)
        for name in names:
            try:
                result = request.solve(group, name, ready.get(name))
                solved.append(result)
                terminal.print_result(_result_text(result), result.calibration.trust.verdict)
            except GyrorigError as fault:
                failures.add(fault, group[0].path, str(name))
    failures.report(terminal, bool(solved))
    if not solved:
        code = failures.faults[0].exit_code
    elif failures.rows:
        code = PARTIAL
    else:
        code = NOT_IDENTIFIABLE if any(_is_incomplete(r, causes) for r in solved) else 0
    boards = [_result_json(result) for result in solved]
    terminal.print_json({"boards": boards, "failed": failures.rows, "exit_code": code})
    return code


def _requested_causes(extend: str, method: str) -> tuple[str, ...]:
    """Return the causes to fit in addition to the base model.

    Raises:
        UsageError: the method cannot fit causes.
    """
    causes = tuple(name.strip() for name in extend.split(",") if name.strip() not in ("", "none"))
    if method == "paper":
        if causes in ((), (AUTO,)):
            return ()
        raise UsageError(
            "the option --method paper cannot fit causes, but the option --extend names some",
            "remove the option --extend, or use --method likelihood",
        )
    return causes


def _is_incomplete(solved: StoredResult, causes: Sequence[str]) -> bool:
    """Return whether a parameter or a requested cause was not determined."""
    calibration = solved.calibration
    missing = set(causes) - {AUTO} - set(calibration.solver.terms)
    return bool(calibration.observability.unobservable or missing)


def _boards_solved_together(
    recordings: Sequence[Recording], wanted: str | None, one_by_one: bool
) -> Iterator[tuple[list[BoardId], list[Recording]]]:
    """Yield groups of boards with their recordings; each group is solved together.

    Boards of the same recordings are in one group.
    """
    if one_by_one:
        for recording in recordings:
            for board in recording.board_ids:
                if wanted in (None, board):
                    yield [board], [recording]
        return
    pooled = recordings_by_board(recordings, wanted)
    groups: dict[tuple[int, ...], list[BoardId]] = {}
    for board, of_board in pooled.items():
        groups.setdefault(tuple(id(recording) for recording in of_board), []).append(board)
    for boards in groups.values():
        yield boards, pooled[boards[0]]


def _result_text(solved: StoredResult) -> str:
    findings, lines = solved.calibration.findings, [calibration_summary(solved.calibration)]
    if findings is not None:
        causes = f": {', '.join(findings.distinct_causes)}" if findings.causes else ""
        lines.append(f"  findings              {findings.verdict}{causes}")
        lines.append(f"                        {solved.path.with_name(findings.file)}")
    prior = solved.calibration.unit_prior
    if prior is not None:
        count = plural(prior.recordings, "recording")
        lines.append(f"  unit                  {prior.id} version {prior.version}, of {count}")
    if solved.unit_version is not None:
        lines.append(f"  unit, new version     {solved.unit_version}")
    if solved.other_board is not None:
        lines.append(f"  remark: {solved.other_board}")
    lines.append(f"  calibration           {solved.path}")
    lines.append(f"  report                {solved.report}")
    return "\n".join(lines)


def _result_json(solved: StoredResult) -> dict[str, Any]:
    calibration = solved.calibration
    return {
        "board": calibration.board.id,
        "version": calibration.version,
        "verdict": calibration.trust.verdict,
        "file": str(solved.path),
        "report": str(solved.report),
        **({} if solved.unit_version is None else {"unit_version": solved.unit_version}),
        **({} if solved.other_board is None else {"other_board": solved.other_board}),
        "calibration": calibration_as_mapping(calibration),
    }
