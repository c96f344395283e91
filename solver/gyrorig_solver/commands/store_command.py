"""`gyrorig store`: list, show, compare and verify the calibrations of a store."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import CalibrationDocument, calibration_as_mapping
from gyrorig_solver.calibration.calibration_summary import calibration_summary
from gyrorig_solver.commands.stored_versions import (
    find_version,
    parameter_differences,
    read_version,
    versions_in_time,
)
from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.data.text_table import format_table
from gyrorig_solver.data.utc_time import TIME_FORMAT
from gyrorig_solver.fleet.column_units import column_label, column_unit
from gyrorig_solver.fleet.drift.shrinkage_files import read_shrinkage_estimates
from gyrorig_solver.fleet.store import open_existing_store, read_signer, rebuild_index, verify
from gyrorig_solver.fleet.store.manifest import read_public_key
from gyrorig_solver.fleet.store.store_heads import heads_text
from gyrorig_solver.fleet.store.store_queries import (
    VersionFilter,
    all_versions,
    newest_versions,
    unsuccessful_work,
)
from gyrorig_solver.fleet.store.store_verification import REMEDIES
from gyrorig_solver.model import format_quantity, plural
from gyrorig_solver.storage import Storage, StorageOption, write_file

_DAMAGED_STATUS = 3
_FAULTS_SHOWN = 50
_DATES = ["%Y-%m-%d", TIME_FORMAT]
_DATE = "YYYY-MM-DD[THH:MM:SSZ]"

_store_argument = click.argument("folder", metavar="STORE", type=StorageOption())
_KEY_FILE = click.Path(path_type=Path, dir_okay=False, exists=True)


@click.group("store")
def store_command() -> None:
    r"""Look at the store that `gyrorig batch` writes.

    \b
    Example:
      gyrorig store ls calibrations --board 'GY80-*' --since 2026-01-01
      gyrorig store verify calibrations
    """


@store_command.command("ls")
@_store_argument
@click.option("--board", help="Only boards whose name matches; * and ? are wildcards.")
@click.option("--sensor", help="Only boards with this sensor.")
@click.option("--rig", help="Only recordings of this rig.")
@click.option("--config", "config_hash", help="Only boards with this configuration hash.")
@click.option(
    "--since",
    type=click.DateTime(_DATES),
    metavar=_DATE,
    help="Only calibrations made at this time (UTC) or later.",
)
@click.option(
    "--until",
    type=click.DateTime(_DATES),
    metavar=_DATE,
    help="Only calibrations made before this time (UTC).",
)
@click.option("--all", "every", is_flag=True, help="Every version, not only the latest.")
@click.option("--wrong", is_flag=True, help="Recordings without a calibration, and the reasons.")
@click.option(
    "--limit",
    type=click.IntRange(1),
    default=1000,
    show_default=True,
    help="Maximum number of lines.",
)
@json_option
@click.pass_obj
def ls_command(
    terminal: Terminal,
    folder: Storage,
    board: str | None,
    sensor: str | None,
    rig: str | None,
    config_hash: str | None,
    since: datetime | None,
    until: datetime | None,
    every: bool,
    wrong: bool,
    limit: int,
) -> int:
    r"""List the latest calibration of each board, which is that of its last recording.

    \b
    Example:
      gyrorig store ls calibrations
      gyrorig store ls calibrations --board 'GY80-*' --all
      gyrorig store ls calibrations --wrong
    """
    open_existing_store(folder)
    version_filter = VersionFilter(board, sensor, rig, config_hash, since, until)
    if wrong:
        rows = unsuccessful_work(folder, version_filter, limit + 1)
        columns: tuple[str, ...] = ("status", "board", "created", "names", "reason")
    else:
        rows = (all_versions if every else newest_versions)(folder, version_filter, limit + 1)
        columns = ("board", "version", "trust", "created", "start", "sensor", "rig")
    has_more, rows = len(rows) > limit, rows[:limit]
    headings = {"trust": "verdict", "start": "recorded", "names": "recordings"}
    terminal.print_result(_table(rows, {name: headings.get(name, name) for name in columns}))
    if has_more:
        terminal.print_result(f"Only the first {limit} are listed. Use a larger --limit for more.")
    terminal.print_json({"rows": [{key: _json_value(row[key]) for key in row} for row in rows]})
    return 0


@store_command.command("show")
@_store_argument
@click.argument("board")
@click.option(
    "--version",
    type=click.IntRange(1),
    help="The version number, from 1.  [default: that of the last recording]",
)
@click.option(
    "--at",
    type=click.DateTime(_DATES),
    metavar=_DATE,
    help="In place of --version: the last version recorded until this time (UTC).",
)
@click.option(
    "--config",
    "config_hash",
    help="In place of --version: the last version with this configuration hash.",
)
@json_option
@click.pass_obj
def show_command(
    terminal: Terminal,
    folder: Storage,
    board: str,
    version: int | None,
    at: datetime | None,
    config_hash: str | None,
) -> int:
    r"""Show one calibration, the recordings it was made from, and its shrinkage estimates.

    Without options, the version of the last recording is shown.

    \b
    Example:
      gyrorig store show calibrations GY80-1 --at 2026-01-31
    """
    if version is not None and (at, config_hash) != (None, None):
        raise UsageError(
            f"the option --version {version} already selects one calibration, so --at and "
            "--config have no effect",
            "remove the options --at and --config",
        )
    path, calibration = (
        find_version(folder, BoardId(board), version)
        if version is not None
        else read_version(versions_in_time(folder, BoardId(board), at, config_hash)[-1])
    )
    terminal.print_result(calibration_summary(calibration))
    for source in calibration.inputs:
        terminal.print_result(
            f"  recording             {source.name}, {source.start}, sha256 {source.sha256}"
        )
    terminal.print_result(f"  calibration           {path}")
    shrunk = read_shrinkage_estimates(folder, board)
    if shrunk:
        terminal.print_result("  shrinkage estimates from the whole fleet:")
    for name, estimate in shrunk.items():
        factor, unit = column_unit(name)
        value, std = format_quantity(factor * estimate.value, factor * estimate.std)
        note = " (mostly the fleet's mean)" if estimate.prior_dominated else ""
        terminal.print_result(
            f"    {column_label(name):<19} {value} ± {std} {unit}".rstrip() + note
        )
    plain = {name: asdict(estimate) for name, estimate in shrunk.items()}
    terminal.print_json(
        {"file": str(path), "calibration": calibration_as_mapping(calibration), "shrunk": plain}
    )
    return 0


@store_command.command("diff")
@_store_argument
@click.argument("board")
@click.argument("old", type=click.IntRange(1), required=False)
@click.argument("new", type=click.IntRange(1), required=False)
@json_option
@click.pass_obj
def diff_command(
    terminal: Terminal, folder: Storage, board: str, old: int | None, new: int | None
) -> int:
    r"""Compare two versions of a board: by default those of the last two recordings.

    The last column is the change divided by the combined standard deviation. The bias of a
    gyroscope changes from day to day by much more than its standard deviation on one day.

    \b
    Example:
      gyrorig store diff calibrations GY80-1
      gyrorig store diff calibrations GY80-1 1 3
    """
    name = BoardId(board)
    if old is None or new is None:
        numbers = [version.number for version in versions_in_time(folder, name)]
        new = numbers[-1] if new is None else new
        before = numbers[: numbers.index(new)] if new in numbers else []
        old = (before or [new])[-1] if old is None else old
    _, earlier = find_version(folder, name, old)
    _, later = find_version(folder, name, new)
    rows = list(parameter_differences(earlier, later))
    terminal.print_result(f"{board}: {_version_text(earlier)} to {_version_text(later)}")
    if earlier.version == later.version:
        terminal.print_result(
            f"  remark: version {later.version} is compared with itself, because no other version "
            "was recorded before it or chosen"
        )
    columns = ("parameter", "before", "after", "change", "unit", "sigma")
    shown = [_difference_with_unit(row) for row in rows]
    terminal.print_result(_table(shown, {name: name for name in columns}))
    terminal.print_json({"from": earlier.version, "to": later.version, "parameters": rows})
    return 0


@store_command.command("verify")
@_store_argument
@click.option(
    "--key",
    type=_KEY_FILE,
    help="A public Ed25519 key (PEM): every calibration must be signed with it.  "
    "[default: signatures are not checked]",
)
@click.option(
    "--at-least",
    "heads",
    type=_KEY_FILE,
    help="A list that --write-heads wrote: the store must still contain its versions.  "
    "[default: not compared]",
)
@click.option(
    "--write-heads",
    "new_heads",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File to write if there are no faults: the newest versions, for a later --at-least. "
    "Keep it outside the store.  [default: not written]",
)
@json_option
@click.pass_obj
def verify_command(
    terminal: Terminal,
    folder: Storage,
    key: Path | None,
    heads: Path | None,
    new_heads: Path | None,
) -> int:
    r"""Compare every file with its SHA-256 in the next version, the index and the manifests.

    Exits with status 3 when a file is damaged, missing, unknown or, with --key, not signed. With
    --at-least, also when the store was replaced by an older copy of itself.
    Without this program: sha256sum -c manifest/*.sha256, in the folder of the store.

    \b
    Example:
      gyrorig store verify calibrations
      gyrorig store verify s3://fleet/calibrations --key fleet-public.pem
    """
    result = verify(folder, None if key is None else read_public_key(key), heads)
    for fault in result.faults[:_FAULTS_SHOWN]:
        terminal.print_result(f"{fault.kind:<11} {fault.file}: {fault.text}")
    if len(result.faults) > _FAULTS_SHOWN:
        terminal.print_result(f"and {len(result.faults) - _FAULTS_SHOWN} more")
    counts = (
        f"{plural(result.boards, 'board')}, {plural(result.versions, 'version')}, "
        f"{plural(result.rows, 'index row')}, {plural(result.manifest_files, 'file')} in manifests"
    )
    outcome = plural(len(result.faults), "fault") if result.faults else "no faults"
    terminal.print_result(f"{counts}: {outcome}")
    for kind in dict.fromkeys(fault.kind for fault in result.faults):
        terminal.print_result(f"  {kind:<11} {REMEDIES[kind].replace('STORE', folder.location)}")
    code = _DAMAGED_STATUS if result.faults else 0
    if new_heads is not None and not result.faults:
        write_file(new_heads, heads_text(folder).encode(), replace=True)
        terminal.print_result(f"heads: {new_heads}")
    faults = [asdict(fault) for fault in result.faults]
    terminal.print_json({"versions": result.versions, "faults": faults, "exit_code": code})
    return code


@store_command.command("rebuild-index")
@_store_argument
@click.option(
    "--sign",
    type=_KEY_FILE,
    help="A private Ed25519 key (PEM) that signs the manifest.  [default: not signed]",
)
@json_option
@click.pass_obj
def rebuild_command(terminal: Terminal, folder: Storage, sign: Path | None) -> int:
    r"""Write the index and the manifests again, from the calibrations in the store.

    \b
    Example:
      gyrorig store rebuild-index calibrations --sign fleet.pem
    """
    count = rebuild_index(folder, None if sign is None else read_signer(sign))
    terminal.print_result(f"{plural(count, 'version')} in the index of {folder.location}")
    terminal.print_json({"versions": count})
    return 0


def _version_text(calibration: CalibrationDocument) -> str:
    if not calibration.inputs:
        return f"version {calibration.version}, made {calibration.created[:10]}"
    return f"version {calibration.version}, recorded {calibration.inputs[0].start[:10]}"


def _difference_with_unit(row: dict[str, Any]) -> dict[str, Any]:
    factor, unit = column_unit(row["parameter"])
    values = {name: factor * row[name] for name in ("before", "after", "change")}
    return {
        "parameter": column_label(row["parameter"]),
        "unit": unit,
        "sigma": row["sigma"],
        **values,
    }


def _table(rows: Sequence[dict[str, Any]], headings: dict[str, str]) -> str:
    """Return rows as a text table; `headings` has the columns and the words above them."""
    cells = [[_cell_text(row.get(name)) for name in headings] for row in rows]
    return "\n".join(format_table([list(headings.values()), *cells]))


def _cell_text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    text = ", ".join(value) if isinstance(value, list) else str(value)
    return " ".join(text.split())  # a name in a recording is untrusted, and a row is one line


def _json_value(value: Any) -> Any:
    if isinstance(value, datetime):
        return value.strftime(TIME_FORMAT)
    return value
