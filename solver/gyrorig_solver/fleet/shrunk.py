"""Shrunk values, kept beside the calibrations: what the fleet makes of each board.

    STORE/shrunk/20260131T023000Z-1a2b3c4d5e6f.parquet

What to use when: `keep_shrunk` after `overview`; `shrunk_of` for one board's latest. A file
is never changed: what is asked again of the same fleet is there already. The calibrations
themselves stay as they are, and the prior is made of them alone: nothing reads these files but
who asks for them, and they are no part of the index.
"""

import hashlib
import tempfile
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import duckdb
import numpy as np

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.fleet.overview import PARAMETERS, Overview
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.place import Place

FOLDER = "shrunk"
_DIGITS = 12  # of a digest, in a file's name


@dataclass(frozen=True, slots=True)
class Shrunk:
    """One parameter of one board with the fleet's help."""

    value: float
    std: float
    prior_dominated: bool  # more the fleet's than the board's own


def keep_shrunk(store: Path | Place, found: Overview) -> str | None:
    """Write the shrunk values of a fleet, one row a board, and return the file's name below it.

    Columns: board, sensor, version and file of the calibration that each is beside, each
    parameter and its `_std`, and `prior_dominated`, the names of those that are more the
    fleet's than the board's own. None where there are none to write.

    Raises:
        MachineError: the disk or the bucket refuses.
    """
    here = np.isfinite(found.shrunk).any(axis=1)
    if not here.any():
        return None
    place = place_at(store)
    digest = _digest(found)[:_DIGITS]
    there = [name for name in _files(place) if name.endswith(f"-{digest}.parquet")]
    if there:
        return there[-1]
    name = f"{FOLDER}/{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{digest}.parquet"
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "shrunk.parquet"
            _write(found, np.flatnonzero(here), path)
            data = path.read_bytes()
    except (OSError, duckdb.IOException) as fault:
        raise MachineError(
            f"shrunk values cannot be written, {' '.join(str(fault).split())[:200]}",
            "make room for temporary files",
        ) from fault
    place.put_new(name, data)
    return name


def _files(place: Place) -> list[str]:
    """Return the files of shrunk values, the latest last."""
    names = (entry.name for entry in place.entries(FOLDER))
    return sorted(name for name in names if name.endswith(".parquet"))


def shrunk_of(store: Path | Place, board: str) -> dict[str, Shrunk]:
    """Return the latest shrunk values of a board by parameter, empty where there are none.

    Raises:
        InputError: the file is damaged.
        MachineError: the disk or the bucket refuses.
    """
    place = place_at(store)
    files = _files(place)
    if not files:
        return {}
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETERS)
    sql = f"SELECT prior_dominated, {columns} FROM read_parquet(?) WHERE board = ?"  # noqa: S608
    try:
        with place.local(files[-1]) as path, duckdb.connect(":memory:") as database:
            rows = database.execute(sql, [str(path), board]).fetchall()
    except duckdb.Error as fault:
        raise InputError(
            f"{files[-1]} cannot be read, {' '.join(str(fault).split())[:200]}",
            "remove it: `gyrorig fleet` makes it anew",
        ) from fault
    if not rows:
        return {}
    ((dominated, *numbers),) = rows
    pairs = zip(PARAMETERS, numbers[::2], numbers[1::2], strict=True)
    return {
        name: Shrunk(value, std, name in dominated)
        for name, value, std in pairs
        if value is not None and std is not None
    }


def _digest(found: Overview) -> str:
    said = hashlib.sha256()
    for name, version in zip(found.boards.board, found.boards.version, strict=True):
        said.update(f"{name} {version}\n".encode())
    said.update(found.shrunk.tobytes())
    said.update(found.shrunk_std.tobytes())
    return said.hexdigest()


def _write(found: Overview, rows: np.ndarray, path: Path) -> None:
    boards = found.boards
    columns: dict[str, np.ndarray] = {
        name: np.array([texts[row] for row in rows], dtype=object)
        for name, texts in (
            ("board", boards.board),
            ("sensor", boards.sensor),
            ("file", boards.file),
        )
    }
    columns["version"] = np.array(boards.version, dtype=np.int32)[rows]
    for at, name in enumerate(PARAMETERS):
        columns[name] = found.shrunk[rows, at]
        columns[f"{name}_std"] = found.shrunk_std[rows, at]
        columns[f"{name}_prior"] = found.prior_dominated[rows, at]
    numbers = ", ".join(
        f"CASE WHEN isfinite({name}) THEN {name} END AS {name}, "
        f"CASE WHEN isfinite({name}_std) THEN {name}_std END AS {name}_std"
        for name in PARAMETERS
    )
    named = ", ".join(f"CASE WHEN {name}_prior THEN '{name}' END" for name in PARAMETERS)
    with duckdb.connect(":memory:") as database:
        database.register("shrunk", columns)
        quoted = str(path).replace("'", "''")
        database.execute(
            "COPY (SELECT board, sensor, version, file, "  # noqa: S608 - ours
            f"list_filter([{named}], one -> one IS NOT NULL) AS prior_dominated, {numbers} "
            f"FROM shrunk) TO '{quoted}' "
            "(FORMAT parquet, COMPRESSION zstd)"
        )
