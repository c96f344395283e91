"""Shrinkage estimates of all boards, as Parquet files in the store.

    STORE/shrunk/20260131T023000Z-1a2b3c4d5e6f.parquet

What to use when: `write_shrinkage_estimates` after `build_overview`; `read_shrinkage_estimates`
for the latest of one board. A file is never changed, and the same fleet is not written twice. The
calibrations stay as they are, and the prior is computed from them alone: these files are not part
of the index and are never used as an input.
"""

import hashlib
import tempfile
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import duckdb
import numpy as np

from gyrorig_protocol.errors import InputError, MachineError
from gyrorig_solver.fleet.drift.fleet_overview import PARAMETER_COLUMNS, FleetOverview
from gyrorig_solver.storage import Storage, storage_at

SHRINKAGE_FOLDER = "shrunk"
_DIGEST_CHARS = 12  # of a digest, in a file's name


@dataclass(frozen=True, slots=True)
class ShrinkageEstimate:
    """Shrinkage estimate of one parameter of one board."""

    value: float
    std: float
    prior_dominated: bool  # mostly the fleet's mean


def write_shrinkage_estimates(store: Path | Storage, overview: FleetOverview) -> str | None:
    """Write the shrinkage estimates of a fleet, one row per board; return the file's name.

    Columns: board; sensor, version and file of its calibration; each parameter and its `_std`;
    `prior_dominated`, the names of the parameters that are mostly the fleet's mean. Returns None
    if there are no estimates.

    Raises:
        MachineError: the disk or the bucket refuses.
    """
    has_estimate = np.isfinite(overview.shrunk).any(axis=1)
    if not has_estimate.any():
        return None
    storage = storage_at(store)
    digest = _content_digest(overview)[:_DIGEST_CHARS]
    existing = [name for name in _shrinkage_files(storage) if name.endswith(f"-{digest}.parquet")]
    if existing:
        return existing[-1]
    name = f"{SHRINKAGE_FOLDER}/{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{digest}.parquet"
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "shrunk.parquet"
            _write_parquet(overview, np.flatnonzero(has_estimate), path)
            data = path.read_bytes()
    except (OSError, duckdb.IOException) as fault:
        raise MachineError(
            "the temporary file with the shrinkage estimates of the fleet cannot be written "
            f"({' '.join(str(fault).split())[:200]})",
            "free some space on the disk for temporary files",
        ) from fault
    storage.write_new(name, data)
    return name


def _shrinkage_files(storage: Storage) -> list[str]:
    """Return the names of the files, the latest last."""
    names = (entry.name for entry in storage.list_files(SHRINKAGE_FOLDER))
    return sorted(name for name in names if name.endswith(".parquet"))


def read_shrinkage_estimates(store: Path | Storage, board: str) -> dict[str, ShrinkageEstimate]:
    """Return the latest shrinkage estimates of a board by parameter, empty if there are none.

    Raises:
        InputError: the file is damaged.
        MachineError: the disk or the bucket refuses.
    """
    storage = storage_at(store)
    files = _shrinkage_files(storage)
    if not files:
        return {}
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETER_COLUMNS)
    sql = f"SELECT prior_dominated, {columns} FROM read_parquet(?) WHERE board = ?"  # noqa: S608
    try:
        with storage.local_copy(files[-1]) as path, duckdb.connect(":memory:") as database:
            rows = database.execute(sql, [str(path), board]).fetchall()
    except duckdb.Error as fault:
        raise InputError(
            f"the file {files[-1]} in the calibration store cannot be read "
            f"({' '.join(str(fault).split())[:200]})",
            "remove the file, and write it again with `gyrorig fleet`",
        ) from fault
    if not rows:
        return {}
    ((dominated, *numbers),) = rows
    pairs = zip(PARAMETER_COLUMNS, numbers[::2], numbers[1::2], strict=True)
    return {
        name: ShrinkageEstimate(value, std, name in dominated)
        for name, value, std in pairs
        if value is not None and std is not None
    }


def _content_digest(overview: FleetOverview) -> str:
    digest = hashlib.sha256()
    for name, version in zip(overview.boards.board, overview.boards.version, strict=True):
        digest.update(f"{name} {version}\n".encode())
    digest.update(overview.shrunk.tobytes())
    digest.update(overview.shrunk_std.tobytes())
    return digest.hexdigest()


def _write_parquet(overview: FleetOverview, rows: np.ndarray, path: Path) -> None:
    boards = overview.boards
    columns: dict[str, np.ndarray] = {
        name: np.array([texts[row] for row in rows], dtype=object)
        for name, texts in (
            ("board", boards.board),
            ("sensor", boards.sensor),
            ("file", boards.file),
        )
    }
    columns["version"] = np.array(boards.version, dtype=np.int32)[rows]
    for index, name in enumerate(PARAMETER_COLUMNS):
        columns[name] = overview.shrunk[rows, index]
        columns[f"{name}_std"] = overview.shrunk_std[rows, index]
        columns[f"{name}_prior"] = overview.prior_dominated[rows, index]
    numbers = ", ".join(
        f"CASE WHEN isfinite({name}) THEN {name} END AS {name}, "
        f"CASE WHEN isfinite({name}_std) THEN {name}_std END AS {name}_std"
        for name in PARAMETER_COLUMNS
    )
    dominated_names = ", ".join(
        f"CASE WHEN {name}_prior THEN '{name}' END" for name in PARAMETER_COLUMNS
    )
    with duckdb.connect(":memory:") as database:
        database.register("shrunk", columns)
        quoted_path = str(path).replace("'", "''")
        database.execute(
            "COPY (SELECT board, sensor, version, file, "  # noqa: S608 - ours
            f"list_filter([{dominated_names}], name -> name IS NOT NULL) "
            f"AS prior_dominated, {numbers} "
            f"FROM shrunk) TO '{quoted_path}' "
            "(FORMAT parquet, COMPRESSION zstd)"
        )
