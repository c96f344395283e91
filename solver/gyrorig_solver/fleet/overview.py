"""A fleet as its index tells it: kinds of boards, groups that differ, what has moved.

What to use when: `overview` for everything that the fleet's page and `gyrorig fleet` say.
It reads the index alone; no calibration is opened. Where a board was made and where a rig
stands no recording says: that comes from a table of the fleet's owner (`Origins`).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.fleet.charts import (
    Chart,
    Grouping,
    GroupMove,
    IntArray,
    Moved,
    Nights,
    chart,
    discoveries,
    what_moved,
)
from gyrorig_solver.fleet.comparing import compared
from gyrorig_solver.fleet.constants import Constancy
from gyrorig_solver.fleet.groups import Group, groups_of, latest_ends
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.ledger import index_at
from gyrorig_solver.fleet.newest import (
    KINDS,
    PARAMETERS,
    Kind,
    Newest,
    Origins,
    columns_of,
    newest_of,
    numbers_of,
    read_origins,
)
from gyrorig_solver.fleet.population import Between, Population, mahalanobis
from gyrorig_solver.fleet.rows import NEWEST_FIRST
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.place import Place

__all__ = ["KINDS", "PARAMETERS", "Newest", "Origins", "Overview", "overview", "read_origins"]

ODD_RATE = 0.01  # of the boards called odd, false ones


@dataclass(frozen=True, slots=True, eq=False)
class Overview:
    """What there is to say of a fleet."""

    boards: Newest
    populations: dict[tuple[str, str], Population]  # (sensor, parameter)
    constants: list[Constancy]  # what is the same on every unit, and what is not
    groups: list[Group]  # lots, rigs and sites, by kind, sensor and name
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
    charts: list[Chart]  # one a parameter; none where nothing was measured
    days: IntArray  # (nights,), since 1970


def overview(store: Path | Place, origins: Origins | None = None) -> Overview:
    """Return what there is to say of a fleet.

    Raises:
        InputError: the index is damaged.
    """
    index = index_at(place_at(store))
    boards = newest_of(index, origins or Origins())
    populations, constants, differing = compared(boards)
    charts, days = _charts(index, boards)
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
        groups=groups_of(boards, populations, latest_ends(index, boards)),
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
        nights=len(days),
        charts=charts,
        days=days,
    )


def _charts(index: Index, boards: Newest) -> tuple[list[Chart], IntArray]:
    """Return the drift chart of every parameter over the nights of the index, and their days."""
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETERS)
    sql = (
        "SELECT board, date_diff('day', DATE '1970-01-01', start::DATE) AS day, "  # noqa: S608
        f"temperature_degc, {columns} FROM rows WHERE status = 'ok' AND start IS NOT NULL "
        f"QUALIFY row_number() OVER (PARTITION BY board, start::DATE ORDER BY {NEWEST_FIRST}) = 1"
    )
    found = columns_of(index, sql)
    if not found["board"].size:
        return [], np.zeros(0, dtype=np.intp)
    number = {name: at for at, name in enumerate(boards.board)}
    board = np.array([number[name] for name in found["board"]])
    days, night = np.unique(np.asarray(found["day"]), return_inverse=True)
    shape = (len(days), len(boards.board))

    def laid(name: str) -> FloatArray:
        table = np.full(shape, np.nan)
        table[night, board] = numbers_of(found[name])
        return table

    temperature = laid("temperature_degc")
    _, kind = np.unique(np.array(boards.sensor), return_inverse=True)
    charts: list[Chart] = []
    for name in PARAMETERS:
        value, variance = laid(name), laid(f"{name}_std") ** 2
        value[~(variance > 0.0)] = np.nan
        charts.append(chart(Nights(name, value, variance, temperature, kind)))
    return charts, days.astype(np.intp)


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
        here = boards.known(name) & (sensors == sensor)
        table[here, PARAMETERS.index(name)] = getattr(found, what)
    return table
