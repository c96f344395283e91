"""`gyrorig demo`: record, check, solve and explain on an emulated rig, then compare.

The devices are emulated on ptys; the daemon is the real one, in a separate process. The
true values are not read before the search for causes has ended.
"""

import contextlib
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import GyrorigError, InputError, MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.check import (
    ParameterComparison,
    compare_with_truth,
    examine_recording,
    score_causes,
)
from gyrorig_solver.check.injected_causes import ScoredCause, score_text, verify_commitment
from gyrorig_solver.commands.check_command import health_text
from gyrorig_solver.commands.compare_command import (
    WRONG_BEYOND_SIGMA,
    comparison_json,
    comparison_summary,
    comparison_table,
)
from gyrorig_solver.commands.daemon_commands import daemon_command
from gyrorig_solver.commands.project_files import project_file
from gyrorig_solver.commands.terminal import NOT_IDENTIFIABLE, Terminal, folder_option, json_option
from gyrorig_solver.findings import findings_summary
from gyrorig_solver.pipeline import (
    StoredResult,
    WrittenFindings,
    solve_and_store,
    write_explanation,
)
from gyrorig_solver.pipeline.explain_board import explain_board

HALT_TIMEOUT_S = 20.0  # a unit comes to rest from full speed, and the file is closed


class DaemonFailedError(GyrorigError):
    """The daemon ended with an error; its own line and exit code are passed on."""


@click.command("demo")
@folder_option("demo", "Folder for the recording, the calibration, the report and the true values.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Random seed of the emulated rig, board and noise.  [default: 1, from config/rig.yaml]",
)
@click.option(
    "--program",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Motion program.  [default: config/programs/quick.yaml, 40 s]",
)
@click.option(
    "--hide",
    multiple=True,
    metavar="CAUSE[@PLACE][:SIZE]",
    help=(
        "Add a cause to the emulated rig, which the search should then find. `random` chooses a "
        "cause and keeps it secret until the end. `gyrorigd causes` lists causes, places and "
        "units. Can be repeated."
    ),
)
@json_option
@click.pass_obj
def demo_command(
    terminal: Terminal,
    out: Path,
    seed: int | None,
    program: Path | None,
    hide: tuple[str, ...],
) -> int:
    r"""Record, check, solve and explain on an emulated rig; then compare with the true values.

    \b
    Example:
      gyrorig demo --out demo --seed 7
      gyrorig demo --out demo --hide backlash@tilt --program config/programs/full.yaml
      gyrorig demo --out demo --hide random
    """
    program = program or project_file("programs", "quick.yaml")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise MachineError(
            f"the output folder {out} cannot be created ({fault.strerror})",
            "choose another folder with --out",
        ) from fault
    seed_text = "" if seed is None else f", seed {seed}"
    terminal.print_result(f"1  Recording on an emulated rig{seed_text}, program {program.stem}")
    with terminal.hide_elapsed_time():  # the daemon shows its own
        demo_recording = _record_session(out, seed, program, hide)
    recording = read_recording(demo_recording.path)
    terminal.print_result(f"   {demo_recording.path}")
    if demo_recording.seal:
        terminal.print_result(
            f"   A cause is hidden. SHA-256 of its description: {demo_recording.seal}"
        )
    terminal.print_result("2  Checking the recording")
    terminal.print_result(_indent(health_text(examine_recording(recording, recording.board_ids))))
    terminal.print_result("3  Solving")
    solved = []
    for board in recording.board_ids:
        store = CalibrationStore(out / "calibrations")
        solved.append(solve_and_store(store, [recording], board))
        terminal.print_result(f"   {solved[-1].path}")
    terminal.print_result("4  Searching for errors in the rig model")
    written = [_explain_board(terminal, out, recording, stored) for stored in solved]
    terminal.print_result("5  Comparing with the true values of the emulated rig")
    truth = parse_yaml(demo_recording.truth.read_bytes(), str(demo_recording.truth), InputError)
    verify_commitment(truth, demo_recording.seal or None)
    results = [
        BoardResult(
            stored,
            compare_with_truth(stored.calibration, truth),
            findings,
            [] if findings is None else score_causes(findings.document, truth),
        )
        for stored, findings in zip(solved, written, strict=True)
    ]
    for result in results:
        board_info = result.solved.calibration.board
        terminal.print_result(f"   {board_info.id}, {board_info.sensor}")
        terminal.print_result(_indent(comparison_table(result.rows)))
        terminal.print_result(_indent(comparison_summary(result.rows)))
        if hide and result.written is not None:
            terminal.print_result(score_text(result.written.document, result.scored))
    terminal.print_result(_report_lines(results))
    code = _exit_code(results, bool(hide))
    terminal.print_json(
        {
            "recording": str(demo_recording.path),
            "seal": demo_recording.seal or None,
            "boards": [_result_json(result) for result in results],
            "exit_code": code,
        }
    )
    return code


@dataclass(frozen=True, slots=True)
class DemoRecording:
    """Files that the daemon wrote."""

    path: Path
    truth: Path  # not read before the end
    seal: str  # SHA-256 of the hidden causes; empty if they are not secret


@dataclass(frozen=True, slots=True, eq=False)
class BoardResult:
    """Results of one board."""

    solved: StoredResult
    rows: list[ParameterComparison]
    written: WrittenFindings | None  # None: no search was possible
    scored: list[ScoredCause]


def _explain_board(
    terminal: Terminal, out: Path, recording: Recording, solved: StoredResult
) -> WrittenFindings | None:
    """Write one board's findings; None, and a message, if no search is possible."""
    board = BoardId(solved.calibration.board.id)
    try:
        explanation = solved.explanation or explain_board([recording], board)
    except InputError as fault:
        terminal.print_result(f"   {board}: no search for causes. {fault}")
        return None
    written = write_explanation(out / "findings", explanation)
    terminal.print_result(_indent(findings_summary(written.document)))
    return written


def _record_session(
    out: Path, seed: int | None, program: Path, hide: tuple[str, ...]
) -> DemoRecording:
    """Run the daemon on the emulated rig; the true values stay unread.

    Raises:
        DaemonFailedError: it ended with an error.
        InputError: it did not name its recording.
    """
    truth_path = out / "truth.yaml"
    command = daemon_command(
        "record",
        *("--config", str(project_file("rig.yaml")), "--program", str(program)),
        *("--out", str(out), "--truth", str(truth_path), "--json"),
        *(() if seed is None else ("--seed", str(seed))),
        *(word for cause in hide for word in ("--hide", cause)),
    )
    output = _run_daemon(command)
    try:
        answer = json.loads(output)
        return DemoRecording(Path(answer["recording"]), truth_path, str(answer.get("seal", "")))
    except (json.JSONDecodeError, KeyError, TypeError) as fault:
        raise InputError(
            "the daemon ended, but its output does not contain the name of the recording",
            "run `gyrorigd record` with the same --config and --program to see the reason",
        ) from fault


def _run_daemon(command: list[str]) -> str:
    """Run the daemon to its end; on Ctrl-C let it halt the unit.

    On a terminal its progress and errors appear directly.
    """
    is_terminal = sys.stderr.isatty()
    with subprocess.Popen(  # noqa: S603 - our own interpreter, no shell
        command, stdout=subprocess.PIPE, stderr=None if is_terminal else subprocess.PIPE, text=True
    ) as process:
        try:
            output, faults = process.communicate()
        except KeyboardInterrupt:
            # The terminal sends it the same signal: it halts the unit and closes the file.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(HALT_TIMEOUT_S)
            process.terminate()
            raise
    if process.returncode:
        reason = (faults or "").strip().rpartition("\n")[2] or (
            "read the message of the daemon above"
        )
        with contextlib.suppress(json.JSONDecodeError, KeyError, TypeError):
            reason = json.loads(output)["error"]
        error = DaemonFailedError("the daemon could not record", reason)
        error.exit_code = process.returncode if process.returncode > 0 else 1
        raise error
    return output


def _report_lines(results: list[BoardResult]) -> str:
    lines = []
    for result in results:
        lines.append(f"Report: {result.solved.report}")
        if result.written is not None:
            lines.append(f"Findings: {result.written.page}")
    return "\n".join(lines)


def _exit_code(results: list[BoardResult], hidden: bool) -> int:
    """Return 1 if a value or a name is wrong, 4 if a value is missing, else 0.

    With a hidden cause the names decide: a value can be off because of that cause.
    """
    sigmas = [row.sigmas for result in results for row in result.rows]
    if not results:
        return 1
    if hidden and any(
        scored.score in ("wrong", "missed") for result in results for scored in result.scored
    ):
        return 1
    if not hidden and any(
        sigma is not None and abs(sigma) > WRONG_BEYOND_SIGMA for sigma in sigmas
    ):
        return 1
    return NOT_IDENTIFIABLE if any(sigma is None for sigma in sigmas) else 0


def _result_json(result: BoardResult) -> dict[str, Any]:
    written = result.written
    return {
        "board": result.solved.calibration.board.id,
        "verdict": result.solved.calibration.trust.verdict,
        "file": str(result.solved.path),
        "report": str(result.solved.report),
        "findings": None
        if written is None
        else {
            "verdict": written.document.verdict,
            "causes": [[c.cause, *c.one_of] for c in written.document.causes],
            "file": str(written.path),
            "report": str(written.page),
        },
        "hidden": [{"cause": s.cause, "score": s.score, "words": s.text} for s in result.scored],
        "parameters": [comparison_json(row) for row in result.rows],
    }


def _indent(text: str) -> str:
    return "\n".join("   " + line for line in text.splitlines())
