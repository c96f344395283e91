"""`gyrorig demo`: the whole way on an emulated rig.

Emulated devices on ptys, the real daemon as its own process, a recording, a check, a
calibration, a report, and at the end what was found beside what the emulator hides.
"""

import contextlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.errors import GyrorigError, InputError, MachineError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration.solving import Solved, solve_into
from gyrorig_solver.calibration.store import CalibrationStore
from gyrorig_solver.calibration.wording import quantity
from gyrorig_solver.check.health import examine
from gyrorig_solver.check.truth import Compared, compare
from gyrorig_solver.commands.check import words
from gyrorig_solver.commands.daemon import daemon_command
from gyrorig_solver.commands.project_files import project_file
from gyrorig_solver.commands.terminal import NOT_IDENTIFIABLE, Terminal, json_option

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
    help="Another rig, board and noise. [default: the one in config/rig.yaml]",
)
@click.option(
    "--program",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The motion. [default: config/programs/quick.yaml, 40 s]",
)
@json_option
@click.pass_obj
def demo_command(terminal: Terminal, out: Path, seed: int | None, program: Path | None) -> int:
    r"""Go the whole way on an emulated rig: record, check, solve, compare with the truth.

    \b
    Example:
      gyrorig demo --out demo --seed 7
    """
    program = program or project_file("programs", "quick.yaml")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise MachineError(f"cannot make the folder {out}, {fault.strerror}", "--out") from fault
    which = "" if seed is None else f", seed {seed}"
    terminal.say(f"1  recording on an emulated rig{which}, program {program.stem}")
    path, truth = _record(out, seed, program)
    recording = read_recording(path)
    terminal.say(f"   {path}\n2  checking it")
    health = examine(recording, recording.board_ids)
    terminal.say(_indented(words(health)))
    terminal.say("3  solving")
    results = []
    for board in recording.board_ids:
        solved = solve_into(CalibrationStore(out / "calibrations"), [recording], board)
        rows = compare(solved.calibration, truth)
        results.append((solved, rows))
        terminal.say(f"   {solved.path}")
    terminal.say("4  found, beside what the emulator hides")
    for solved, rows in results:
        terminal.say(table(solved, rows))
    terminal.say(_closing(results))
    code = _exit_code(results)
    terminal.emit(
        {
            "recording": str(path),
            "boards": [_plain(solved, rows) for solved, rows in results],
            "exit_code": code,
        }
    )
    return code


def _record(out: Path, seed: int | None, program: Path) -> tuple[Path, dict[str, Any]]:
    """Run the daemon on the emulated rig; return its recording and the truth behind it.

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
    )
    said = _run(command)
    truth = parse_yaml(truth_path.read_bytes(), str(truth_path), InputError)
    try:
        return Path(json.loads(said)["recording"]), truth
    except (json.JSONDecodeError, KeyError, TypeError) as fault:
        raise InputError("the daemon did not name its recording", "run it alone to see") from fault


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


def _closing(results: list[tuple[Solved, list[Compared]]]) -> str:
    off = [abs(row.sigmas) for _, rows in results for row in rows if row.sigmas is not None]
    lines = [
        f"   {sum(v <= USUAL for v in off)} of {len(off)} within {USUAL:g} standard deviations, "
        f"{sum(v <= FAR_OFF for v in off)} of {len(off)} within {FAR_OFF:g}",
    ]
    lines += [f"Report: {solved.report}" for solved, _ in results]
    return "\n".join(lines)


def _exit_code(results: list[tuple[Solved, list[Compared]]]) -> int:
    """Return 1 when a number is not what it claims, 4 when one could not be shown."""
    sigmas = [row.sigmas for _, rows in results for row in rows]
    if not results or any(v is not None and abs(v) > FAR_OFF for v in sigmas):
        return 1
    return NOT_IDENTIFIABLE if any(v is None for v in sigmas) else 0


def _plain(solved: Solved, rows: list[Compared]) -> dict[str, Any]:
    return {
        "board": solved.calibration.board.id,
        "verdict": solved.calibration.trust.verdict,
        "file": str(solved.path),
        "report": str(solved.report),
        "parameters": [
            {
                "name": row.name,
                "found": row.found,
                "truth": row.truth,
                "std": row.std,
                "unit": row.unit,
                "sigmas": row.sigmas,
            }
            for row in rows
        ],
    }


def _indented(text: str) -> str:
    return "\n".join("   " + line for line in text.splitlines())
