"""`gyrorig export`: convert a calibration to the format of another program."""

from pathlib import Path

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply import FRAMES, Frame, read_calibration
from gyrorig_solver.commands.terminal import (
    SuggestingChoice,
    Terminal,
    choice_option,
    json_option,
    output_option,
)
from gyrorig_solver.export import FORMATS, ExportOptions, ExportSource, export_text
from gyrorig_solver.storage import write_file


@click.command("export")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--format", "kind", type=SuggestingChoice(FORMATS), required=True, help="Format of the output."
)
@output_option(
    "File to write; it must not exist. - is standard output.  [default: standard output]"
)
@choice_option(
    "--frame", FRAMES, "stage", "Axes of the corrected rates: stage, or sensor (orthogonalised)."
)
@click.option(
    "--name",
    help="c: prefix of the names [default: the board]; ros: the node [default: all]; "
    "kalibr: the topic [default: /imu0].",
)
@click.option(
    "--slot", type=int, help="px4, ardupilot: number of the gyro in the vehicle.  [default: 0]"
)
@click.option(
    "--device-id",
    type=click.IntRange(0, 2**31 - 1),  # the type of a parameter of PX4
    help="px4: identifier of the gyro, as in CAL_GYRO0_ID.  [default: not written]",
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
    r"""Convert a calibration to the format of another program.

    c: a header with floating-point and fixed-point code and a self-test. ros: a parameter file.
    kalibr: imu.yaml. px4, ardupilot: parameter files with the bias and its temperature; they
    have no parameter for the scale factor. json: the numbers and the whole document. Each file
    states the frame, direction, order and unit of its numbers.

    \b
    Examples:
      gyrorig export calibrations/GY80-1/v0001.yaml --format c -o gy80_1.h
      gyrorig export calibrations/GY80-1/v0001.yaml --format px4 --slot 0
    """
    if out == Path("-"):
        out = None
    if out is not None and out.exists():
        raise UsageError(f"the output file {out} already exists", "choose another file with -o")
    document, digest = read_calibration(calibration)
    source = ExportSource.of(document, frame, digest)
    written = export_text(source, kind, ExportOptions(name, slot, device_id))
    if out is None:
        if not terminal.json:
            click.echo(written, nl=False)  # unchanged: tabs matter, and names are already clean
    elif not write_file(out, written.encode(), replace=False):
        raise UsageError(f"the output file {out} already exists", "choose another file with -o")
    else:
        terminal.print_result(
            f"{out}: {source.document.board.id} version {source.document.version}, {kind}"
        )
    about = {"board": source.document.board.id, "version": source.document.version, "format": kind}
    output = {"text": written} if out is None else {"out": str(out)}
    terminal.print_json({**about, **output, "exit_code": 0})
    return 0
