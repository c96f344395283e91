"""`gyrorig explain`: find errors in the rig model and identify their causes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_solver.commands.board_selection import read_within_limits, recordings_by_board
from gyrorig_solver.commands.input_failures import InputFailures, read_with_board
from gyrorig_solver.commands.terminal import (
    NOT_IDENTIFIABLE,
    PARTIAL,
    Terminal,
    contradiction_option,
    folder_option,
    json_option,
)
from gyrorig_solver.findings import FindingsDocument, findings_summary, next_experiment_lines
from gyrorig_solver.findings.findings_document import to_plain
from gyrorig_solver.model import find_term
from gyrorig_solver.pipeline import WrittenFindings, explain_boards, write_explanation
from gyrorig_solver.pipeline.next_experiment import with_next_experiment
from gyrorig_solver.plan import MAX_PROGRAM_S, load_rig, require_new_path


@click.command("explain")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--board", help="Only this board.  [default: every board in the recordings]")
@folder_option(
    "findings",
    "The folder: OUT/<board>/findings.yaml, report.html and figures; earlier findings are "
    "kept as findings-0001.yaml.",
)
@click.option(
    "--held-out",
    type=click.Path(path_type=Path),
    help="Another recording, to test the named causes on; the causes are not fitted to it.  "
    "[default: none]",
)
@click.option(
    "--next-seconds",
    type=click.FloatRange(0.0, 3600.0),
    default=MAX_PROGRAM_S,
    show_default=True,
    help="The longest motion program to propose where a set of causes is stated; 0: propose none.",
)
@click.option(
    "--next-cause",
    "next_causes",
    multiple=True,
    metavar="CAUSE",
    help="Also propose a motion program that shows this cause of the catalogue at its typical "
    "size. Can be repeated.  [default: none]",
)
@click.option(
    "--next-program",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The new file of the proposed motion program.  [default: OUT/<board>/next-program.yaml]",
)
@click.option(
    "--rig",
    "rig_path",
    type=click.Path(path_type=Path),
    help="The rig file: the proposed motion program stays within its limits.  "
    "[default: the limits that the unit reported]",
)
@contradiction_option
@json_option
@click.pass_obj
def explain_command(
    terminal: Terminal,
    recordings: tuple[Path, ...],
    board: str | None,
    out: Path,
    held_out: Path | None,
    next_seconds: float,
    next_causes: tuple[str, ...],
    next_program: Path | None,
    rig_path: Path | None,
    allow_contradiction: bool,
) -> int:
    r"""Find errors in the rig model and identify their causes, as far as the data allow.

    All recordings of one board are searched together, and all boards on one unit: a cause that
    all boards show belongs to the unit. The raw samples are checked first, then the residual of
    the model. Each cause is tested on data that it was not fitted to. Exits with status 4 when
    no cause can be tested with these recordings; the findings list what would be needed.

    With --held-out the fitted model is tested on another recording. Only bias, time offset and
    the motion's own unknowns are fitted there; causes of one moment or one recording are
    left out.

    Where the data cannot separate some causes, the command proposes a motion program that
    separates them, and says what to expect. Record it, and explain both recordings together.

    \b
    Example:
      gyrorig explain demo/session.mcap --out findings
      gyrorig explain monday.mcap --held-out tuesday.mcap
    """
    for cause in next_causes:
        find_term(cause)
    rig = None if rig_path is None else load_rig(rig_path)
    if next_program is not None:
        require_new_path(next_program, "--next-program")
    held_out_recording = None if held_out is None else read_within_limits(held_out)
    failures = InputFailures()
    usable = read_with_board(terminal, recordings, board, failures)
    written: list[WrittenFindings] = []
    recordings_of_board = recordings_by_board(usable, board)
    if next_program is not None and len(recordings_of_board) > 1:
        raise UsageError(
            "the option --next-program gives one file, but the recordings have several boards",
            "select a board with --board, or leave the option out",
        )
    terminal.print_progress(f"explaining {', '.join(recordings_of_board)}")
    for name, explanation in explain_boards(
        recordings_of_board, held_out_recording, allow_contradiction
    ):
        try:
            if isinstance(explanation, GyrorigError):
                raise explanation
            terminal.print_progress(f"planning the next experiment of {name}")
            planned = with_next_experiment(explanation, rig, next_seconds, next_causes)
            written.append(write_explanation(out, planned, next_program))
            terminal.print_result(findings_text(written[-1]))
        except GyrorigError as fault:
            failures.add(fault, recordings_of_board[name][0].path, str(name))
    failures.report(terminal, bool(written))
    code = exit_code([written_board.document for written_board in written], failures.faults)
    boards = [findings_json(written_board) for written_board in written]
    terminal.print_json({"boards": boards, "failed": failures.rows, "exit_code": code})
    return code


def exit_code(documents: Sequence[FindingsDocument], faults: Sequence[GyrorigError]) -> int:
    """Return 5 where some boards failed, 4 where a board's recordings test no cause."""
    if faults:
        return PARTIAL if documents else faults[0].exit_code
    # Without a gain and without limits, only the raw samples could be checked.
    untested = any(
        document.gain is None and not document.minimal_detectable for document in documents
    )
    return NOT_IDENTIFIABLE if untested else 0


def findings_text(written: WrittenFindings) -> str:
    """Return one board's findings as lines for a terminal."""
    lines = [
        findings_summary(written.document),
        f"  findings              {written.path}",
        f"  report                {written.page}",
    ]
    proposed = written.document.next_experiment
    if proposed is not None and proposed.program is not None:
        path = written.path.parent / proposed.program
        seconds = "" if proposed.seconds is None else f" ({proposed.seconds:.0f} s)"
        lines.append(f"Next: record {path}{seconds}, then explain all recordings together.")
    return "\n".join([*lines, *next_experiment_lines(written.document)])


def findings_json(written: WrittenFindings) -> dict[str, Any]:
    """Return one board's findings as plain values."""
    return {
        "board": written.document.board.id,
        "verdict": written.document.verdict,
        "file": str(written.path),
        "report": str(written.page),
        "findings": to_plain(written.document),
    }
