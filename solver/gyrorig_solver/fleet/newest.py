"""The newest calibration of every board, as the index tells it, and where boards come from.

What to use when: `newest_of` for columns of one length, one entry a board. Newest is what was
measured last: a backlog that is solved after the nights that followed it makes no board old.
Where a board was made and where a rig stands no recording says: that comes from a table of the
fleet's owner (`Origins`).
"""

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import duckdb
import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.rows import NEWEST_FIRST, parameter_columns

Kind = Literal["rig", "lot", "site"]
KINDS: tuple[Kind, ...] = ("rig", "lot", "site")
PARAMETERS = tuple(name for name in parameter_columns() if not name.endswith("_std"))
MAX_TABLE_BYTES = 200_000_000
_WORDS = ("sensor", "rig", "trust", "findings", "file")


@dataclass(frozen=True, slots=True)
class Origins:
    """Which lot a board is of and where it is, by the fleet's owner."""

    lot: dict[str, str] = field(default_factory=dict)
    site: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Newest:
    """The newest calibration of every board, as columns of one length."""

    board: list[str]
    sensor: list[str]
    rig: list[str]
    lot: list[str]
    site: list[str]
    trust: list[str]
    findings: list[str]
    file: list[str]
    version: list[int]
    versions: list[int]
    start_s: FloatArray
    chi2: FloatArray
    temperature_c: FloatArray
    skew_ppm: FloatArray  # of the board's clock against its host's
    count_rad_s: FloatArray  # what a count is worth
    value: dict[str, FloatArray]
    std: dict[str, FloatArray]

    def group(self, kind: str) -> list[str]:
        """Return the boards' rigs, lots or sites, "" where unknown; or one for the fleet."""
        if kind == "fleet":
            return ["all"] * len(self.board)
        return {"rig": self.rig, "lot": self.lot, "site": self.site}[kind]

    def known(self, name: str) -> BoolArray:
        """Return which boards have a value of a parameter."""
        there: BoolArray = np.isfinite(self.value[name]) & (self.std[name] > 0.0)
        return there


def read_origins(path: Path) -> Origins:
    """Return the lots and sites of boards from a table with the columns board, lot, site.

    Raises:
        UsageError: there is no such file.
        InputError: it is no such table.
    """
    try:
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise InputError(
                f"{path} is larger than {MAX_TABLE_BYTES >> 20} MB, and no table of boards is",
                "name a table with the columns board, lot, site",
            )
        text = path.read_text(encoding="utf-8-sig")
    except OSError as fault:
        raise UsageError(
            f"{path} cannot be read, {fault.strerror}",
            "name a table with the columns board, lot, site",
        ) from fault
    except UnicodeDecodeError as fault:
        raise InputError(f"{path} is no text in UTF-8", "save it as UTF-8") from fault
    rows = csv.DictReader(text.splitlines())
    if rows.fieldnames is None or "board" not in rows.fieldnames:
        raise InputError(f"{path} has no column board", "begin it with the line: board,lot,site")
    found = Origins()
    for row in rows:
        board = BoardId(row["board"] or "")
        found.lot[board] = (row.get("lot") or "")[:64]
        found.site[board] = (row.get("site") or "")[:64]
    return found


def newest_of(index: Index, origins: Origins) -> Newest:
    """Return the newest calibration of every board.

    Raises:
        InputError: the index is damaged.
    """
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETERS)
    sql = (
        "SELECT board, sensor, rig, trust, findings, file, version, "  # noqa: S608 - ours
        "count(*) OVER (PARTITION BY board) AS versions, epoch(start) AS start_s, "
        "reduced_chi2, temperature_degc, clock_skew_ppm, gyro_scale_rad_s, "
        f"{columns} FROM rows WHERE status = 'ok' "
        f"QUALIFY row_number() OVER (PARTITION BY board ORDER BY {NEWEST_FIRST}) = 1 "
        "ORDER BY board"
    )
    found = columns_of(index, sql)
    board = [str(one) for one in found["board"]]
    return Newest(
        board=board,
        lot=[origins.lot.get(one, "") for one in board],
        site=[origins.site.get(one, "") for one in board],
        **{name: [str(one or "") for one in found[name]] for name in _WORDS},
        version=[int(one) for one in found["version"]],
        versions=[int(one) for one in found["versions"]],
        start_s=numbers_of(found["start_s"]),
        chi2=numbers_of(found["reduced_chi2"]),
        temperature_c=numbers_of(found["temperature_degc"]),
        skew_ppm=numbers_of(found["clock_skew_ppm"]),
        count_rad_s=numbers_of(found["gyro_scale_rad_s"]),
        value={name: numbers_of(found[name]) for name in PARAMETERS},
        std={name: numbers_of(found[f"{name}_std"]) for name in PARAMETERS},
    )


def columns_of(index: Index, sql: str) -> dict[str, npt.NDArray[Any]]:
    """Return the answer to a question as columns: millions of rows as objects take gigabytes.

    Raises:
        InputError: as `Index.ask`.
    """
    with index.connect() as database:
        try:
            found: dict[str, npt.NDArray[Any]] = database.execute(sql).fetchnumpy()
        except duckdb.Error as fault:
            raise InputError(
                f"the index cannot be read, {' '.join(str(fault).split())[:200]}",
                "`gyrorig store rebuild-index STORE` makes it anew from the calibrations",
            ) from fault
    return found


def numbers_of(column: npt.NDArray[Any]) -> FloatArray:
    """Return a column as numbers, NaN where it is NULL."""
    return np.ma.filled(np.ma.asarray(column, dtype=np.float64), np.nan)
