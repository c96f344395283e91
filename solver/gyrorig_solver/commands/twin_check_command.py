"""`gyrorig twin-check`: compare recordings with the default simulation and with a twin."""

import json
from pathlib import Path

import click

from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.documents import finite_values
from gyrorig_solver.commands.board_selection import read_within_limits
from gyrorig_solver.commands.terminal import PARTIAL, Terminal, board_option, json_option
from gyrorig_solver.twin_check import (
    DEFAULT_DRAWS,
    MIN_DRAWS,
    check_twin_folder,
    failure_texts,
    render_check,
    summarise,
    to_plain,
)


@click.command("twin-check")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--draws",
    type=click.IntRange(min=MIN_DRAWS, max=1000),
    default=DEFAULT_DRAWS,
    show_default=True,
    help="Sessions to simulate with the twin, each with other parameters from the posterior.",
)
@board_option
@json_option
@click.pass_obj
def twin_check_command(
    terminal: Terminal,
    recordings: tuple[Path, ...],
    folder: Path,
    draws: int,
    board: str | None,
) -> int:
    r"""Compare recordings with the default simulation and with a twin.

    The orders of each recording are replayed in the shipped default simulation ("before") and in
    the twin in FOLDER ("after"), several times each. The same statistics are computed from the
    measured and from the simulated recordings. The command states what the twin still gets wrong,
    and how much better it predicts recordings that were not used for its fit. It writes
    FOLDER/twin-check.html and FOLDER/twin-check.json.

    \b
    Example:
      gyrorig twin-check tuesday.mcap twin
    """
    measured = [read_within_limits(path) for path in recordings]
    check = check_twin_folder(
        folder,
        measured,
        draws,
        board,
        lambda count, total: terminal.show_status(f"  simulated session {count} of {total}"),
    )
    page, data = folder / "twin-check.html", folder / "twin-check.json"
    plain = finite_values(to_plain(check))
    write_atomically(page, render_check(check).encode())
    write_atomically(data, (json.dumps(plain, indent=1, allow_nan=False) + "\n").encode())
    for recording in measured:
        if recording.losses:
            losses = "; ".join(loss.text for loss in recording.losses)
            terminal.print_error(
                f"{recording.path.name}: {losses}. The check uses the data that can be read."
            )
    code = PARTIAL if check.failed else 0
    for text in failure_texts(check):
        terminal.print_error(text)
    terminal.print_result(f"{summarise(check)}\n\nReport: {page}")
    terminal.print_json({**plain, "report": str(page), "file": str(data), "exit_code": code})
    return code
