"""`gyrorig demo`: the whole way on an emulated rig.

Emulated devices on ptys, the real daemon as its own process, a recording, a check, a
calibration, what its model gets wrong, reports, and at the end what was found beside what
the emulator hides. The truth is not opened before the search for causes has ended.
"""

import contextlib
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import GyrorigError, InputError, MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration.solving import AUTO, Solved, solve_into
from gyrorig_solver.calibration.store import CalibrationStore
from gyrorig_solver.calibration.wording import quantity
from gyrorig_solver.check.health import examine
from gyrorig_solver.check.hidden import Scored, open_seal, score
from gyrorig_solver.check.hidden import words as scored_words
from gyrorig_solver.check.truth import Compared, compare
from gyrorig_solver.commands.check import words
from gyrorig_solver.commands.daemon import daemon_command
from gyrorig_solver.commands.project_files import project_file
from gyrorig_solver.commands.terminal import NOT_IDENTIFIABLE, Terminal, json_option
from gyrorig_solver.findings.explaining import Written, explain_board, write_explanation
from gyrorig_solver.findings.wording import summary

FAR_OFF = 3.5  # standard deviations; 13 right ones exceed it in 6 of 1000 demos
USUAL = 2.0
HALT_PATIENCE_S = 20.0  # a unit comes to rest from full speed, and the file is closed


class DaemonFailedError(GyrorigError):
    """The daemon ended with an error; its own line and exit code are passed on."""


@click.command("demo")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("demo"),
    show_default=True,
    help="The folder for the recording, the calibration, the report and the truth.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Another number is another rig, board and noise.  [default: that of config/rig.yaml, 1]",
)
@click.option(
    "--program",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The motion.  [default: config/programs/quick.yaml, 40 s]",
)
@click.option(
    "--hide",
    multiple=True,
    metavar="CAUSE[@PLACE][:SIZE]",
    help="Let the emulated rig have an imperfection, to be found and named; or random: drawn, and "
    "sealed until the end. `gyrorigd causes` lists causes, places and units of sizes. Can be given "
    "several times.",
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
    r"""Go the whole way on an emulated rig: record, check, solve, explain, compare with the truth.

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
            f"cannot make the folder {out}, {fault.strerror}", "name another with --out"
        ) from fault
    which = "" if seed is None else f", seed {seed}"
    terminal.say(f"1  recording on an emulated rig{which}, program {program.stem}")
    made = _record(out, seed, program, hide)
    recording = read_recording(made.path)
    terminal.say(f"   {made.path}")
    if made.seal:
        terminal.say(f"   something is hidden, sealed: sha256 {made.seal}")
    terminal.say("2  checking it")
    terminal.say(_indented(words(examine(recording, recording.board_ids))))
    terminal.say("3  solving")
    solved = []
    for board in recording.board_ids:
        store = CalibrationStore(out / "calibrations")
        solved.append(solve_into(store, [recording], board, extend=(AUTO,) if hide else ()))
        terminal.say(f"   {solved[-1].path}")
    terminal.say("4  explaining what the model of the rig gets wrong")
    written = [_explained(terminal, out, recording, one) for one in solved]
    terminal.say("5  found, beside what the emulator hides")
    truth = parse_yaml(made.truth.read_bytes(), str(made.truth), InputError)
    open_seal(truth, made.seal or None)
    results = [
        Result(one, compare(one.calibration, truth), found, _scored(found, truth))
        for one, found in zip(solved, written, strict=True)
    ]
    for one in results:
        terminal.say(table(one.solved, one.rows))
        if hide and one.written is not None:
            terminal.say(scored_words(one.written.document, one.scored))
    terminal.say(_closing(results))
    code = _exit_code(results, bool(hide))
    terminal.emit(
        {
            "recording": str(made.path),
            "seal": made.seal or None,
            "boards": [_plain(one) for one in results],
            "exit_code": code,
        }
    )
    return code


@dataclass(frozen=True, slots=True)
class Recorded:
    """What the daemon left behind."""

    path: Path
    truth: Path  # not to be opened before the end
    seal: str  # SHA-256 of what is hidden, "" where it is no secret


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """One board at the end of the way."""

    solved: Solved
    rows: list[Compared]
    written: Written | None  # None: it could not be explained
    scored: list[Scored]


def _explained(
    terminal: Terminal, out: Path, recording: Recording, solved: Solved
) -> Written | None:
    """Write one board's findings; None, and a word, where there is nothing to search in."""
    board = BoardId(solved.calibration.board.id)
    try:
        found = solved.found or explain_board([recording], board)
    except InputError as fault:
        terminal.say(f"   {board} cannot be explained, {fault}")
        return None
    written = write_explanation(out / "findings", found)
    terminal.say(_indented(summary(written.document)))
    return written


def _scored(written: Written | None, truth: Mapping[str, Any]) -> list[Scored]:
    return [] if written is None else score(written.document, truth)


def _record(out: Path, seed: int | None, program: Path, hide: tuple[str, ...]) -> Recorded:
    """Run the daemon on the emulated rig; the truth is left closed.

    Raises:
        DaemonFailedError: it ended with an error.
        InputError: it did not write what it should have.
    """
    truth_path = out / "truth.yaml"
    command = daemon_command(
        "record",
        *("--config", str(project_file("rig.yaml")), "--program", str(program)),
        *("--out", str(out), "--truth", str(truth_path), "--json"),
        *(() if seed is None else ("--seed", str(seed))),
        *(word for one in hide for word in ("--hide", one)),
    )
    said = _run(command)
    try:
        told = json.loads(said)
        return Recorded(Path(told["recording"]), truth_path, str(told.get("seal", "")))
    except (json.JSONDecodeError, KeyError, TypeError) as fault:
        raise InputError(
            "the daemon did not name its recording",
            "see what `gyrorigd record` says with the same --config and --program",
        ) from fault


def _run(command: list[str]) -> str:
    """Run the daemon to its end, and let it halt the unit when the keyboard stops us.

    On a terminal its progress and its faults go there directly.
    """
    watched = sys.stderr.isatty()
    with subprocess.Popen(  # noqa: S603 - our own interpreter, no shell
        command, stdout=subprocess.PIPE, stderr=None if watched else subprocess.PIPE, text=True
    ) as process:
        try:
            said, faults = process.communicate()
        except KeyboardInterrupt:
            # The terminal sent it the same signal; it halts the unit and closes the file.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(HALT_PATIENCE_S)
            process.terminate()
            raise
    if process.returncode:
        reason = (faults or "").strip().rpartition("\n")[2] or "its own line above says why"
        with contextlib.suppress(json.JSONDecodeError, KeyError, TypeError):
            reason = json.loads(said)["error"]
        failed = DaemonFailedError("the daemon could not record", reason)
        failed.exit_code = process.returncode if process.returncode > 0 else 1
        raise failed
    return said


def table(solved: Solved, rows: list[Compared]) -> str:
    """Return one board's parameters beside the truth, as a table for a terminal."""
    board = solved.calibration.board
    lines = [
        f"   {board.id}, {board.sensor}",
        f"   {'':<22}{'found':>12}{'truth':>12}{'std':>11}  {'unit':<6}{'off by':>9}",
    ]
    for row in rows:
        if row.found is None or row.sigmas is None:
            lines.append(f"   {row.name:<22}{'not shown':>12}")
            continue
        found, std = quantity(row.found, row.std)
        places = len(found.partition(".")[2])
        mark = "" if abs(row.sigmas) <= FAR_OFF else "  !"
        lines.append(
            f"   {row.name:<22}{found:>12}{row.truth:>+12.{places}f}{std:>11}  "
            f"{row.unit:<6}{row.sigmas:>+7.2f} sd{mark}"
        )
    return "\n".join(lines)


def _closing(results: list[Result]) -> str:
    off = [abs(row.sigmas) for one in results for row in one.rows if row.sigmas is not None]
    lines = [
        f"   {sum(v <= USUAL for v in off)} of {len(off)} within {USUAL:g} standard deviations, "
        f"{sum(v <= FAR_OFF for v in off)} of {len(off)} within {FAR_OFF:g}",
    ]
    for one in results:
        lines.append(f"Report: {one.solved.report}")
        if one.written is not None:
            lines.append(f"Findings: {one.written.page}")
    return "\n".join(lines)


def _exit_code(results: list[Result], hidden: bool) -> int:
    """Return 1 when a number or a name is not what it claims, 4 when one could not be shown.

    Where something is hidden the names are judged: a number may be off by what is hidden.
    """
    sigmas = [row.sigmas for one in results for row in one.rows]
    if not results:
        return 1
    if hidden and any(s.score in ("wrong", "missed") for one in results for s in one.scored):
        return 1
    if not hidden and any(v is not None and abs(v) > FAR_OFF for v in sigmas):
        return 1
    return NOT_IDENTIFIABLE if any(v is None for v in sigmas) else 0


def _plain(one: Result) -> dict[str, Any]:
    written = one.written
    return {
        "board": one.solved.calibration.board.id,
        "verdict": one.solved.calibration.trust.verdict,
        "file": str(one.solved.path),
        "report": str(one.solved.report),
        "findings": None
        if written is None
        else {
            "verdict": written.document.verdict,
            "causes": [[c.cause, *c.one_of] for c in written.document.causes],
            "file": str(written.path),
            "report": str(written.page),
        },
        "hidden": [{"cause": s.cause, "score": s.score, "words": s.words} for s in one.scored],
        "parameters": [
            {
                "name": row.name,
                "found": row.found,
                "truth": row.truth,
                "std": row.std,
                "unit": row.unit,
                "sigmas": row.sigmas,
            }
            for row in one.rows
        ],
    }


def _indented(text: str) -> str:
    return "\n".join("   " + line for line in text.splitlines())
