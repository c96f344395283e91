"""`gyrorig twin`: write the emulated rig that behaves like the recorded one."""

from pathlib import Path

import click

from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.twin import twin_to_plain
from gyrorig_solver.commands.board_selection import select_boards
from gyrorig_solver.commands.terminal import (
    NOT_IDENTIFIABLE,
    PARTIAL,
    Terminal,
    board_option,
    json_option,
)
from gyrorig_solver.model import group_of
from gyrorig_solver.twin import (
    BoardFits,
    build_twin,
    check_one_rig,
    fit_boards,
    twin_summary,
    twin_warnings,
    undetermined_values,
    write_twin,
)


@click.command("twin")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@board_option
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("twin"),
    show_default=True,
    help="The folder: OUT/twin.yaml; an earlier twin is kept as twin-0001.yaml.",
)
@json_option
@click.pass_obj
def twin_command(
    terminal: Terminal, recordings: tuple[Path, ...], board: str | None, out: Path
) -> int:
    r"""Write the rig file of an emulated rig that behaves like the recorded one.

    The values are those of the fit with the causes that `gyrorig explain` identifies: boards,
    causes, the latency of the link, and the reply times of the unit, each with its uncertainty.
    What the recordings do not determine keeps the default of the emulator. `gyrorigd record`,
    `emulate` and `run` use the file like any rig file.

    The recordings must be of one rig. The exit status is 4 if the recordings do not determine a
    parameter of a board.

    \b
    Example:
      gyrorig twin demo/session.mcap --out twin
      gyrorig twin monday.mcap friday.mcap --board GY80-1
    """
    failed: list[dict[str, str]] = []
    faults: list[GyrorigError] = []
    read_recordings: list[Recording] = []
    for path in recordings:
        terminal.print_progress(f"reading {path.name}")
        try:
            recording = read_recording(path)
            select_boards(recording, board)
            read_recordings.append(recording)
        except GyrorigError as fault:
            faults.append(fault)
            failed.append({"recording": str(path), "board": "", "error": str(fault)})
    if not read_recordings and faults:
        raise faults[0]
    check_one_rig(read_recordings)
    terminal.print_progress(f"explaining {', '.join(r.path.name for r in read_recordings)}")
    fitted = fit_boards(read_recordings, board)
    faults += fitted.errors.values()
    failed += [
        {"recording": str(read_recordings[0].path), "board": name, "error": str(fault)}
        for name, fault in fitted.errors.items()
    ]
    if not fitted.fits:
        raise faults[0]
    terminal.print_progress("measuring the link and the unit")
    built = build_twin(fitted.boards, fitted.fits)
    written = write_twin(out, built)
    terminal.print_result(f"{twin_summary(built)}\n  rig file              {written}")
    for failure in failed:
        terminal.print_error(f"{failure['board'] or failure['recording']}: {failure['error']}")
    code = exit_code(fitted, failed)
    terminal.print_json(
        {
            "file": str(written),
            "twin": twin_to_plain(built.twin),
            "defaults": undetermined_values(built.twin),
            "warnings": twin_warnings(built),
            "failed": failed,
            "exit_code": code,
        }
    )
    return code


def exit_code(fitted: BoardFits, failed: list[dict[str, str]]) -> int:
    """Return 5 where some inputs failed, 4 where a parameter of a board is not determined."""
    if failed:
        return PARTIAL
    names = {name for fit in fitted.fits.values() for name in fit.fit.observability.unobservable}
    return NOT_IDENTIFIABLE if any(group_of(name) is not None for name in names) else 0
