"""`gyrorig apply`: the true rates beside the readings, of a recording or a table."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply.calibration import UNITS, Calibration, Unit
from gyrorig_solver.apply.correction import FRAMES, LAG, Frame
from gyrorig_solver.apply.tables import RATES, TIME_UNITS_S, TableColumns, apply_to_table
from gyrorig_solver.commands.terminal import Terminal, json_option

_RECORDINGS = (".mcap", ".part")


@click.command("apply")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="What to write; it must not exist.",
)
@click.option("--board", help="Of a recording: its board, in place of the calibration's own.")
@click.option(
    "--frame",
    type=click.Choice(FRAMES),
    default="stage",
    show_default=True,
    help="Axes of the rates: the stage's, as on the rig, or the sensor's own made orthogonal.",
)
@click.option("--bias-only", is_flag=True, help="Take the bias off and believe the nominal scale.")
@click.option(
    "--columns", metavar="X,Y,Z", help="Of a table: the columns of the gyro, in the sensor's axes."
)
@click.option(
    "--unit",
    type=click.Choice(UNITS),
    default="counts",
    show_default=True,
    help="Of a table: the unit of --columns.",
)
@click.option("--temperature", metavar="COLUMN", help="Of a table: the board's temperature, degC.")
@click.option(
    "--time",
    metavar="COLUMN",
    help="Of a table: the samples' times; those of the motion are written beside, in s.",
)
@click.option(
    "--time-unit",
    type=click.Choice(tuple(TIME_UNITS_S)),
    default="s",
    show_default=True,
    help="Of a table: the unit of --time.",
)
@json_option
@click.pass_obj
def apply_command(
    terminal: Terminal,
    calibration: Path,
    source: Path,
    out: Path,
    board: str | None,
    frame: Frame,
    bias_only: bool,
    columns: str | None,
    unit: Unit,
    temperature: str | None,
    time: str | None,
    time_unit: str,
) -> int:
    r"""Write the true rates of INPUT, a recording (.mcap) or a table (csv), by a calibration.

    A recording is copied with one topic more, /board/ID/imu of sensor_msgs/msg/Imu, whose
    stamps are when the motion was so. A table is copied with the columns rate_x_rad_s,
    rate_y_rad_s and rate_z_rad_s. Rates are rad/s; with y the reading at the nominal scale,
    they are G^-1 (y - b): docs/conventions.md.

    \b
    Examples:
      gyrorig apply calibrations/GY80-1/v0001.yaml drive.mcap -o drive-imu.mcap
      gyrorig apply GY80-1.yaml log.csv --columns gx,gy,gz --unit deg/s -o log-true.csv
    """
    found = Calibration.load(calibration, frame, bias_only=bias_only)
    terminal.progress(f"applying {calibration.name} to {source.name}")
    if source.suffix in _RECORDINGS:
        if columns or temperature or time:
            raise UsageError(
                f"{source.name} is a recording, and --columns, --temperature, --time are of tables",
                "leave them out",
            )
        plain = _recording(terminal, found, source, out, board)
    else:
        if board:
            raise UsageError(
                f"{source.name} is a table, and --board is of recordings", "leave it out"
            )
        asked = _columns(source, columns, unit, temperature, time, time_unit)
        plain = _table(terminal, found, source, out, asked)
    left = [
        words for words in found.not_applied if words != LAG or source.suffix not in _RECORDINGS
    ]
    for words in left:
        terminal.say(f"  remark: {words}")
    terminal.say(f"  rates       rad/s, in the {found.frame}'s axes\n  written     {out}")
    about = {"board": found.board, "version": found.document.version, "frame": found.frame}
    terminal.emit({**about, **plain, "not_applied": left, "out": str(out), "exit_code": 0})
    return 0


def _columns(
    source: Path,
    columns: str | None,
    unit: Unit,
    temperature: str | None,
    time: str | None,
    time_unit: str,
) -> TableColumns:
    """Return which column is what.

    Raises:
        UsageError: the gyro's columns are not named, or not three of them.
    """
    names = [name.strip() for name in (columns or "").split(",") if name.strip()]
    if len(names) != len(RATES):
        raise UsageError(
            f"{source.name} is a table, and {len(names)} columns of it are named",
            "name the gyro's three with --columns X,Y,Z",
        )
    return TableColumns((names[0], names[1], names[2]), unit, temperature, time, time_unit)


def _recording(
    terminal: Terminal, found: Calibration, source: Path, out: Path, board: str | None
) -> dict[str, Any]:
    from gyrorig_solver.apply.recordings import apply_to_recording  # noqa: PLC0415 - scipy

    done = apply_to_recording(found, source, out, board)
    terminal.say(f"{source.name}: {done.messages} messages on {done.topic}")
    for count, words in (
        (done.left_out, "samples are saturated or repeated, and became no message"),
        (done.outside, "rates are beyond those that the calibration was made with"),
        (done.outside_warmth, "samples are beyond the temperatures that it was made at"),
    ):
        if count:
            terminal.say(f"  remark: {count} {words}")
    if found.time_offset_s is None:
        terminal.say("  remark: the time offset is not known: stamps are the samples' own times")
    for text in done.losses:
        terminal.say(f"  ! {text}")
    return asdict(done)


def _table(
    terminal: Terminal, found: Calibration, source: Path, out: Path, columns: TableColumns
) -> dict[str, Any]:
    done = apply_to_table(found, source, out, columns)
    terminal.say(f"{source.name}: {done.rows} rows")
    if done.without:
        terminal.say(f"  remark: {done.without} rows have no reading, and no rate")
    if done.outside:
        words = "rates are beyond those that the calibration was made with"
        terminal.say(f"  remark: {done.outside} {words}")
    return asdict(done)
