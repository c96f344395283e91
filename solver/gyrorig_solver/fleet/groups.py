"""Lots, rigs and sites: what the boards of each are like, parameter by parameter.

What to use when: `groups_of` for the list that `gyrorig fleet --json` and its page have. A
group's mean and spread are made of its own boards alone; how far it is from the other groups
of its kind is in deviations of what boards of a group differ by (`population.group_means`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.newest import KINDS, Kind, Newest
from gyrorig_solver.fleet.population import LEAST_BOARDS, Population, group_means, spread_of


@dataclass(frozen=True, slots=True)
class GroupSpread:
    """One parameter over the boards of a group, in its unit."""

    mean: float
    mean_std: float
    spread: float  # how much its boards truly differ, one standard deviation
    count: int  # boards that have it
    z: float | None  # of the mean against all other groups' of the kind; None without another


@dataclass(frozen=True, slots=True)
class Group:
    """The boards of one sensor that are of one lot, or were measured on one rig or site."""

    kind: Kind
    name: str
    sensor: str
    boards: int
    states: dict[str, int]  # how the latest work of its boards ended: ok, rejected, ...
    parameters: dict[str, GroupSpread]


def groups_of(
    boards: Newest, populations: dict[tuple[str, str], Population], states: list[str]
) -> list[Group]:
    """Return every group of at least `LEAST_BOARDS` boards, by kind, sensor and name.

    Args:
        boards: their newest calibrations.
        populations: of all boards of a sensor, by sensor and parameter.
        states: how the latest work of each board ended.
    """
    sensors, ended = np.array(boards.sensor), np.array(states)
    found: list[Group] = []
    for kind in KINDS:
        names = np.array(boards.group(kind))
        for sensor in sorted(set(boards.sensor)):
            here = (sensors == sensor) & (names != "")
            spreads = _spreads(boards, populations, sensor, names, here)
            for name, count in zip(*np.unique(names[here], return_counts=True), strict=True):
                if count >= LEAST_BOARDS:
                    state, many = np.unique(ended[here & (names == name)], return_counts=True)
                    ends = {str(s): int(n) for s, n in zip(state, many, strict=True)}
                    own = spreads.get(str(name), {})
                    found.append(Group(kind, str(name), sensor, int(count), ends, own))
    return found


def plain_groups(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """Return groups as JSON has them: kind, name, sensor, boards, states and parameters."""
    return [asdict(one) for one in groups]


def latest_ends(index: Index, boards: Newest) -> list[str]:
    """Return how the latest work of each board ended, ok where it is not known.

    Raises:
        InputError: the index is damaged.
    """
    sql = "SELECT board, arg_max(status, created) FROM rows WHERE board <> '' GROUP BY board"
    ends = {str(board): str(status) for board, status in index.ask(sql)}
    return [ends.get(board, "ok") for board in boards.board]


def _spreads(
    boards: Newest,
    populations: dict[tuple[str, str], Population],
    sensor: str,
    names: np.ndarray,
    here: np.ndarray,
) -> dict[str, dict[str, GroupSpread]]:
    """Return what each group of one sensor is like, by its name and parameter."""
    found: dict[str, dict[str, GroupSpread]] = {}
    for (of, parameter), whole in populations.items():
        if of != sensor:
            continue
        known = boards.known(parameter)
        told = known & here
        if not told.any():
            continue
        # of all boards that were asked, which are odd
        odd = whole.odd[here[known & (np.array(boards.sensor) == sensor)]]
        for name, one in _of_groups(
            boards.value[parameter][told], boards.std[parameter][told], names[told], odd
        ):
            found.setdefault(name, {})[parameter] = one
    return found


def _of_groups(
    value: np.ndarray, std: np.ndarray, names: np.ndarray, odd: np.ndarray
) -> Iterator[tuple[str, GroupSpread]]:
    apart = group_means(value, std, names.tolist(), odd)
    z = {} if apart is None else dict(zip(apart.names, apart.z.tolist(), strict=True))
    order = np.argsort(names, kind="stable")
    groups, first = np.unique(names[order], return_index=True)
    for name, rows in zip(groups, np.split(order, first[1:]), strict=True):
        if rows.size >= LEAST_BOARDS:
            own = spread_of(value[rows], std[rows])
            yield (
                str(name),
                GroupSpread(own.mean, own.mean_std, own.spread, own.boards, z.get(str(name))),
            )
