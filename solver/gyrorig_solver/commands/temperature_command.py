"""`gyrorig temperature`: bias and scale against the temperature, from values without times."""

from pathlib import Path

import click
import msgspec

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.apply import read_calibration
from gyrorig_solver.calibration import (
    CalibrationStore,
    calibration_as_mapping,
    find_profile,
)
from gyrorig_solver.calibration.calibration_document import calibration_as_yaml
from gyrorig_solver.calibration.calibration_summary import calibration_summary
from gyrorig_solver.commands.terminal import Terminal, choice_option, folder_option, json_option
from gyrorig_solver.data.utc_time import utc_text_now
from gyrorig_solver.pipeline.temperature_values import (
    UNITS,
    check_same_calibrated_board,
    document_without_motion,
    read_values,
    with_temperature_curves,
)
from gyrorig_solver.report import ReportData, render_calibration


@click.command("temperature")
@click.argument("values", nargs=-1, required=True, type=click.Path(path_type=Path, dir_okay=False))
@click.option("--board", help="Name of the board.  [default: that of the calibration]")
@click.option(
    "--sensor", default="unknown", help="Only if there is no calibration: type of the sensor."
)
@choice_option("--unit", tuple(UNITS), "deg/s", "Unit of the bias in tables.")
@click.option(
    "--calibration",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Calibration of the board, whose gain is kept.  [default: the last one in VALUES]",
)
@folder_option("calibrations", "Folder for the result, as of `gyrorig solve`.")
@json_option
@click.pass_obj
def temperature_command(
    terminal: Terminal,
    values: tuple[Path, ...],
    board: str | None,
    sensor: str,
    unit: str,
    calibration: Path | None,
    out: Path,
) -> int:
    r"""Fit bias and scale against the temperature from VALUES: tables, or calibrations.

    A table (CSV) has the columns temperature_degc, bias_x, bias_y, bias_z, and optionally their
    standard uncertainties bias_std_x, ..., and scale_x, ..., scale_std_x, .... Calibrations of one
    board at several temperatures give their bias and scale factor. The result is the next version
    of the board. For recordings at rest with temperatures use `gyrorig solve`.

    \b
    Examples:
      gyrorig temperature chamber.csv --board IMU-7
      gyrorig temperature cold.yaml room.yaml warm.yaml hot.yaml --out calibrations
    """
    terminal.print_progress(f"fitting {len(values)} files")
    rows = read_values(values, unit)
    document = rows.template
    if calibration is not None:
        document, _ = read_calibration(calibration)
        if rows.template is not None:
            check_same_calibrated_board(rows.template.board, document.board)
        if board is not None and board != document.board.id:
            raise UsageError(
                f"the option --board names {board}, but the calibration {calibration.name} is of "
                f"board {document.board.id}",
                "give the calibration of this board with --calibration",
            )
    if document is None:
        if board is None:
            raise UsageError(
                "a table does not name its board", "give the name of the board with --board"
            )
        document = document_without_motion(str(BoardId(board)), sensor)
    document = with_temperature_curves(document, rows)
    name = BoardId(board or document.board.id)
    result = document

    def text(version: int, previous: str | None) -> str:
        nonlocal result
        result = msgspec.structs.replace(
            document,
            board=msgspec.structs.replace(document.board, id=str(name)),
            version=version,
            created=utc_text_now(),
            previous=previous,
        )
        return calibration_as_yaml(result)

    store = CalibrationStore(out)
    stored = store.add_version(name, text)
    page = render_calibration(ReportData(result, profile=find_profile(result.board.sensor)))
    report = store.write_companion(stored, ".report.html", page.encode())
    path = out / stored.name
    terminal.print_result(calibration_summary(result), result.trust.verdict)
    terminal.print_result(f"  calibration           {path}\n  report                {report}")
    plain = calibration_as_mapping(result)
    terminal.print_json({"file": str(path), "report": str(report), "calibration": plain})
    return 0
