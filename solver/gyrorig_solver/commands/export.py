"""`gyrorig export`: a calibration in the words of another program."""

from pathlib import Path

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply.calibration import read_document
from gyrorig_solver.apply.correction import FRAMES, Frame
from gyrorig_solver.calibration.document import parse_calibration
from gyrorig_solver.calibration.store import write_whole
from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.export.formats import FORMATS, Wishes, exported
from gyrorig_solver.export.numbers import Source


@click.command("export")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--format", "kind", type=click.Choice(FORMATS), required=True, help="For which program."
)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The file to write, which must not exist.  [default: standard output]",
)
@click.option(
    "--frame",
    type=click.Choice(FRAMES),
    default="stage",
    show_default=True,
    help="Axes of the rates: the stage's, as on the rig, or the sensor's own made orthogonal.",
)
@click.option(
    "--name",
    help="c: what names begin with [default: the board's name]; ros: the node [default: all]; "
    "kalibr: the topic [default: /imu0].",
)
@click.option(
    "--slot", type=int, help="px4, ardupilot: which gyro of the vehicle, from 0.  [default: 0]"
)
@click.option(
    "--device-id",
    type=int,
    help="px4: the gyro's number, as CAL_GYRO0_ID has it.  [default: left out of the file]",
)
@json_option
@click.pass_obj
def export_command(
    terminal: Terminal,
    calibration: Path,
    kind: str,
    out: Path | None,
    frame: Frame,
    name: str | None,
    slot: int | None,
    device_id: int | None,
) -> int:
    r"""Write a calibration as another program takes it.

    c: a header, floating and fixed point, with a self-test. ros: a parameter file. kalibr:
    imu.yaml. px4, ardupilot: parameter files; they take the bias and its temperature, and
    have no place for a scale. json: the numbers and the whole document. Each says in itself
    which frame, direction, order and unit its numbers have.

    \b
    Examples:
      gyrorig export calibrations/GY80-1/v0001.yaml --format c -o gy80_1.h
      gyrorig export calibrations/GY80-1/v0001.yaml --format px4 --slot 0
    """
    if out is not None and out.exists():
        raise UsageError(f"{out} exists", "name a file that does not, with -o")
    text, digest = read_document(calibration)
    source = Source.of(parse_calibration(text, str(calibration)), frame, digest)
    written = exported(source, kind, Wishes(name, slot, device_id))
    if out is None:
        if not terminal.json:
            click.echo(written, nl=False)  # as it is: tabs are part of it, and names were cleaned
    elif not write_whole(out, written.encode(), replace=False):
        raise UsageError(f"{out} exists", "name a file that does not, with -o")
    else:
        terminal.say(f"{out}: {source.found.board.id} version {source.found.version}, {kind}")
    about = {"board": source.found.board.id, "version": source.found.version, "format": kind}
    place = {"text": written} if out is None else {"out": str(out)}
    terminal.emit({**about, **place, "exit_code": 0})
    return 0
