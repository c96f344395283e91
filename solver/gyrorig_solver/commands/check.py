"""`gyrorig check`: is this recording sound, and what can it calibrate?"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.check.health import BoardHealth, Health, UnitHealth, examine
from gyrorig_solver.check.remarks import problems, verdict
from gyrorig_solver.commands.boards import chosen_boards
from gyrorig_solver.commands.terminal import (
    IN_PART,
    NOT_IDENTIFIABLE,
    Terminal,
    json_option,
)


@click.command("check")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--board", help="Only this board.  [default: every board in the recordings]")
@json_option
@click.pass_obj
def check_command(terminal: Terminal, recordings: tuple[Path, ...], board: str | None) -> int:
    r"""Say whether recordings are sound, what is lost, and what they can calibrate.

    The first line is the verdict: sound, usable with remarks, not usable, or that it cannot
    calibrate all. Lines with `!` say what is wrong and what to do about it. Leaves with 4 when
    a parameter cannot be shown by the motion in it, with 3 when a file is no recording.

    \b
    Example:
      gyrorig check demo/session.mcap
    """
    examined: list[Health] = []
    failed: list[dict[str, str]] = []
    faults: list[GyrorigError] = []
    for path in recordings:
        terminal.progress(f"reading {path.name}")
        try:
            recording = read_recording(path)
            wanted = chosen_boards(recording, board) if board else recording.board_ids
            examined.append(examine(recording, wanted))
        except GyrorigError as fault:
            faults.append(fault)
            failed.append({"recording": str(path), "error": str(fault)})
            if len(recordings) > 1:
                terminal.complain(str(fault))
            continue
        terminal.say(words(examined[-1]))
    if len(recordings) == 1 and faults:
        raise faults[0]
    if not examined:
        terminal.emit({"recordings": [], "failed": failed, "exit_code": faults[0].exit_code})
        return faults[0].exit_code
    code = IN_PART if failed else 0
    if not failed and not all(health.identifiable for health in examined):
        code = NOT_IDENTIFIABLE
    terminal.emit(
        {"recordings": [_plain(h) for h in examined], "failed": failed, "exit_code": code}
    )
    return code


def words(health: Health) -> str:
    """Return a recording's health as lines for a terminal."""
    lines = [f"{health.name}: {verdict(health)}; {health.duration_s:.1f} s"]
    if health.phases:
        phases = ", ".join(f"{count} x {name}" for name, count in health.phases.items())
        lines.append(f"  phases      {phases}")
    if health.unit is not None:
        lines += _unit_words(health.unit)
    for board in health.boards:
        lines += _board_words(board)
    lines += [f"  ! {text}" for text in problems(health)]
    lines += [f"  note: {text}" for text in health.notes]
    return "\n".join(lines)


def _unit_words(unit: UnitHealth) -> list[str]:
    return [
        f"  unit        {unit.polls} positions, {unit.poll_rate_hz:.1f} a second; "
        f"pan {unit.pan_deg[0]:.1f} to {unit.pan_deg[1]:.1f} deg, "
        f"tilt {unit.tilt_deg[0]:.1f} to {unit.tilt_deg[1]:.1f} deg",
        f"              {unit.commands} commands, {unit.refused} refused or unanswered",
    ]


def _board_words(board: BoardHealth) -> list[str]:
    head = f"  {board.board:<11} "
    blank = " " * len(head)
    if board.fault:
        return [f"{head}{board.samples} samples, not usable"]
    lines = [
        f"{head}{board.sensor or 'unknown sensor'}, {board.samples} samples, "
        f"{board.rate_hz:.2f} a second, {board.duration_s:.1f} s",
        f"{blank}lost {board.lost}, repeated {board.repeated}, saturated {board.saturated}, "
        f"restarts {board.restarts}",
        f"{blank}clock {board.skew_ppm:+.1f} ppm, late by {1e3 * board.latency_median_s:.2f} ms "
        f"in the middle, {1e3 * board.latency_max_s:.2f} ms at most; {board.clock_pings} pings",
    ]
    seen = board.observability
    if seen is None:
        lines.append(f"{blank}can calibrate: nothing by itself")
    else:
        lines.append(f"{blank}can calibrate: {seen.rank} of {seen.of} parameters")
    return lines


def _plain(health: Health) -> dict[str, Any]:
    plain = asdict(health)
    plain["losses"] = [loss.text for loss in health.losses]
    plain["verdict"] = verdict(health)
    plain["problems"] = list(problems(health))
    plain["identifiable"] = health.identifiable
    return plain
