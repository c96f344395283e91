"""`gyrorig import`: measurements made elsewhere become a recording."""

from dataclasses import asdict
from pathlib import Path

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.commands.project_files import project_file, project_names
from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.importers import import_measurements, load_import_map

_WITH_MAP = ("csv", "npz")
_PHONE = "android"


@click.command("import")
@click.argument("kind", metavar="FORMAT")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "--map",
    "map_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With FORMAT csv or npz: which column is what (YAML), as in config/imports.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    required=True,
    help="The recording to write; it must not exist.",
)
@click.option("--board", help="The board's name.  [default: the map's; of a phone PHONE]")
@click.option(
    "--sensor",
    help="With FORMAT android: the gyroscope's part, such as MPU-6515 of a Nexus 5.  "
    "[default: android]",
)
@click.option(
    "--beside",
    type=click.Path(path_type=Path, dir_okay=False),
    help="With FORMAT android: the recording of the unit that turned the phone meanwhile.",
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
    beside: Path | None,
) -> int:
    r"""Turn measurements made elsewhere into a recording of format 1.

    FORMAT is csv or npz, with a column map; android, a phone's log as the common loggers
    write it, whose clock is found from the motion when it was logged on a unit; or the name
    of a map in config/imports.

    \b
    Examples:
      gyrorig import csv drive.csv --map columns.yaml --out drive.mcap
      gyrorig import broad trial02.npz --board IMU-1 --out trial02.mcap
      gyrorig import android Gyroscope.csv --board NEXUS5 --sensor MPU-6515 --out phone.mcap
    """
    terminal.progress(f"importing {source.name}")
    if kind == _PHONE:
        if map_path is not None:
            raise UsageError(
                "FORMAT android knows the columns of a phone's log itself",
                "leave out --map, or give FORMAT csv",
            )
        from gyrorig_solver.importers.phone import import_phone  # noqa: PLC0415 - loads scipy

        result = import_phone(source, out, board or "PHONE", sensor or "android", beside)
    else:
        if sensor is not None or beside is not None:
            raise UsageError(
                f"--sensor and --beside go with FORMAT android, not {kind}",
                "leave them out: the map says the sensor",
            )
        mapping = load_import_map(_map_of(kind, map_path))
        result = import_measurements(source, mapping, out, board)
    plain = {name: str(v) if isinstance(v, Path) else v for name, v in asdict(result).items()}
    terminal.say(f"{source.name}: {result.samples} samples of {result.board}")
    for note in result.notes:
        terminal.say(f"  remark: {note}")
    terminal.say(f"  recording   {out}")
    terminal.emit({**plain, "recording": str(out), "exit_code": 0})
    return 0


def _map_of(kind: str, map_path: Path | None) -> Path:
    """Return the column map that FORMAT means.

    Raises:
        UsageError: a map is missing, given twice, or not known.
    """
    if kind in _WITH_MAP:
        if map_path is None:
            raise UsageError(
                f"FORMAT {kind} needs to be told which column is what",
                "name a column map with --map, such as one of config/imports",
            )
        return map_path
    if map_path is not None:
        raise UsageError(
            f"FORMAT {kind} has its own column map", "leave out --map, or give FORMAT csv or npz"
        )
    names = project_names("imports")
    if kind not in names:
        known = ", ".join((*_WITH_MAP, _PHONE, *names))
        raise UsageError(f"there is no FORMAT {kind!r:.40}", f"give one of {known}")
    return project_file("imports", f"{kind}.yaml")
