"""`gyrorig apply`: correct the rates of a recording or a table with a calibration."""

import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply import FRAMES, LAG_NOTE, Calibration, Frame
from gyrorig_solver.apply.board_calibration import READING_UNITS, ReadingUnit
from gyrorig_solver.apply.corrected_table import (
    RATE_COLUMNS,
    TIME_UNITS_S,
    TableColumns,
    apply_to_table,
    open_table,
    print_table,
)
from gyrorig_solver.commands.terminal import Terminal, choice_option, json_option, output_option

_RECORDING_SUFFIXES = (".mcap", ".part")
_STDOUT = Path("-")


@click.command("apply")
@click.argument("calibration", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@output_option(
    "File to write; it must not exist. For a table, - is standard output.", required=True
)
@click.option(
    "--board", help="For a recording: board to correct.  [default: the board of the calibration]"
)
@choice_option(
    "--frame", FRAMES, "stage", "Axes of the corrected rates: stage, or sensor (orthogonalised)."
)
@click.option(
    "--bias-only",
    is_flag=True,
    help="Subtract the bias only; keep the nominal scale factor and axes.",
)
@click.option(
    "--columns", metavar="X,Y,Z", help="For a table: the three gyro columns, in sensor axes."
)
@choice_option("--unit", READING_UNITS, "counts", "For a table: unit of --columns.")
@click.option(
    "--temperature", metavar="COLUMN", help="For a table: column of the board temperature, degC."
)
@click.option(
    "--time",
    metavar="COLUMN",
    help="For a table: column of the sample times; the output has the motion times, in s.",
)
@choice_option("--time-unit", tuple(TIME_UNITS_S), "s", "For a table: unit of --time.")
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
    unit: ReadingUnit,
    temperature: str | None,
    time: str | None,
    time_unit: str,
) -> int:
    r"""Correct the rates of INPUT, a recording (.mcap) or a table (csv), with a calibration.

    A recording is copied with the additional topic /board/ID/imu (sensor_msgs/msg/Imu). Its
    timestamps are the times of the motion. A table is copied with the additional columns
    rate_x_rad_s, rate_y_rad_s and rate_z_rad_s. The rates are G^-1 (y - b) in rad/s, where y is
    the reading at the nominal scale factor: docs/conventions.md.

    \b
    Examples:
      gyrorig apply calibrations/GY80-1/v0001.yaml drive.mcap -o drive-imu.mcap
      gyrorig apply GY80-1.yaml log.csv --columns gx,gy,gz --unit deg/s -o log-true.csv
    """
    if _is_given("time_unit") and time is None:
        raise UsageError(
            "the option --time-unit needs the option --time",
            "give the column of the times with --time, or remove --time-unit",
        )
    if bias_only and _is_given("frame") and frame != "sensor":
        raise UsageError(
            "the option --bias-only gives rates in the axes of the sensor, so --frame has no "
            "effect",
            "remove one of the two options",
        )
    terminal.data_on_stdout = out == _STDOUT
    if terminal.data_on_stdout and source.suffix in _RECORDING_SUFFIXES:
        raise UsageError(
            "a recording cannot be written to standard output", "name a file with the option -o"
        )
    if terminal.data_on_stdout and terminal.json:
        raise UsageError(
            "the table and the output of --json cannot both be on standard output",
            "name a file with the option -o, or remove --json",
        )
    correction = Calibration.load(calibration, frame, bias_only=bias_only)
    terminal.print_progress(f"applying {calibration.name} to {source.name}")
    if source.suffix in _RECORDING_SUFFIXES:
        if columns or temperature or time or _is_given("unit"):
            raise UsageError(
                "the options --columns, --unit, --temperature and --time are only for tables, but "
                f"{source.name} is a recording",
                "remove these options",
            )
        result_json = _apply_to_recording(terminal, correction, source, out, board)
    else:
        if board:
            raise UsageError(
                f"the option --board is only for recordings, but {source.name} is a table",
                "remove the option --board",
            )
        open_table(source).close()  # a file of another kind is stated before a missing option
        table_columns = _table_columns(source, columns, unit, temperature, time, time_unit)
        result_json = _apply_to_table(terminal, correction, source, out, table_columns)
    not_applied = [
        words
        for words in correction.not_applied
        if words != LAG_NOTE or source.suffix not in _RECORDING_SUFFIXES
    ]
    for words in not_applied:
        terminal.print_result(f"  remark: {words}")
    written = "standard output" if terminal.data_on_stdout else out
    terminal.print_result(
        f"  rates       rad/s, in {correction.frame} axes\n  written     {written}"
    )
    about = {
        "board": correction.board,
        "version": correction.document.version,
        "frame": correction.frame,
    }
    terminal.print_json(
        {**about, **result_json, "not_applied": not_applied, "out": str(out), "exit_code": 0}
    )
    return 0


def _is_given(option: str) -> bool:
    """Return whether a person gave an option that has a default."""
    context = click.get_current_context()
    return context.get_parameter_source(option) is ParameterSource.COMMANDLINE


def _table_columns(
    source: Path,
    columns: str | None,
    unit: ReadingUnit,
    temperature: str | None,
    time: str | None,
    time_unit: str,
) -> TableColumns:
    """Return the columns of a table.

    Raises:
        UsageError: the number of gyro columns is not three.
    """
    names = [name.strip() for name in (columns or "").split(",") if name.strip()]
    if len(names) != len(RATE_COLUMNS):
        raise UsageError(
            f"the option --columns names {len(names)} columns of the table {source.name} "
            "instead of three",
            "give the names of the three gyro columns as --columns X,Y,Z",
        )
    return TableColumns((names[0], names[1], names[2]), unit, temperature, time, time_unit)


def _apply_to_recording(
    terminal: Terminal, correction: Calibration, source: Path, out: Path, board: str | None
) -> dict[str, Any]:
    from gyrorig_solver.apply.corrected_recording import apply_to_recording  # noqa: PLC0415 - scipy

    result = apply_to_recording(correction, source, out, board)
    terminal.print_result(f"{source.name}: {result.messages} messages on {result.topic}")
    if result.other_uid is not None:
        terminal.print_result(
            f"  remark: board {result.board} of the recording has the uid "
            f"{result.other_uid[:40]!r}, but the calibration is of the uid "
            f"{correction.document.board.uid[:40]!r}"
        )
    if result.left_out:
        terminal.print_result(
            f"  remark: {result.left_out} saturated or repeated samples were left out"
        )
    if result.without_force:
        terminal.print_result(
            f"  remark: {result.without_force} samples without an acceleration were left out"
        )
    if result.outside:
        terminal.print_result(_rate_remark(correction, result.outside, result.messages, "samples"))
    if result.outside_temperature:
        terminal.print_result(
            _temperature_remark(correction, result.outside_temperature, "samples")
        )
    if result.outside_warmth:
        terminal.print_result(
            _warmth_remark(correction, result.outside_warmth, result.messages, "samples")
        )
    if correction.time_offset_s is None:
        terminal.print_result(
            "  remark: The time offset is unknown. Timestamps are those of the samples."
        )
    for text in result.losses:
        terminal.print_result(f"  ! {text}")
    return asdict(result)


def _apply_to_table(
    terminal: Terminal, correction: Calibration, source: Path, out: Path, columns: TableColumns
) -> dict[str, Any]:
    if out == _STDOUT:
        result = print_table(correction, source, sys.stdout.buffer, columns)
    else:
        result = apply_to_table(correction, source, out, columns)
    terminal.print_result(f"{source.name}: {result.rows} rows")
    if result.outside_range:
        terminal.print_result(_temperature_remark(correction, result.outside_range, "rows"))
    if result.without:
        terminal.print_result(f"  remark: {result.without} rows have no reading and get no rate")
    if result.without_time:
        terminal.print_result(
            f"  remark: {result.without_time} rows have no time and get no time of the motion"
        )
    if result.outside:
        terminal.print_result(_rate_remark(correction, result.outside, result.rows, "rows"))
    if result.outside_warmth:
        terminal.print_result(
            _warmth_remark(correction, result.outside_warmth, result.rows, "rows")
        )
    return asdict(result)


def _warmth_remark(correction: Calibration, outside: int, total: int, unit: str) -> str:
    """Return a remark on samples outside the temperatures of a constant bias."""
    low, high = correction.document.validity.temperature_degc or (math.nan, math.nan)
    return (
        f"  remark: {outside} of {total} {unit} were taken outside {low:.1f} to {high:.1f} degC, "
        "the temperatures of this calibration. Their rates are extrapolated."
    )


def _temperature_remark(correction: Calibration, count: int, unit: str) -> str:
    """Return a remark on samples outside the temperatures of the calibration."""
    low, high = correction.correction.temperature_range_degc or (math.nan, math.nan)
    return (
        f"  remark: {count} {unit} get no rate, because their temperatures are outside "
        f"{low:.1f} to {high:.1f} degC, the valid range of the calibration"
    )


def _rate_remark(correction: Calibration, outside: int, total: int, unit: str) -> str:
    """Return a remark on rates above the range in which the calibration was measured."""
    limit_rad_s = max(abs(bound) for bound in correction.document.validity.rate_rad_s)
    return (
        f"  remark: {outside} of {total} {unit} ({100.0 * outside / total:.3g} %) have rates above "
        f"{math.degrees(limit_rad_s):.4g} deg/s, the largest rate in the recordings of this "
        "calibration. These rates are extrapolated. A few such samples are normal."
    )
