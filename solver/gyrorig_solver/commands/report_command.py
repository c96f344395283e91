"""`gyrorig report`: write the HTML report of a stored calibration again."""

from pathlib import Path

import click

from gyrorig_solver.apply import read_calibration
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.commands.board_selection import read_within_limits
from gyrorig_solver.commands.terminal import Terminal, json_option, output_option
from gyrorig_solver.pipeline.solve_board import rebuild_report_data
from gyrorig_solver.report import ReportData, render_calibration
from gyrorig_solver.storage import write_file


@click.command("report")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("recordings", nargs=-1, type=click.Path(path_type=Path))
@output_option("Page to write; an existing one is replaced.  [default: next to the calibration]")
@json_option
@click.pass_obj
def report_command(
    terminal: Terminal, calibration: Path, recordings: tuple[Path, ...], out: Path | None
) -> int:
    r"""Write the HTML report of a calibration again.

    With the recordings of the calibration the report has all figures; without them it has the
    numbers, the verdict and their origin. Nothing is solved again.

    \b
    Example:
      gyrorig report calibrations/GY80-1/v0001.yaml demo/session.mcap -o page.html
    """
    document, _ = read_calibration(calibration)
    if recordings:
        terminal.print_progress(f"drawing {document.board.id} from {len(recordings)} recordings")
        data = rebuild_report_data(document, [read_within_limits(path) for path in recordings])
    else:
        data = ReportData(document, profile=find_profile(document.board.sensor))
    page = out or calibration.with_suffix(".report.html")
    write_file(page, render_calibration(data).encode(), replace=True)
    verdict = document.trust.verdict
    terminal.print_result(
        f"{document.board.id} version {document.version}: {verdict}\n  report      {page}"
    )
    terminal.print_json(
        {
            "board": document.board.id,
            "version": document.version,
            "verdict": verdict,
            "figures": data.diagnostics is not None,
            "report": str(page),
            "exit_code": 0,
        }
    )
    return 0
