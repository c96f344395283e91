"""`gyrorig check`: whether recordings are sound and which parameters they determine."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import GyrorigError, InputError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording_metadata import recording_order
from gyrorig_solver.check import RecordingHealth, examine_recording, health_problems, health_verdict
from gyrorig_solver.check.attitude_health import attitude_lines
from gyrorig_solver.check.recording_health import BoardHealth, UnitHealth
from gyrorig_solver.commands.board_selection import select_boards
from gyrorig_solver.commands.terminal import (
    NOT_IDENTIFIABLE,
    PARTIAL,
    Terminal,
    board_option,
    json_option,
)
from gyrorig_solver.storage import limit_input, size_of_inputs


@click.command("check")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@board_option
@json_option
@click.pass_obj
def check_command(terminal: Terminal, recordings: tuple[Path, ...], board: str | None) -> int:
    r"""Check recordings: losses, clocks, and which parameters the motion determines.

    A folder stands for every recording in it. The first line is the verdict. Lines with `!`
    name a problem and its remedy. The exit status is 4 if the motion does not determine all
    parameters, and 3 if a file is not a recording.

    \b
    Example:
      gyrorig check demo/session.mcap
    """
    examined: list[RecordingHealth] = []
    failed: list[dict[str, str]] = []
    faults: list[GyrorigError] = []
    paths = _recordings_of(recordings)
    for path in paths:
        try:
            terminal.print_progress(f"reading {path.name}")
            with limit_input(path.name, size_of_inputs([path])):
                recording = read_recording(path)
                wanted = select_boards(recording, board) if board else recording.board_ids
                examined.append(examine_recording(recording, wanted))
        except GyrorigError as fault:
            faults.append(fault)
            failed.append({"recording": str(path), "error": str(fault)})
            if len(paths) > 1:
                terminal.print_error(str(fault))
            continue
        terminal.print_result(health_text(examined[-1]))
    if len(paths) == 1 and faults:
        raise faults[0]
    if not examined:
        terminal.print_json({"recordings": [], "failed": failed, "exit_code": faults[0].exit_code})
        return faults[0].exit_code
    code = PARTIAL if failed else 0
    if not failed and not all(health.identifiable for health in examined):
        code = NOT_IDENTIFIABLE
    terminal.print_json(
        {"recordings": [_health_json(h) for h in examined], "failed": failed, "exit_code": code}
    )
    return code


def _recordings_of(paths: tuple[Path, ...]) -> list[Path]:
    """Return the paths, with a folder replaced by the recordings in it.

    Raises:
        InputError: a folder has no recording.
    """
    expanded: list[Path] = []
    for path in paths:
        if not path.is_dir():
            expanded.append(path)
            continue
        inside = sorted(path.glob("*.mcap"), key=recording_order)
        inside += sorted(path.glob("*.mcap.part"), key=recording_order)
        if not inside:
            raise InputError(
                f"the folder {path} contains no recording",
                "give a recording (*.mcap), or a folder with recordings",
            )
        expanded += inside
    return expanded


def health_text(health: RecordingHealth) -> str:
    """Return the examination of a recording as lines of text."""
    lines = [f"{health.name}: {health_verdict(health)}; {health.duration_s:.1f} s in total"]
    if health.phases:
        phases = ", ".join(f"{count} x {name}" for name, count in health.phases.items())
        lines.append(f"  phases      {phases}")
    if health.unit is not None:
        lines += _unit_lines(health.unit)
    for board in health.boards:
        lines += _board_lines(board)
    lines += [f"  ! {text}" for text in health_problems(health)]
    lines += [f"  note: {text}" for text in health.notes]
    return "\n".join(lines)


def _unit_lines(unit: UnitHealth) -> list[str]:
    return [
        f"  unit        {unit.polls} positions, {unit.poll_rate_hz:.1f} per second; "
        f"pan {unit.pan_deg[0]:.1f} to {unit.pan_deg[1]:.1f} deg, "
        f"tilt {unit.tilt_deg[0]:.1f} to {unit.tilt_deg[1]:.1f} deg",
        f"              {unit.commands} commands, {unit.refused} refused or unanswered",
    ]


def _board_lines(board: BoardHealth) -> list[str]:
    label_text = f"  {board.board:<11} "
    blank = " " * len(label_text)
    if board.fault:
        return [f"{label_text}{board.samples} samples, not usable"]
    lines = [
        f"{label_text}{board.sensor or 'unknown sensor'}, {board.samples} samples, "
        f"{board.rate_hz:.2f} per second for {board.duration_s:.1f} s",
        f"{blank}lost {board.lost}, repeated {board.repeated}, saturated {board.saturated}, "
        f"restarts {board.restarts}",
        f"{blank}clock skew {board.skew_ppm:+.1f} ppm; "
        f"latency {1e3 * board.latency_median_s:.2f} ms (median), "
        f"{1e3 * board.latency_max_s:.2f} ms (maximum); {board.clock_pings} clock pings",
    ]
    if board.attitudes is not None:
        lines += [f"{blank}{line}" for line in attitude_lines(board.attitudes)]
    observability = board.observability
    if observability is None:
        lines.append(f"{blank}determines no parameter")
    else:
        lines.append(
            f"{blank}determines {observability.rank} of {observability.of} parameters "
            f"(and {'not ' * ('time_offset' in observability.unobservable)}the time offset)"
        )
    return lines


def _health_json(health: RecordingHealth) -> dict[str, Any]:
    plain = asdict(health)
    plain["losses"] = [loss.text for loss in health.losses]
    plain["verdict"] = health_verdict(health)
    plain["problems"] = list(health_problems(health))
    plain["identifiable"] = health.identifiable
    return plain
