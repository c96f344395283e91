"""`gyrorig import`: convert measurements of another format to a recording."""

from dataclasses import asdict
from pathlib import Path

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.suggestions import did_you_mean
from gyrorig_solver.commands.project_files import project_file, project_names
from gyrorig_solver.commands.terminal import Terminal, json_option, output_option
from gyrorig_solver.importers import import_measurements, load_import_map

_MAPPED_FORMATS = ("csv", "npz")
_PHONE_FORMAT = "android"


@click.command("import")
@click.argument("kind", metavar="FORMAT")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With FORMAT csv or npz: the column map (YAML); see config/imports for examples.",
)
@output_option("Recording to write; it must not exist.", required=True)
@click.option("--board", help="Name of the board.  [default: from the map; PHONE for a phone]")
@click.option(
    "--sensor",
    help="With FORMAT android: sensor type, for example MPU-6515 of a Nexus 5.  [default: android]",
)
@click.option(
    "--beside",
    "unit_recording",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With FORMAT android: recording of the unit that turned the phone.",
)
@json_option
@click.pass_obj
def import_command(
    terminal: Terminal,
    kind: str,
    source: Path,
    map_path: Path | None,
    out: Path,
    board: str | None,
    sensor: str | None,
    unit_recording: Path | None,
) -> int:
    r"""Convert measurements of another format to a recording.

    FORMAT is `csv` or `npz` (with --map), `android` for the log of a phone, or the name of a
    column map in config/imports. With --beside, the clock of a phone is found from the motion.
    docs/how-to/import.md describes the column map, and the page "Import map" of the
    documentation (reference/import-map) lists all its keys.

    \b
    Examples:
      gyrorig import csv drive.csv --map columns.yaml -o drive.mcap
      gyrorig import broad trial02.npz --board IMU-1 -o trial02.mcap
      gyrorig import android Gyroscope.csv --board NEXUS5 --sensor MPU-6515 -o phone.mcap
    """
    if kind == _PHONE_FORMAT:
        if map_path is not None:
            raise UsageError(
                "the format android needs no column map, so --map cannot be used with it",
                "remove the option --map, or use the format csv",
            )
        from gyrorig_solver.importers.phone_import import import_phone  # noqa: PLC0415 - loads scipy

        terminal.print_progress(f"importing {source.name}")
        result = import_phone(source, out, board or "PHONE", sensor or "android", unit_recording)
    else:
        if sensor is not None or unit_recording is not None:
            raise UsageError(
                "the options --sensor and --beside are only for the format android, not for "
                f"{kind}",
                "remove these options, and give the sensor in the column map",
            )
        mapping = load_import_map(_column_map_path(kind, map_path))
        terminal.print_progress(f"importing {source.name}")
        result = import_measurements(source, mapping, out, board)
    plain = {name: str(v) if isinstance(v, Path) else v for name, v in asdict(result).items()}
    terminal.print_result(f"{source.name}: {result.samples} samples of {result.board}")
    for note in result.notes:
        terminal.print_result(f"  remark: {note}")
    terminal.print_result(f"  recording   {out}")
    terminal.print_json({**plain, "recording": str(out), "exit_code": 0})
    return 0


def _column_map_path(kind: str, map_path: Path | None) -> Path:
    """Return the path of the column map.

    Raises:
        UsageError: the map is missing, given twice, or unknown.
    """
    if kind in _MAPPED_FORMATS:
        if map_path is None:
            raise UsageError(
                f"the format {kind} needs a column map",
                "give a column map with --map. The folder config/imports has examples",
            )
        return map_path
    if map_path is not None:
        raise UsageError(
            f"the format {kind} has a built-in column map, so --map cannot be used with it",
            "remove the option --map, or use the format csv or npz",
        )
    names = project_names("imports")
    if kind not in names:
        known = (*_MAPPED_FORMATS, _PHONE_FORMAT, *names)
        raise UsageError(
            f"the format {kind!r:.40} is unknown",
            did_you_mean(kind, known) or f"choose one of the formats {', '.join(known)}",
        )
    return project_file("imports", f"{kind}.yaml")
