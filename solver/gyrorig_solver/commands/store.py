"""`gyrorig store`: a fleet's calibrations listed, shown, compared, verified."""

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.document import Calibration, parse_calibration, to_plain
from gyrorig_solver.calibration.store import StoredVersion
from gyrorig_solver.calibration.summary import summary
from gyrorig_solver.commands.terminal import Terminal, json_option
from gyrorig_solver.fleet.manifest import public_key_of, signer_of
from gyrorig_solver.fleet.rows import parameter_columns, parameters_of
from gyrorig_solver.fleet.shelf import (
    Chosen,
    gone_wrong,
    in_time,
    newest,
    opened,
    rebuild_index,
    versions_of,
)
from gyrorig_solver.fleet.shrunk import shrunk_of
from gyrorig_solver.fleet.verifying import REMEDIES, verify
from gyrorig_solver.places.choose import PlaceOption
from gyrorig_solver.places.place import Place

_DAMAGED = 3
_FAULTS_SHOWN = 50
_DATES = ["%Y-%m-%d", "%Y-%m-%dT%H:%M:%SZ"]
_DATE = "YYYY-MM-DD[THH:MM:SSZ]"

_folder = click.argument("folder", metavar="STORE", type=PlaceOption())
_SIGN = click.Path(path_type=Path, dir_okay=False, exists=True)


@click.group("store")
def store_command() -> None:
    r"""Look at the store that `gyrorig batch` writes.

    \b
    Example:
      gyrorig store ls calibrations --board 'GY80-*' --since 2026-01-01
      gyrorig store verify calibrations
    """


@store_command.command("ls")
@_folder
@click.option("--board", help="Only boards of such a name; * and ? stand for anything.")
@click.option("--sensor", help="Only boards with this sensor.")
@click.option("--rig", help="Only what this rig recorded.")
@click.option("--config", "config_hash", help="Only boards set so: the configuration's digest.")
@click.option(
    "--since",
    type=click.DateTime(_DATES),
    metavar=_DATE,
    help="Only what was calibrated then (UTC) or later.",
)
@click.option(
    "--until",
    type=click.DateTime(_DATES),
    metavar=_DATE,
    help="Only what was calibrated before (UTC).",
)
@click.option("--all", "every", is_flag=True, help="Every version, not only the newest.")
@click.option("--wrong", is_flag=True, help="What has no calibration, and why.")
@click.option(
    "--limit",
    type=click.IntRange(1),
    default=1000,
    show_default=True,
    help="At most so many lines.",
)
@json_option
@click.pass_obj
def ls_command(
    terminal: Terminal,
    folder: Place,
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
    """List the newest calibration of each board."""
    opened(folder)
    chosen = Chosen(board, sensor, rig, config_hash, since, until)
    if wrong:
        found = gone_wrong(folder, limit)
        shown: tuple[str, ...] = ("status", "board", "created", "names", "reason")
    else:
        found = (versions_of if every else newest)(folder, chosen, limit)
        shown = ("board", "version", "trust", "created", "start", "sensor", "rig")
    terminal.say(_table(found, shown))
    if len(found) == limit:
        terminal.say(f"the first {limit}; for more give a larger --limit")
    terminal.emit({"rows": [{key: _plain(row[key]) for key in row} for row in found]})
    return 0


@store_command.command("show")
@_folder
@click.argument("board")
@click.option(
    "--version",
    type=click.IntRange(1),
    help="The version's number, from 1.  [default: that of the last recording]",
)
@click.option(
    "--at",
    type=click.DateTime(_DATES),
    metavar=_DATE,
    help="In place of --version: the last one measured by then (UTC).",
)
@click.option(
    "--config",
    "config_hash",
    help="In place of --version: the last one of the board set so, by its configuration's digest.",
)
@json_option
@click.pass_obj
def show_command(
    terminal: Terminal,
    folder: Place,
    board: str,
    version: int | None,
    at: datetime | None,
    config_hash: str | None,
) -> int:
    """Show one calibration, and where it came from.

    Without a version the one whose recording is the last; that before a date with --at, that
    of boards set so with --config.

    Example: gyrorig store show calibrations GY80-1 --at 2026-01-31
    """
    if version is not None and (at, config_hash) != (None, None):
        raise UsageError(
            f"--version {version} names one calibration already", "leave out --at and --config"
        )
    path, made = (
        _version(folder, BoardId(board), version)
        if version is not None
        else _read(_last(folder, BoardId(board), at, config_hash)[-1])
    )
    terminal.say(summary(made))
    for one in made.inputs:
        terminal.say(f"  from                  {one.name}, {one.start}, sha256 {one.sha256}")
    terminal.say(f"  calibration           {path}")
    shrunk = shrunk_of(folder, board)
    for name, own in shrunk.items():
        whose = "more the fleet's than its own" if own.prior_dominated else "with the fleet's help"
        terminal.say(f"  {name:<21} {own.value:.6g} ± {own.std:.2g}, {whose}")
    plain = {name: asdict(own) for name, own in shrunk.items()}
    terminal.emit({"file": str(path), "calibration": to_plain(made), "shrunk": plain})
    return 0


@store_command.command("diff")
@_folder
@click.argument("board")
@click.argument("old", type=click.IntRange(1), required=False)
@click.argument("new", type=click.IntRange(1), required=False)
@json_option
@click.pass_obj
def diff_command(
    terminal: Terminal, folder: Place, board: str, old: int | None, new: int | None
) -> int:
    r"""Compare two versions of a board: without numbers, the last measured with the one before.

    Each difference is given in combined standard deviations. The bias of a gyroscope moves
    from day to day by much more than its deviation within one.
    """
    name = BoardId(board)
    if old is None or new is None:
        numbers = [one.number for one in _last(folder, name)]
        new = numbers[-1] if new is None else new
        before = numbers[: numbers.index(new)] if new in numbers else []
        old = (before or [new])[-1] if old is None else old
    _, earlier = _version(folder, name, old)
    _, later = _version(folder, name, new)
    rows = list(_differences(earlier, later))
    terminal.say(f"{board}: version {earlier.version} to {later.version}")
    terminal.say(_table(rows, ("parameter", "before", "after", "change", "sigma")))
    terminal.emit({"from": earlier.version, "to": later.version, "parameters": rows})
    return 0


@store_command.command("verify")
@_folder
@click.option("--key", type=_SIGN, help="With it all must be signed: a public Ed25519 key (PEM).")
@json_option
@click.pass_obj
def verify_command(terminal: Terminal, folder: Place, key: Path | None) -> int:
    r"""Compare every file with its digest, the version after it, the index and the manifests.

    Leaves with 3 when anything is damaged, missing, unknown or not signed as asked. Without
    this program: sha256sum -c manifest/*.sha256, in the store's folder.

    \b
    Example:
      gyrorig store verify calibrations
      gyrorig store verify s3://fleet/calibrations --key fleet-public.pem
    """
    found = verify(folder, None if key is None else public_key_of(key))
    said = f"{found.boards} boards, {found.versions} versions, {found.rows} rows of the index, "
    said += f"{found.sealed} files in manifests"
    for fault in found.faults[:_FAULTS_SHOWN]:
        terminal.say(f"{fault.kind:<11} {fault.file}: {fault.text}")
    if len(found.faults) > _FAULTS_SHOWN:
        terminal.say(f"and {len(found.faults) - _FAULTS_SHOWN} more")
    terminal.say(f"{said}: {f'{len(found.faults)} faults' if found.faults else 'all as written'}")
    for kind in dict.fromkeys(fault.kind for fault in found.faults):
        terminal.say(f"  {kind:<11} {REMEDIES[kind].replace('STORE', folder.text)}")
    code = _DAMAGED if found.faults else 0
    faults = [{"kind": f.kind, "file": f.file, "text": f.text} for f in found.faults]
    terminal.emit({"versions": found.versions, "faults": faults, "exit_code": code})
    return code


@store_command.command("rebuild-index")
@_folder
@click.option(
    "--sign", type=_SIGN, help="With it the manifest is signed: a private Ed25519 key (PEM)."
)
@json_option
@click.pass_obj
def rebuild_command(terminal: Terminal, folder: Place, sign: Path | None) -> int:
    """Make the index and the manifests anew from the calibrations themselves."""
    count = rebuild_index(folder, None if sign is None else signer_of(sign))
    terminal.say(f"{count} versions in the index of {folder.text}")
    terminal.emit({"versions": count})
    return 0


def _version(folder: Place, board: BoardId, number: int) -> tuple[Path, Calibration]:
    """Return one version of a board.

    Raises:
        InputError: there is no such board or version, or it is damaged.
    """
    versions = opened(folder).versions(board)
    for one in versions:
        if one.number == number:
            return _read(one)
    if not versions:
        raise _no_board(folder, board)
    raise InputError(
        f"{folder.text} holds no version {number} of board {board}",
        f"give one from {versions[0].number} to {versions[-1].number}",
    )


def _no_board(folder: Place, board: BoardId) -> InputError:
    return InputError(
        f"{folder.text} holds no board {board}",
        f"see which it has: gyrorig store ls {folder.text}",
    )


def _last(
    folder: Place, board: BoardId, at: datetime | None = None, config_hash: str | None = None
) -> list[StoredVersion]:
    """Return the versions of a board by when they were measured, the last one last.

    Args:
        folder: the store.
        board: which one.
        at: none that was measured later, None for all.
        config_hash: those of a board set so, None for all.

    Raises:
        InputError: there is none.
    """
    versions = in_time(folder, board)
    found = [
        one.stored
        for one in versions
        if (at is None or one.start <= at) and config_hash in (None, one.config_hash)
    ]
    if not versions:
        raise _no_board(folder, board)
    if not found:
        asked = [
            *([] if at is None else [f"measured by {at:%Y-%m-%d %H:%M} UTC"]),
            *([] if config_hash is None else [f"with the configuration {config_hash[:20]}"]),
        ]
        raise InputError(
            f"{folder.text} holds no version of board {board} {' and '.join(asked)}",
            f"see which it has: gyrorig store ls {folder.text} --all --board {board}",
        )
    return found


def _read(stored: StoredVersion) -> tuple[Path, Calibration]:
    return stored.path, parse_calibration(stored.data(), str(stored.path))


def _differences(earlier: Calibration, later: Calibration) -> Any:
    before, after = parameters_of(earlier), parameters_of(later)
    for name in parameter_columns():
        if name.endswith("_std") or name not in before or name not in after:
            continue
        change = after[name] - before[name]
        both = (before[f"{name}_std"] ** 2 + after[f"{name}_std"] ** 2) ** 0.5
        yield {
            "parameter": name,
            "before": before[name],
            "after": after[name],
            "change": change,
            "sigma": change / both if both else None,
        }


def _table(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> str:
    cells = [list(columns), *([_text(row.get(name)) for name in columns] for row in rows)]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    lines = ("  ".join(f"{c:<{w}}" for c, w in zip(line, widths, strict=True)) for line in cells)
    return "\n".join(line.rstrip() for line in lines)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    return ", ".join(value) if isinstance(value, list) else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%dT%H:%M:%SZ}"
    return value
