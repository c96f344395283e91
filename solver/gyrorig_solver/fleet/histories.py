"""What only an opened board, rig or lot shows on the fleet's page: its points and drift charts.

What to use when: `histories` for the page's 256 scripts, `drawn` for what all of them have in
common. Points are put together by the database: there are millions. A chart is told in
hundredths of its newest deviation: a twentieth of a line's width, in four letters.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import special

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.fleet.charts import (
    DISCOVERY_RATE,
    GROUP_ALPHA,
    Chart,
    Grouping,
    GroupMove,
)
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.newest import KINDS, PARAMETERS
from gyrorig_solver.fleet.overview import Overview
from gyrorig_solver.fleet.rows import NEWEST_FIRST

SHARDS = 256
HISTORY_POINTS = 60  # the latest of each board
PER_DEVIATION = 100.0  # steps of a chart's numbers in its newest deviation
_DIGITS = 7
_MEASURED = ("temperature_degc", *PARAMETERS)
_NO_POINTS = '"points":[],"std":[],"shrunk":[]'


@dataclass(frozen=True, slots=True, eq=False)
class GroupChart:
    """What the boards of a group have moved together, each about its own first nights."""

    moved: FloatArray  # (nights, parameters): EWMA, NaN before the first
    std: FloatArray  # (nights, parameters)

    @property
    def z(self) -> dict[str, float | None]:
        """How far it has moved by the last night, in standard deviations, by parameter."""
        score = (self.moved[-1] / self.std[-1]).tolist()
        return {
            name: round(one, 2) if math.isfinite(one) else None
            for name, one in zip(PARAMETERS, score, strict=True)
        }

    @property
    def text(self) -> str:
        """Its charts as the page's scripts have them, "" where none has begun."""
        nothing = np.full(self.moved.shape[1], np.nan)
        of = np.stack([nothing, nothing, nothing, self.std[-1]])
        return _chart(_texts(self.moved, self.std, of))


def shard_of(name: str) -> str:
    """Return the two digits that name the file with a board's or group's history."""
    return hashlib.sha256(name.encode()).hexdigest()[:2]


def group_key(kind: str, name: str) -> str:
    """Return under which name a group's history is kept; no board has a colon in its name."""
    return f"{kind}:{name}"


def drawn(found: Overview) -> dict[str, Any]:
    """Return what all charts of the page share: days, limits, and who has moved."""
    nights = max((len(one.history) for one in found.charts), default=0)
    return {
        "days": found.days[len(found.days) - nights :].tolist(),
        "limits": {"board": _board_limit(found), "group": _group_limit(found)},
        "moves": [
            {"kind": one.kind, "group": one.group, "parameter": one.parameter, "moved": one.moved}
            for one in found.moved
        ],
    }


def histories(
    index: Index, found: Overview, groups: dict[str, GroupChart]
) -> Iterator[tuple[str, str]]:
    """Yield the name of each script and the inside of its object: names and what they show."""
    points = _points(index, found)
    keys = list(groups)
    boards, lists = _by_shard(found.boards.board), _by_shard(keys)
    for shard in (f"{n:02x}" for n in range(SHARDS)):
        here = boards.get(shard, [])
        texts = [
            f"{json.dumps(name)}:{{{points.get(name, _NO_POINTS)}{chart}}}"
            for name, chart in zip(
                (found.boards.board[at] for at in here), _board_charts(found, here), strict=True
            )
        ]
        for key in (keys[at] for at in lists.get(shard, [])):
            chart = groups[key].text
            texts += [f"{json.dumps(key)}:{{{chart[1:]}}}"] if chart else []
        yield shard, ",".join(texts)


def _by_shard(names: Sequence[str]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for at, name in enumerate(names):
        found.setdefault(shard_of(name), []).append(at)
    return found


def _board_limit(found: Overview) -> float | None:
    """Return how many deviations the next board would have to be off to be told (see charts)."""
    tests = sum(int(np.isfinite(one.variance).sum()) for one in found.charts)
    if not tests:
        return None
    told = int(found.drifting.sum())
    return _tail(DISCOVERY_RATE * min(told + 1, tests) / tests)


def _group_limit(found: Overview) -> float | None:
    """Return how many deviations a group has to be off to be told: that of `moved_groups`."""
    groups = sum(len(one.names) for one in _groupings(found)) + 1  # the whole fleet is one
    return _tail(GROUP_ALPHA / (len(found.charts) * groups)) if found.charts else None


def _tail(both: float) -> float:
    """Return beyond how many deviations normal values are with that chance, on both sides."""
    return round(float(-special.ndtri(0.5 * both)), 3)


def _groupings(found: Overview) -> list[Grouping]:
    return [Grouping.by_name(kind, found.boards.group(kind)) for kind in KINDS]


def _board_charts(found: Overview, here: Sequence[int]) -> list[str]:
    """Return the charts of some boards as text, "" where none has begun."""
    if not found.charts:
        return [""] * len(here)
    at = np.array(here, dtype=np.intp)
    per_parameter = [
        _texts(
            one.history[:, at],
            one.history_std[:, at],
            np.stack(
                [one.base[at], one.warm_c[at], one.slope_per_c[at], np.sqrt(one.variance[at])]
            ),
        )
        for one in found.charts
    ]
    return [_chart(texts) for texts in zip(*per_parameter, strict=True)]


def group_charts(found: Overview) -> dict[str, GroupChart]:
    """Return the charts of all rigs, lots and sites by `group_key`.

    What a group is told to have moved is taken off its boards in the charts of all others: a
    lot that was measured on a rig that drifts has not moved itself.
    """
    told: dict[str, GroupChart] = {}
    groupings = _groupings(found)
    each = [_of_groups(one, groupings, found.moved) for one in found.charts]
    for key in each[0] if each else ():
        moved, std = (np.stack([one[key][which] for one in each], 1) for which in (0, 1))
        told[key] = GroupChart(moved, std)
    return told


def _of_groups(
    one: Chart, groupings: Sequence[Grouping], moves: Sequence[GroupMove]
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return each group's EWMA of one parameter and its deviation, (nights,), by `group_key`."""
    off = np.zeros(one.history.shape)
    own: dict[str, tuple[FloatArray, FloatArray]] = {}
    by_kind = {grouping.kind: grouping for grouping in groupings}
    for move in moves:  # the surest first, as they were told
        grouping = by_kind.get(move.kind)
        if move.parameter != one.parameter or grouping is None:
            continue
        at = list(grouping.names).index(move.group)
        moved, std = (column[:, at] for column in _group_history(one, grouping, off))
        own[group_key(move.kind, move.group)] = moved, std
        off[:, grouping.of == at] += np.nan_to_num(moved)[:, None]
    found: dict[str, tuple[FloatArray, FloatArray]] = {}
    for grouping in groupings:
        moved, std = _group_history(one, grouping, off)
        for at, name in enumerate(grouping.names):
            found[group_key(grouping.kind, name)] = moved[:, at], std[:, at]
    return found | own


def _group_history(
    one: Chart, grouping: Grouping, off: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return groups' EWMA and its deviation, (nights, groups), NaN before any of its boards has.

    As `charts.moved_groups` weighs boards, and with what their kinds' slopes with temperature
    may be wrong by; a board that was not measured on a night counts with its last one.

    Args:
        one: the chart of one parameter.
        grouping: the groups.
        off: what is to be taken off each board on each night, (nights, boards).
    """
    count = len(grouping.names)
    nights, boards = one.history.shape
    moved, std = np.full((2, nights, count), np.nan)
    last = np.full((3, boards), np.nan)  # EWMA, deviation and lever
    for night in range(nights):
        left = one.history[night] - off[night]
        tonight = (left, one.history_std[night], one.history_lever_c[night])
        last = np.where(np.isfinite(one.history[night]), tonight, last)
        here = np.isfinite(last[0]) & (grouping.of >= 0)
        group = np.where(here, grouping.of, 0)
        weight = np.where(here, 1.0 / last[1] ** 2, 0.0)
        total = np.bincount(group, weight, count)
        common = np.zeros(count)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.bincount(group, np.where(here, weight * last[0], 0.0), count) / total
            for kind, variance in one.slopes:
                warmer = np.where(here & kind, weight * last[2], 0.0)
                common += (np.bincount(group, warmer, count) / total) ** 2 * variance
            both = np.sqrt(1.0 / total + common)
        moved[night] = np.where(total > 0.0, mean, np.nan)
        std[night] = np.where(total > 0.0, both, np.nan)
    return moved, std


def _texts(moved: npt.NDArray[Any], std: npt.NDArray[Any], of: FloatArray) -> list[str]:
    """Return charts as text, "null" where none has begun.

    Each is [first night, base, temperature, slope, unit, EWMA of the nights, its deviations],
    the last two in hundredths of the unit.

    Args:
        moved: EWMA, (nights, n).
        std: its deviation, (nights, n).
        of: base, temperature to which values are brought, slope and unit, the newest deviation,
            (4, n).
    """
    begun = np.isfinite(moved)
    first = begun.argmax(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        steps = [(PER_DEVIATION * each / of[3]).T for each in (moved, std)]
    return [
        f"[{first[at]},{','.join(map(_number, of[:, at].tolist()))},"
        f"[{_whole(steps[0][at, first[at] :])}],[{_whole(steps[1][at, first[at] :])}]]"
        if begun[:, at].any()
        else "null"
        for at in range(moved.shape[1])
    ]


def _chart(texts: Sequence[str]) -> str:
    return "" if all(one == "null" for one in texts) else f',"chart":[{",".join(texts)}]'


def _whole(values: npt.NDArray[Any]) -> str:
    return ",".join(f"{one:.0f}" if math.isfinite(one) else "null" for one in values.tolist())


def _number(value: float) -> str:
    return f"{value:.{_DIGITS}g}" if math.isfinite(value) else "null"


def _points(index: Index, found: Overview) -> dict[str, str]:
    """Return the inside of each board's object, put together by the database."""
    if not found.boards.board:
        return {}
    sql = f"""
        WITH latest AS (
            SELECT board, version, epoch(start) AS seconds, {", ".join(_MEASURED)} FROM rows
            WHERE status = 'ok' QUALIFY
            row_number() OVER (PARTITION BY board ORDER BY {NEWEST_FIRST}) <= {HISTORY_POINTS}
        ), points AS (
            SELECT board, version, seconds,
            '[' || version || ',' || {_joined("seconds", *_MEASURED)} || ']' AS point FROM latest
        ), boards AS (
            SELECT board, string_agg(point, ',' ORDER BY seconds NULLS FIRST, version) AS points
            FROM points GROUP BY board
        )
        SELECT board, '"points":[' || points || '],"std":['
        || {_joined(*(f"{name}_std" for name in PARAMETERS))} || '],"shrunk":['
        || {_joined(*(f"{name}_shrunk" for name in PARAMETERS))} || ']'
        FROM boards JOIN newest USING (board)
    """  # noqa: S608 - ours
    newest: dict[str, Any] = {"board": np.array(found.boards.board, dtype=object)}
    for at, name in enumerate(PARAMETERS):
        newest[f"{name}_std"] = found.boards.std[name]
        newest[f"{name}_shrunk"] = found.shrunk[:, at]
    with index.connect() as database:
        database.register("newest", newest)
        return dict(database.execute(sql).fetchall())


def _joined(*columns: str) -> str:
    """Return numbers of the database as the inside of a list of JSON."""
    return f"concat_ws(',', {', '.join(_sql_number(name) for name in columns)})"


def _sql_number(column: str) -> str:
    """Return a number of the database as JSON has it."""
    digits = {"seconds": 10}.get(column, _DIGITS)
    text = f"format('{{:.{digits}g}}', {column}::DOUBLE)"
    return f"CASE WHEN isfinite({column}) THEN {text} ELSE 'null' END"
