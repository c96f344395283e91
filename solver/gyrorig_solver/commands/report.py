"""`gyrorig report`: a stored calibration's page, made again."""

from pathlib import Path

import click

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.apply.calibration import read_document
from gyrorig_solver.calibration.document import parse_calibration
from gyrorig_solver.calibration.profiles import find_profile
from gyrorig_solver.calibration.solving import shown_again
from gyrorig_solver.calibration.store import write_whole
from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.report.data import ReportData
from gyrorig_solver.report.html import render


@click.command("report")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("recordings", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The page to write, replaced if it is there.  [default: beside the calibration]",
)
@json_option
@click.pass_obj
def report_command(
    terminal: Terminal, calibration: Path, recordings: tuple[Path, ...], out: Path | None
) -> int:
    r"""Make the page of a calibration again, as this version of the program shows it.

    With the recordings that it was solved from, all figures are drawn; without them the page
    has the numbers, the verdict and where they come from. The numbers are the document's:
    nothing in it is solved anew.

    \b
    Example:
      gyrorig report calibrations/GY80-1/v0001.yaml demo/session.mcap -o page.html
    """
    text, _ = read_document(calibration)
    found = parse_calibration(text, str(calibration))
    if recordings:
        terminal.progress(f"drawing {found.board.id} from {len(recordings)} recordings")
        data = shown_again(found, [read_recording(path) for path in recordings])
    else:
        data = ReportData(found, profile=find_profile(found.board.sensor))
    page = out or calibration.with_suffix(".report.html")
    write_whole(page, render(data).encode(), replace=True)
    verdict = found.trust.verdict
    terminal.say(f"{found.board.id} version {found.version}: {verdict}\n  report      {page}")
    terminal.emit(
        {
            "board": found.board.id,
            "version": found.version,
            "verdict": verdict,
            "figures": data.diagnostics is not None,
            "report": str(page),
            "exit_code": 0,
        }
    )
    return 0
