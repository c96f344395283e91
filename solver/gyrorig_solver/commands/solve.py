"""`gyrorig solve`: recordings in, one more version of each board's calibration out."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import GyrorigError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration.document import to_plain
from gyrorig_solver.calibration.solving import (
    AUTO,
    Ready,
    Solved,
    fits_together,
    solve_into,
)
from gyrorig_solver.calibration.store import CalibrationStore
from gyrorig_solver.calibration.summary import summary
from gyrorig_solver.commands.boards import chosen_boards
from gyrorig_solver.commands.terminal import (
    IN_PART,
    NOT_IDENTIFIABLE,
    Terminal,
    json_option,
)


@click.command("solve")
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--board", help="Only this board.  [default: every board in the recordings]")
@click.option(
    "--method",
    type=click.Choice(["likelihood", "paper"]),
    default="likelihood",
    show_default=True,
    help="likelihood: this project's; paper: equations 6 to 12 as printed, for comparison only.",
)
@click.option(
    "--extend",
    default="none",
    show_default=True,
    metavar="auto|none|CAUSE,...",
    help="Causes to fit beside the base model: named ones, such as thermal_bias; or auto, those "
    "that the recordings show (as `gyrorig explain` names them).",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("calibrations"),
    show_default=True,
    help="The store: OUT/<board>/v0001.yaml and v0001.report.html.",
)
@json_option
@click.pass_obj
def solve_command(
    terminal: Terminal,
    recordings: tuple[Path, ...],
    board: str | None,
    method: str,
    extend: str,
    out: Path,
) -> int:
    r"""Turn recordings into a calibration and a report for each board in them.

    All recordings of one board are solved together and make one version: static and moving
    ones, of different days, each with its own bias and time offset. Boards that were on one
    unit at once are solved together too: its motion is one, and so is the size of a cause that
    is the unit's; those of a bus have one time. With --board, one is solved by itself. Leaves
    with 4 when a parameter could not be shown: the calibration says which, and why.

    \b
    Example:
      gyrorig solve demo/session.mcap --out calibrations
      gyrorig solve static.mcap monday.mcap friday.mcap --extend thermal_bias,g_sensitivity
    """
    causes = _causes(extend, method)
    solved: list[Solved] = []
    failed: list[dict[str, str]] = []
    faults: list[GyrorigError] = []
    read: list[Recording] = []
    for path in recordings:
        terminal.progress(f"reading {path.name}")
        try:
            read.append(read_recording(path))
            chosen_boards(read[-1], board)
        except GyrorigError as fault:
            faults.append(fault)
            failed.append({"recording": str(path), "board": "", "error": str(fault)})
    for names, together in _groups(read, board, apart=method == "paper"):
        said = names[0] if len(names) == 1 else f"{len(names)} boards"
        terminal.progress(f"solving {said} of {', '.join(r.path.name for r in together)}")
        ready = fits_together(together, names, method, causes)
        for name in names:
            try:
                solved.append(_solved(out, together, name, method, causes, ready.get(name)))
                terminal.say(_said(solved[-1]))
            except GyrorigError as fault:
                faults.append(fault)
                failed.append(
                    {"recording": str(together[0].path), "board": str(name), "error": str(fault)}
                )
    if len(faults) == 1 and not solved:
        raise faults[0]
    for failure in failed:
        terminal.complain(f"{failure['board'] or failure['recording']}: {failure['error']}")
    if not solved:
        terminal.emit({"boards": [], "failed": failed, "exit_code": faults[0].exit_code})
        return faults[0].exit_code
    code = IN_PART if failed else 0
    if not failed and any(_lacks(s, causes) for s in solved):
        code = NOT_IDENTIFIABLE
    terminal.emit({"boards": [_plain(s) for s in solved], "failed": failed, "exit_code": code})
    return code


def _causes(extend: str, method: str) -> tuple[str, ...]:
    """Return the causes that were asked for.

    Raises:
        UsageError: the method takes none.
    """
    causes = tuple(name.strip() for name in extend.split(",") if name.strip() not in ("", "none"))
    if causes and method == "paper":
        raise UsageError(
            "the paper's method fits no causes beside its model",
            "leave out --extend, or use --method likelihood",
        )
    return causes


def _lacks(solved: Solved, causes: Sequence[str]) -> bool:
    """Return whether something that was asked for could not be shown."""
    calibration = solved.calibration
    missing = set(causes) - {AUTO} - set(calibration.solver.terms)
    return bool(calibration.observability.unobservable or missing)


def _groups(
    recordings: Sequence[Recording], wanted: str | None, apart: bool
) -> Iterator[tuple[list[BoardId], list[Recording]]]:
    """Yield boards with the recordings that are solved together for them.

    Boards of the same recordings are yielded at once: on one unit they are solved together.
    """
    pooled: dict[BoardId, list[Recording]] = {}
    for recording in recordings:
        for board in recording.board_ids:
            if wanted is not None and board != wanted:
                continue
            if apart:
                yield [board], [recording]
            else:
                pooled.setdefault(board, []).append(recording)
    alike: dict[tuple[int, ...], list[BoardId]] = {}
    for board, own in pooled.items():
        alike.setdefault(tuple(id(one) for one in own), []).append(board)
    for boards in alike.values():
        yield boards, pooled[boards[0]]


def _solved(
    out: Path,
    together: Sequence[Recording],
    board: BoardId,
    method: str,
    causes: Sequence[str],
    ready: Ready | GyrorigError | None,
) -> Solved:
    """Solve one board, or write what was solved with the boards beside it."""
    if isinstance(ready, GyrorigError):
        raise ready
    return solve_into(CalibrationStore(out), together, board, method, causes, ready)


def _said(solved: Solved) -> str:
    found, lines = solved.calibration.findings, [summary(solved.calibration)]
    if found is not None:
        causes = f": {', '.join(found.causes)}" if found.causes else ""
        lines.append(f"  findings              {found.verdict}{causes}")
        lines.append(f"                        {solved.path.with_name(found.file)}")
    lines.append(f"  calibration           {solved.path}")
    lines.append(f"  report                {solved.report}")
    return "\n".join(lines)


def _plain(solved: Solved) -> dict[str, Any]:
    calibration = solved.calibration
    return {
        "board": calibration.board.id,
        "version": calibration.version,
        "verdict": calibration.trust.verdict,
        "file": str(solved.path),
        "report": str(solved.report),
        "calibration": to_plain(calibration),
    }
