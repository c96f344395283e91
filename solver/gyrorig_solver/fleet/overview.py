"""A fleet as its index tells it: kinds of boards, groups that differ, what has moved.

What to use when: `overview` for everything that the fleet's page and `gyrorig fleet` say.
It reads the index alone; no calibration is opened. Where a board was made and where a rig
stands no recording says: that comes from a table of the fleet's owner (`Origins`).
"""

import csv
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import duckdb
import numpy as np
import numpy.typing as npt

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.fleet.charts import (
    Chart,
    Grouping,
    GroupMove,
    Moved,
    Nights,
    chart,
    discoveries,
    what_moved,
)
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.ledger import index_at
from gyrorig_solver.fleet.population import (
    LEAST_BOARDS,
    Between,
    CommonConstant,
    Population,
    between,
    common_constant,
    mahalanobis,
    population,
)
from gyrorig_solver.fleet.rows import parameter_columns
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.place import Place

Kind = Literal["rig", "lot", "site"]
_WORDS = ("sensor", "rig", "trust", "findings", "file")
KINDS: tuple[Kind, ...] = ("rig", "lot", "site")
PARAMETERS = tuple(name for name in parameter_columns() if not name.endswith("_std"))
# What a perfect board on a perfect rig has; a bias and a lag are nobody's constant.
NOMINAL = {
    name: 1.0 if name.startswith("scale") else 0.0
    for name in PARAMETERS
    if name.startswith(("scale", "nonorthogonality", "misalignment"))
}
BETWEEN_ALPHA = (
    1e-3  # one false alarm in a thousand nights, over all parameters, sensors and kinds of groups
)
ODD_RATE = 0.01  # of the boards called odd, false ones
MAX_TABLE_BYTES = 200_000_000


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
    value: dict[str, FloatArray]
    std: dict[str, FloatArray]

    def group(self, kind: str) -> list[str]:
        """Return the boards' rigs, lots or sites, "" where unknown; or one for the fleet."""
        if kind == "fleet":
            return ["all"] * len(self.board)
        return {"rig": self.rig, "lot": self.lot, "site": self.site}[kind]


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """What there is to say of a fleet."""

    boards: Newest
    populations: dict[tuple[str, str], Population]  # (sensor, parameter)
    constants: list[tuple[str, CommonConstant]]  # of a sensor, those that are common
    differing: list[tuple[str, Kind, Between]]  # (sensor, kind of group, what differs)
    moved: list[GroupMove]
    drifting: npt.NDArray[np.bool_]  # (boards, parameters)
    drift_z: FloatArray  # (boards, parameters)
    odd: npt.NDArray[np.bool_]  # (boards,)
    odd_p: FloatArray  # (boards,)
    prior_dominated: npt.NDArray[np.bool_]  # (boards, parameters)
    shrunk: FloatArray  # (boards, parameters), NaN where there is none
    shrunk_std: FloatArray
    wrong: list[tuple[str, int]]  # statuses of work without a calibration
    nights: int


def read_origins(path: Path) -> Origins:
    """Return the lots and sites of boards from a table with the columns board, lot, site.

    Raises:
        UsageError: there is no such file.
        InputError: it is no such table.
    """
    try:
        if path.stat().st_size > MAX_TABLE_BYTES:
            raise InputError(f"{path} is larger than a table of boards", "name another")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as fault:
        raise UsageError(f"{path} cannot be read, {fault.strerror}", "name a table") from fault
    except UnicodeDecodeError as fault:
        raise InputError(f"{path} is no text in UTF-8", "save it so") from fault
    rows = csv.DictReader(text.splitlines())
    if rows.fieldnames is None or "board" not in rows.fieldnames:
        raise InputError(f"{path} has no column board", "begin it with the line: board,lot,site")
    found = Origins()
    for row in rows:
        board = BoardId(row["board"] or "")
        found.lot[board] = (row.get("lot") or "")[:64]
        found.site[board] = (row.get("site") or "")[:64]
    return found


def overview(store: Path | Place, origins: Origins | None = None) -> Overview:
    """Return what there is to say of a fleet.

    Raises:
        InputError: the index is damaged.
    """
    index = index_at(place_at(store))
    boards = _newest(index, origins or Origins())
    populations, constants, differing = compared(boards)
    charts, nights = _charts(index, boards)
    groupings = [Grouping.by_name(k, boards.group(k)) for k in ("rig", "lot", "site", "fleet")]
    shape = (len(boards.board), len(PARAMETERS))
    moved = Moved([], np.zeros(shape, dtype=np.bool_), np.zeros(shape))
    if charts:
        moved = what_moved(charts, groupings)
    odd_p = _odd(boards, populations)
    return Overview(
        boards=boards,
        populations=populations,
        constants=constants,
        differing=sorted(differing, key=lambda one: one[2].p_value),
        moved=moved.groups,
        drifting=moved.drifting,
        drift_z=moved.z,
        odd=discoveries(odd_p, ODD_RATE),
        odd_p=odd_p,
        prior_dominated=_of_boards(boards, populations, "prior_dominated", fill=0.0) > 0.5,
        shrunk=_of_boards(boards, populations, "shrunk"),
        shrunk_std=_of_boards(boards, populations, "shrunk_std"),
        wrong=[
            (str(status), int(n))
            for status, n in index.ask(
                "SELECT status, count(*) FROM rows WHERE status <> 'ok' GROUP BY 1 ORDER BY 1"
            )
        ],
        nights=nights,
    )


def _newest(index: Index, origins: Origins) -> Newest:
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETERS)
    sql = (
        "SELECT board, sensor, rig, trust, findings, file, version, "  # noqa: S608 - ours
        "count(*) OVER (PARTITION BY board) AS versions, epoch(start) AS start_s, "
        "reduced_chi2, temperature_degc, "
        f"{columns} FROM rows WHERE status = 'ok' "
        "QUALIFY row_number() OVER (PARTITION BY board ORDER BY version DESC) = 1 ORDER BY board"
    )
    found = _columns(index, sql)
    board = [str(one) for one in found["board"]]
    return Newest(
        board=board,
        lot=[origins.lot.get(one, "") for one in board],
        site=[origins.site.get(one, "") for one in board],
        **{name: [str(one or "") for one in found[name]] for name in _WORDS},
        version=[int(one) for one in found["version"]],
        versions=[int(one) for one in found["versions"]],
        start_s=_numbers(found["start_s"]),
        chi2=_numbers(found["reduced_chi2"]),
        temperature_c=_numbers(found["temperature_degc"]),
        value={name: _numbers(found[name]) for name in PARAMETERS},
        std={name: _numbers(found[f"{name}_std"]) for name in PARAMETERS},
    )


def _columns(index: Index, sql: str) -> dict[str, npt.NDArray[Any]]:
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
                "`gyrorig store rebuild-index` makes it anew from the calibrations",
            ) from fault
    return found


def _numbers(column: npt.NDArray[Any]) -> FloatArray:
    """Return a column as numbers, NaN where it is NULL."""
    return np.ma.filled(np.ma.asarray(column, dtype=np.float64), np.nan)


def compared(
    boards: Newest,
) -> tuple[
    dict[tuple[str, str], Population],
    list[tuple[str, CommonConstant]],
    list[tuple[str, Kind, Between]],
]:
    """Ask each kind of sensor what its boards are like, and whether groups of them differ."""
    populations: dict[tuple[str, str], Population] = {}
    constants: list[tuple[str, CommonConstant]] = []
    asked: list[tuple[str, Kind, Between]] = []
    sensors = np.array(boards.sensor)
    for sensor in sorted(set(boards.sensor)):
        for name in PARAMETERS:
            here = _known(boards, name) & (sensors == sensor)
            if here.sum() < LEAST_BOARDS:
                continue
            value, std = boards.value[name][here], boards.std[name][here]
            found = populations[sensor, name] = population(name, value, std)
            if name in NOMINAL and (common := common_constant(found, NOMINAL[name])).is_common:
                constants.append((sensor, common))
            asked += [(sensor, kind, told) for kind, told in _differences(boards, found, here)]
    limit = BETWEEN_ALPHA / max(len(asked), 1)
    return populations, constants, [one for one in asked if one[2].p_value < limit]


def _differences(
    boards: Newest, found: Population, here: npt.NDArray[np.bool_]
) -> Iterator[tuple[Kind, Between]]:
    """Yield how groups differ in one parameter, the kind that tells most first.

    Lots and rigs may go together; what the first has told is taken off before the next is
    asked, or the bad lot's rigs would be called bad as well.
    """
    value, std = boards.value[found.parameter][here].copy(), boards.std[found.parameter][here]
    groups = {
        kind: [g for g, yes in zip(boards.group(kind), here, strict=True) if yes] for kind in KINDS
    }
    while groups:
        told = {kind: between(found, value, std, group) for kind, group in groups.items()}
        known = {kind: one for kind, one in told.items() if one is not None}
        if not known:
            return
        kind = min(known, key=lambda kind: known[kind].p_value)
        yield kind, known[kind]
        at = np.array([name == known[kind].most for name in groups.pop(kind)])
        value[at] -= known[kind].most_by


def _charts(index: Index, boards: Newest) -> tuple[list[Chart], int]:
    """Return the drift chart of every parameter over the nights of the index."""
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETERS)
    sql = (
        "SELECT board, date_diff('day', DATE '1970-01-01', start::DATE) AS day, "  # noqa: S608
        f"temperature_degc, {columns} FROM rows WHERE status = 'ok' AND start IS NOT NULL "
        "QUALIFY row_number() OVER (PARTITION BY board, start::DATE ORDER BY version DESC) = 1"
    )
    found = _columns(index, sql)
    if not found["board"].size:
        return [], 0
    number = {name: at for at, name in enumerate(boards.board)}
    board = np.array([number[name] for name in found["board"]])
    days, night = np.unique(np.asarray(found["day"]), return_inverse=True)
    shape = (len(days), len(boards.board))

    def laid(name: str) -> FloatArray:
        table = np.full(shape, np.nan)
        table[night, board] = _numbers(found[name])
        return table

    temperature = laid("temperature_degc")
    charts: list[Chart] = []
    for name in PARAMETERS:
        value, variance = laid(name), laid(f"{name}_std") ** 2
        value[~(variance > 0.0)] = np.nan
        charts.append(chart(Nights(name, value, variance, temperature)))
    return charts, len(days)


def _odd(boards: Newest, populations: dict[tuple[str, str], Population]) -> FloatArray:
    """Return how likely chance makes a board so unlike the others of its kind."""
    z = _of_boards(boards, populations, "z")
    odd = np.full(len(boards.board), np.nan)
    sensors = np.array(boards.sensor)
    for sensor in {sensor for sensor, _ in populations}:
        here = (sensors == sensor) & np.isfinite(z).any(axis=1)
        odd[here] = mahalanobis(z[here])
    return odd


def _of_boards(
    boards: Newest,
    populations: dict[tuple[str, str], Population],
    what: str,
    fill: float = np.nan,
) -> FloatArray:
    """Return an array of the populations as boards by parameters."""
    table = np.full((len(boards.board), len(PARAMETERS)), fill)
    sensors = np.array(boards.sensor)
    for (sensor, name), found in populations.items():
        here = _known(boards, name) & (sensors == sensor)
        table[here, PARAMETERS.index(name)] = getattr(found, what)
    return table


def _known(boards: Newest, name: str) -> npt.NDArray[np.bool_]:
    known: npt.NDArray[np.bool_] = np.isfinite(boards.value[name]) & (boards.std[name] > 0.0)
    return known
