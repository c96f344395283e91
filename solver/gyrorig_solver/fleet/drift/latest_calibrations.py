"""Latest calibrations of all boards, from the index, with lots and sites from a table.

What to use when: `latest_calibrations` for columns with one entry per board. Latest is what was
recorded last: solving a backlog later does not make older recordings the latest. Recordings do not
contain the lot of a board or the site of a rig; these come from a table of the fleet's owner
(`BoardOrigins`).
"""

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.fleet.store import NEWEST_FIRST_SQL, StoreIndex, parameter_columns

GroupKind = Literal["rig", "lot", "site"]
GROUP_KINDS: tuple[GroupKind, ...] = ("rig", "lot", "site")
PARAMETER_COLUMNS = tuple(name for name in parameter_columns() if not name.endswith("_std"))
MAX_TABLE_BYTES = 200_000_000
_TEXT_COLUMNS = ("sensor", "rig", "trust", "findings", "file")


@dataclass(frozen=True, slots=True)
class BoardOrigins:
    """Lots and sites of boards, from the table of the fleet's owner."""

    lot: dict[str, str] = field(default_factory=dict)
    site: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class LatestCalibrations:
    """The latest calibration of every board, as columns of equal length."""

    board: list[str]
    sensor: list[str]
    rig: list[str]
    lot: list[str]
    site: list[str]
    trust: list[str]
    findings: list[str]
    file: list[str]
    version: list[int]
    version_count: list[int]
    start_s: FloatArray
    reduced_chi2: FloatArray
    temperature_c: FloatArray
    clock_skew_ppm: FloatArray  # of the board's clock relative to its host's
    count_size_rad_s: FloatArray  # the rate of one count
    value: dict[str, FloatArray]
    std: dict[str, FloatArray]

    def group_names(self, kind: str) -> list[str]:
        """Return the boards' rigs, lots or sites, "" if unknown; "all" for the fleet."""
        if kind == "fleet":
            return ["all"] * len(self.board)
        return {"rig": self.rig, "lot": self.lot, "site": self.site}[kind]

    @property
    def is_refused(self) -> BoolArray:
        """Boards whose calibration has the verdict `refused`; no statistic uses its values."""
        return np.array([trust == "refused" for trust in self.trust], dtype=np.bool_)

    def has_value(self, name: str) -> BoolArray:
        """Return which boards have a value of a parameter that is not refused."""
        return np.isfinite(self.value[name]) & (self.std[name] > 0.0) & ~self.is_refused


def read_origins(path: Path) -> BoardOrigins:
    """Return the lots and sites of boards from a table with the columns board, lot, site.

    Raises:
        UsageError: the file cannot be read.
        InputError: the file is not such a table.
    """
    try:
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise InputError(
                f"the file {path} is too large for a table of boards (more than "
                f"{MAX_TABLE_BYTES >> 20} MB)",
                "give a table (CSV) with the columns board, lot and site",
            )
        text = path.read_text(encoding="utf-8-sig")
    except OSError as fault:
        raise UsageError(
            f"the table of boards {path} cannot be read ({fault.strerror})",
            "give a table (CSV) with the columns board, lot and site",
        ) from fault
    except UnicodeDecodeError as fault:
        raise InputError(
            f"the table of boards {path} is not a text in UTF-8", "save the table as UTF-8"
        ) from fault
    lines = csv.reader(text.splitlines())
    try:
        names = [name.strip() for name in next(lines, [])]
        rows = [
            (lines.line_num, dict(zip(names, map(str.strip, cells), strict=False)))
            for cells in lines
            if any(map(str.strip, cells))
        ]
    except csv.Error as fault:
        raise InputError(
            f"the table of boards {path} cannot be read ({fault})",
            "give a table (CSV) with the columns board, lot and site",
        ) from fault
    if "board" not in names:
        raise InputError(
            f"the table of boards {path} has no column `board`",
            "begin the table with the header line board,lot,site",
        )
    origins = BoardOrigins()
    for number, row in rows:
        try:
            board = BoardId(row.get("board", ""))
        except InputError as fault:
            raise InputError(
                f"line {number} of the table of boards {path} has {row.get('board', '')[:40]!r} in "
                "the column board, which is not a valid board name",
                "correct the name, or remove the line",
            ) from fault
        origins.lot[board] = row.get("lot", "")[:64]
        origins.site[board] = row.get("site", "")[:64]
    return origins


def latest_calibrations(index: StoreIndex, origins: BoardOrigins) -> LatestCalibrations:
    """Return the latest calibration of every board.

    Raises:
        InputError: the index is damaged.
    """
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETER_COLUMNS)
    sql = (
        "SELECT board, sensor, rig, trust, findings, file, version, "  # noqa: S608 - ours
        "count(*) OVER (PARTITION BY board) AS versions, epoch(start) AS start_s, "
        "reduced_chi2, temperature_degc, clock_skew_ppm, gyro_scale_rad_s, "
        f"{columns} FROM rows WHERE status = 'ok' "
        f"QUALIFY row_number() OVER (PARTITION BY board ORDER BY {NEWEST_FIRST_SQL}) = 1 "
        "ORDER BY board"
    )
    answer = index.query_columns(sql)
    boards = [str(board) for board in answer["board"]]
    return LatestCalibrations(
        board=boards,
        lot=[origins.lot.get(board, "") for board in boards],
        site=[origins.site.get(board, "") for board in boards],
        **{name: [str(text or "") for text in answer[name]] for name in _TEXT_COLUMNS},
        version=answer["version"].astype(int).tolist(),
        version_count=answer["versions"].astype(int).tolist(),
        start_s=float_column(answer["start_s"]),
        reduced_chi2=float_column(answer["reduced_chi2"]),
        temperature_c=float_column(answer["temperature_degc"]),
        clock_skew_ppm=float_column(answer["clock_skew_ppm"]),
        count_size_rad_s=float_column(answer["gyro_scale_rad_s"]),
        value={name: float_column(answer[name]) for name in PARAMETER_COLUMNS},
        std={name: float_column(answer[f"{name}_std"]) for name in PARAMETER_COLUMNS},
    )


def float_column(column: npt.NDArray[Any]) -> FloatArray:
    """Return a column as floats, NaN for NULL."""
    return np.ma.filled(np.ma.asarray(column, dtype=np.float64), np.nan)
