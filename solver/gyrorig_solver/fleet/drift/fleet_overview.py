"""Fleet overview: populations, differing groups, drift and outliers, from the index of a store.

What to use when: `build_overview` for everything that `gyrorig fleet` and its page show. It reads
the index only; no calibration is opened. Lots and sites come from a table of the fleet's owner
(`BoardOrigins`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.fleet.drift.board_outliers import outlier_p_values
from gyrorig_solver.fleet.drift.common_offsets import OffsetComparison, compare_offsets
from gyrorig_solver.fleet.drift.ewma_charts import (
    DriftChart,
    DriftResult,
    Grouping,
    GroupShift,
    IntArray,
    ParameterHistory,
    benjamini_hochberg,
    detect_drift,
    ewma_chart,
)
from gyrorig_solver.fleet.drift.group_statistics import BoardGroup, board_groups, latest_outcomes
from gyrorig_solver.fleet.drift.latest_calibrations import (
    GROUP_KINDS,
    PARAMETER_COLUMNS,
    BoardOrigins,
    GroupKind,
    LatestCalibrations,
    float_column,
    latest_calibrations,
    read_origins,
)
from gyrorig_solver.fleet.drift.population import (
    MIN_BOARDS,
    GroupDifference,
    Population,
    cochran_q_test,
    fit_population,
)
from gyrorig_solver.fleet.store import NEWEST_FIRST_SQL, UNSUCCESSFUL_ROWS_SQL, StoreIndex
from gyrorig_solver.storage import Storage

__all__ = [
    "GROUP_KINDS",
    "PARAMETER_COLUMNS",
    "BoardOrigins",
    "FleetOverview",
    "LatestCalibrations",
    "build_overview",
    "read_origins",
]

# One false alarm in a thousand nights, over all parameters, sensors and kinds of groups.
GROUP_DIFFERENCE_FALSE_ALARM_RATE = 1e-3
OUTLIER_FALSE_DISCOVERY_RATE = 0.01  # share of false ones among the outliers


@dataclass(frozen=True, slots=True, eq=False)
class FleetOverview:
    """All statistics of a fleet."""

    boards: LatestCalibrations
    populations: dict[tuple[str, str], Population]  # (sensor, parameter)
    offset_comparisons: list[OffsetComparison]  # errors common to all units or not
    groups: list[BoardGroup]  # lots, rigs and sites, by kind, sensor and name
    # (sensor, kind of group, difference)
    group_differences: list[tuple[str, GroupKind, GroupDifference]]
    group_shifts: list[GroupShift]
    drifting: BoolArray  # (boards, parameters)
    drift_z: FloatArray  # (boards, parameters)
    is_outlier: BoolArray  # (boards,)
    outlier_p_value: FloatArray  # (boards,)
    prior_dominated: BoolArray  # (boards, parameters)
    shrunk: FloatArray  # (boards, parameters), NaN where there is none
    shrunk_std: FloatArray
    unsuccessful: list[tuple[str, int]]  # statuses of sessions without a calibration, and counts
    nights: int
    charts: list[DriftChart]  # one per parameter; none without recordings
    night_days: IntArray  # (nights,), since 1970


def build_overview(store: Path | Storage, origins: BoardOrigins | None = None) -> FleetOverview:
    """Return all statistics of a fleet.

    Raises:
        InputError: the index is damaged.
    """
    index = StoreIndex(store)
    boards = latest_calibrations(index, origins or BoardOrigins())
    populations, offset_comparisons, group_differences = compare_groups(boards)
    charts, night_days = _drift_charts(index, boards)
    groupings = [
        Grouping.by_name(kind, boards.group_names(kind)) for kind in ("rig", "lot", "site", "fleet")
    ]
    shape = (len(boards.board), len(PARAMETER_COLUMNS))
    drift = DriftResult([], np.zeros(shape, dtype=np.bool_), np.zeros(shape))
    if charts:
        drift = detect_drift(charts, groupings)
    outlier_p_value = _outlier_p_values(boards, populations)
    return FleetOverview(
        boards=boards,
        populations=populations,
        offset_comparisons=offset_comparisons,
        groups=board_groups(boards, populations, latest_outcomes(index, boards)),
        group_differences=sorted(group_differences, key=lambda difference: difference[2].p_value),
        group_shifts=drift.group_shifts,
        drifting=drift.drifting,
        drift_z=drift.z,
        is_outlier=benjamini_hochberg(outlier_p_value, OUTLIER_FALSE_DISCOVERY_RATE),
        outlier_p_value=outlier_p_value,
        prior_dominated=_population_table(boards, populations, "prior_dominated", fill=0.0) > 0.5,
        shrunk=_population_table(boards, populations, "shrunk"),
        shrunk_std=_population_table(boards, populations, "shrunk_std"),
        unsuccessful=_unsuccessful_sessions(index),
        nights=len(night_days),
        charts=charts,
        night_days=night_days,
    )


def compare_groups(
    boards: LatestCalibrations,
) -> tuple[
    dict[tuple[str, str], Population],
    list[OffsetComparison],
    list[tuple[str, GroupKind, GroupDifference]],
]:
    """Estimate the populations of each sensor, and test whether groups of boards differ.

    Returns:
        Populations by sensor and parameter; common offsets; and significant differences between
        groups as (sensor, kind of group, difference).
    """
    populations: dict[tuple[str, str], Population] = {}
    tests: list[tuple[str, GroupKind, GroupDifference]] = []
    sensors = np.array(boards.sensor)
    for sensor in sorted(set(boards.sensor)):
        for name in PARAMETER_COLUMNS:
            in_population = boards.has_value(name) & (sensors == sensor)
            if in_population.sum() < MIN_BOARDS:
                continue
            value, std = boards.value[name][in_population], boards.std[name][in_population]
            fitted = populations[sensor, name] = fit_population(name, value, std)
            tests += [
                (sensor, kind, difference)
                for kind, difference in _group_differences(boards, fitted, in_population)
            ]
    p_limit = GROUP_DIFFERENCE_FALSE_ALARM_RATE / max(len(tests), 1)
    differing = [test for test in tests if test[2].p_value < p_limit]
    return populations, compare_offsets(boards, populations), differing


def _group_differences(
    boards: LatestCalibrations, fitted: Population, in_population: BoolArray
) -> Iterator[tuple[GroupKind, GroupDifference]]:
    """Yield the differences between groups in one parameter, the most significant kind first.

    Lots and rigs can coincide. The largest difference of the first kind is subtracted before the
    next kind is tested; otherwise the rigs of a bad lot would be reported as well.
    """
    value = boards.value[fitted.parameter][in_population].copy()
    std = boards.std[fitted.parameter][in_population]
    groups = {kind: list(compress(boards.group_names(kind), in_population)) for kind in GROUP_KINDS}
    while groups:
        known = {
            kind: difference
            for kind, names in groups.items()
            if (difference := cochran_q_test(fitted, value, std, names)) is not None
        }
        if not known:
            return
        kind = min(known, key=lambda kind: known[kind].p_value)
        yield kind, known[kind]
        in_group = np.array([name == known[kind].extreme_group for name in groups.pop(kind)])
        value[in_group] -= known[kind].extreme_offset


def _unsuccessful_sessions(index: StoreIndex) -> list[tuple[str, int]]:
    """Return the statuses of sessions without a calibration, and their counts."""
    sql = (
        f"SELECT status, count(DISTINCT key) FROM {UNSUCCESSFUL_ROWS_SQL} "  # noqa: S608
        "GROUP BY 1 ORDER BY 1"
    )
    return [(str(status), int(count)) for status, count in index.query(sql)]


def _drift_charts(
    index: StoreIndex, boards: LatestCalibrations
) -> tuple[list[DriftChart], IntArray]:
    """Return the drift chart of every parameter, and the days of the nights.

    A chart has the nights with the configuration of the board's last recording only, because
    another bandwidth or range changes the parameters. Boards that a batch has added since `boards`
    was read are left out.
    """
    columns = ", ".join(f"{name}, {name}_std" for name in PARAMETER_COLUMNS)
    sql = (
        "SELECT board, date_diff('day', DATE '1970-01-01', start::DATE) AS day, "  # noqa: S608
        f"temperature_degc, {columns} FROM rows WHERE status = 'ok' AND start IS NOT NULL "
        "AND trust IS DISTINCT FROM 'refused' "
        "QUALIFY row_number() OVER "
        f"(PARTITION BY board, start::DATE ORDER BY {NEWEST_FIRST_SQL}) = 1 "
        "AND config_hash IS NOT DISTINCT FROM "
        f"first_value(config_hash) OVER (PARTITION BY board ORDER BY {NEWEST_FIRST_SQL})"
    )
    answer = index.query_columns(sql)
    number = {name: position for position, name in enumerate(boards.board)}
    board = np.array([number.get(name, -1) for name in answer["board"]], dtype=np.intp)
    answer = {name: column[board >= 0] for name, column in answer.items()}
    board = board[board >= 0]
    if not board.size:
        return [], np.zeros(0, dtype=np.intp)
    days, night = np.unique(np.asarray(answer["day"]), return_inverse=True)
    shape = (len(days), len(boards.board))

    def nightly_table(name: str) -> FloatArray:
        table = np.full(shape, np.nan)
        table[night, board] = float_column(answer[name])
        return table

    temperature = nightly_table("temperature_degc")
    _, kind = np.unique(np.array(boards.sensor), return_inverse=True)
    charts: list[DriftChart] = []
    for name in PARAMETER_COLUMNS:
        value, variance = nightly_table(name), nightly_table(f"{name}_std") ** 2
        value[~(variance > 0.0)] = np.nan
        charts.append(ewma_chart(ParameterHistory(name, value, variance, temperature, kind)))
    return charts, days.astype(np.intp)


def _outlier_p_values(
    boards: LatestCalibrations, populations: dict[tuple[str, str], Population]
) -> FloatArray:
    """Return the p value of each board as an outlier among the boards of its sensor."""
    z = _population_table(boards, populations, "z")
    p_values = np.full(len(boards.board), np.nan)
    sensors = np.array(boards.sensor)
    for sensor in {sensor for sensor, _ in populations}:
        of_sensor = (sensors == sensor) & np.isfinite(z).any(axis=1)
        p_values[of_sensor] = outlier_p_values(z[of_sensor])
    return p_values


def _population_table(
    boards: LatestCalibrations,
    populations: dict[tuple[str, str], Population],
    attribute: str,
    fill: float = np.nan,
) -> FloatArray:
    """Return a field of the populations as a table, (boards, parameters)."""
    table = np.full((len(boards.board), len(PARAMETER_COLUMNS)), fill)
    sensors = np.array(boards.sensor)
    for (sensor, name), fitted in populations.items():
        selected = boards.has_value(name) & (sensors == sensor)
        table[selected, PARAMETER_COLUMNS.index(name)] = getattr(fitted, attribute)
    return table
