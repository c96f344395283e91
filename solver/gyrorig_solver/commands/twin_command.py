"""`gyrorig twin`: write the emulated rig that behaves like the recorded one."""

from pathlib import Path

import click

from gyrorig_protocol.twin import twin_to_plain
from gyrorig_solver.commands.input_failures import InputFailures, read_with_board
from gyrorig_solver.commands.terminal import (
    NOT_IDENTIFIABLE,
    PARTIAL,
    Terminal,
    board_option,
    folder_option,
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
@folder_option("twin", "The folder: OUT/twin.yaml; an earlier twin is kept as twin-0001.yaml.")
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
    failures = InputFailures()
    usable = read_with_board(terminal, recordings, board, failures)
    if not usable and failures.faults:
        raise failures.faults[0]
    check_one_rig(usable)
    terminal.print_progress(f"explaining {', '.join(r.path.name for r in usable)}")
    fitted = fit_boards(usable, board)
    for name, fault in fitted.errors.items():
        failures.add(fault, usable[0].path, name)
    if not fitted.fits:
        raise failures.faults[0]
    terminal.print_progress("measuring the link and the unit")
    built = build_twin(fitted.boards, fitted.fits)
    written = write_twin(out, built)
    terminal.print_result(f"{twin_summary(built)}\n  rig file              {written}")
    failures.report(terminal, has_results=True)
    code = exit_code(fitted, failures.rows)
    terminal.print_json(
        {
            "file": str(written),
            "twin": twin_to_plain(built.twin),
            "defaults": undetermined_values(built.twin),
            "warnings": twin_warnings(built),
            "failed": failures.rows,
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
