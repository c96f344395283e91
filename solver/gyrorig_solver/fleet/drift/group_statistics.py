"""Statistics of rigs, lots and sites: mean and spread of each group, per parameter.

What to use when: `board_groups` for the list that `gyrorig fleet --json` and its page show. Mean
and spread of a group use its own boards only; its difference to the other groups of its kind is
in standard deviations (`population.group_means`).
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gyrorig_solver.fleet.drift.latest_calibrations import (
    GROUP_KINDS,
    GroupKind,
    LatestCalibrations,
)
from gyrorig_solver.fleet.drift.population import MIN_BOARDS, Population, fit_spread, group_means
from gyrorig_solver.fleet.store import StoreIndex


@dataclass(frozen=True, slots=True)
class GroupStatistics:
    """Statistics of one parameter over the boards of a group, in its unit."""

    mean: float
    mean_std: float
    spread: float  # standard deviation between its boards
    count: int  # boards with a value
    z: float | None  # normal score of the difference to all others; None without another


@dataclass(frozen=True, slots=True)
class BoardGroup:
    """The boards of one sensor in one lot, or on one rig or site."""

    kind: GroupKind
    name: str
    sensor: str
    boards: int
    states: dict[str, int]  # latest status of its boards: ok, rejected, ...
    parameters: dict[str, GroupStatistics]


def board_groups(
    boards: LatestCalibrations, populations: dict[tuple[str, str], Population], states: list[str]
) -> list[BoardGroup]:
    """Return every group of at least `MIN_BOARDS` boards, by kind, sensor and name."""
    sensors, states_of_boards = np.array(boards.sensor), np.array(states)
    groups: list[BoardGroup] = []
    for kind in GROUP_KINDS:
        names = np.array(boards.group_names(kind))
        for sensor in sorted(set(boards.sensor)):
            of_sensor = (sensors == sensor) & (names != "")
            statistics = _statistics_by_group(boards, populations, sensor, names, of_sensor)
            for name, count in zip(*np.unique(names[of_sensor], return_counts=True), strict=True):
                if count < MIN_BOARDS:
                    continue
                ended = states_of_boards[of_sensor & (names == name)]
                groups.append(
                    BoardGroup(
                        kind=kind,
                        name=str(name),
                        sensor=sensor,
                        boards=int(count),
                        states=dict(sorted(Counter(ended.tolist()).items())),
                        parameters=statistics.get(str(name), {}),
                    )
                )
    return groups


def groups_as_json(groups: Sequence[BoardGroup]) -> list[dict[str, Any]]:
    """Return groups for JSON: kind, name, sensor, boards, states and parameters."""
    return [asdict(group) for group in groups]


def latest_outcomes(index: StoreIndex, boards: LatestCalibrations) -> list[str]:
    """Return the latest status of each board, "ok" if it is unknown.

    Raises:
        InputError: the index is damaged.
    """
    sql = "SELECT board, arg_max(status, created) FROM rows WHERE board <> '' GROUP BY board"
    outcomes = {str(board): str(status) for board, status in index.query(sql)}
    return [outcomes.get(board, "ok") for board in boards.board]


def _statistics_by_group(
    boards: LatestCalibrations,
    populations: dict[tuple[str, str], Population],
    sensor: str,
    names: np.ndarray,
    in_groups: np.ndarray,
) -> dict[str, dict[str, GroupStatistics]]:
    """Return the statistics of each group of one sensor, by name and parameter."""
    statistics: dict[str, dict[str, GroupStatistics]] = {}
    for (population_sensor, parameter), fitted in populations.items():
        if population_sensor != sensor:
            continue
        known = boards.has_value(parameter)
        selected = known & in_groups
        if not selected.any():
            continue
        # from all boards of the sensor to the selected ones
        is_outlier = fitted.is_outlier[in_groups[known & (np.array(boards.sensor) == sensor)]]
        for name, group_statistics in _group_statistics(
            boards.value[parameter][selected],
            boards.std[parameter][selected],
            names[selected],
            is_outlier,
        ):
            statistics.setdefault(name, {})[parameter] = group_statistics
    return statistics


def _group_statistics(
    value: np.ndarray, std: np.ndarray, names: np.ndarray, is_outlier: np.ndarray
) -> Iterator[tuple[str, GroupStatistics]]:
    means = group_means(value, std, names.tolist(), is_outlier)
    z = {} if means is None else dict(zip(means.names, means.z.tolist(), strict=True))
    order = np.argsort(names, kind="stable")
    groups, first_row = np.unique(names[order], return_index=True)
    for name, rows in zip(groups, np.split(order, first_row[1:]), strict=True):
        if rows.size >= MIN_BOARDS:
            estimate = fit_spread(value[rows], std[rows])
            yield (
                str(name),
                GroupStatistics(
                    estimate.mean,
                    estimate.mean_std,
                    estimate.spread,
                    estimate.boards,
                    z.get(str(name)),
                ),
            )
