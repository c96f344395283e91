"""Histories of boards and groups for the fleet's page: calibrations and drift charts.

What to use when: `history_scripts` for the page's 256 scripts, `shared_chart_data` for what all
charts share. The database assembles the points, because there are millions. The numbers of a
chart are hundredths of its last standard deviation: less than a twentieth of a line's width.
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

from gyrorig_solver.data import FloatArray
from gyrorig_solver.fleet.drift import FleetOverview
from gyrorig_solver.fleet.drift.ewma_charts import (
    FALSE_DISCOVERY_RATE,
    GROUP_FALSE_ALARM_RATE,
    DriftChart,
    Grouping,
    GroupShift,
    board_tail_probability,
    group_means_of_chart,
)
from gyrorig_solver.fleet.drift.latest_calibrations import GROUP_KINDS, PARAMETER_COLUMNS
from gyrorig_solver.fleet.store import NEWEST_FIRST_SQL, StoreIndex
from gyrorig_solver.numerics import student_factor

HISTORY_FILES = 256
MAX_POINTS_PER_BOARD = 60  # the latest of each board
STEPS_PER_STD = 100.0  # resolution of a chart's numbers: steps in its last standard deviation
_SIGNIFICANT_DIGITS = 7
_POINT_COLUMNS = ("temperature_degc", *PARAMETER_COLUMNS)
_NO_POINTS = '"points":[],"std":[],"shrunk":[]'


@dataclass(frozen=True, slots=True, eq=False)
class GroupDriftChart:
    """Drift chart of a group: the common shift of its boards since their first nights."""

    shift: FloatArray  # (nights, parameters): EWMA, NaN before the first
    std: FloatArray  # (nights, parameters)

    @property
    def z(self) -> dict[str, float | None]:
        """The shift on the last night in standard deviations, by parameter."""
        score = (self.shift[-1] / self.std[-1]).tolist()
        return {
            name: round(value, 2) if math.isfinite(value) else None
            for name, value in zip(PARAMETER_COLUMNS, score, strict=True)
        }

    @property
    def script_text(self) -> str:
        """Its charts as text of the page's scripts, "" before the first baseline."""
        unknown = np.full(self.shift.shape[1], np.nan)
        scales = np.stack([unknown, unknown, unknown, self.std[-1]])
        return _chart_entry(_chart_texts(self.shift, self.std, scales))


def history_shard(name: str) -> str:
    """Return the two hexadecimal digits that name the file with a board's or group's history."""
    return hashlib.sha256(name.encode()).hexdigest()[:2]


def group_key(kind: str, name: str) -> str:
    """Return the name of a group's history. No board's name contains a colon."""
    return f"{kind}:{name}"


def shared_chart_data(overview: FleetOverview) -> dict[str, Any]:
    """Return what all charts of the page share: days, alarm limits and shifts of groups."""
    nights = max((len(chart.ewma_history) for chart in overview.charts), default=0)
    return {
        "days": overview.night_days[len(overview.night_days) - nights :].tolist(),
        "limits": {"board": _board_alarm_limit(overview), "group": _group_alarm_limit(overview)},
        "shifts": [
            {
                "kind": shift.kind,
                "group": shift.group,
                "parameter": shift.parameter,
                "size": shift.shift,
            }
            for shift in overview.group_shifts
        ],
    }


def history_scripts(
    index: StoreIndex, overview: FleetOverview, groups: dict[str, GroupDriftChart]
) -> Iterator[tuple[str, str]]:
    """Yield the name of each script, and the members of its object: histories by name."""
    points = _board_points(index, overview)
    group_keys = list(groups)
    boards_by_shard, groups_by_shard = _by_shard(overview.boards.board), _by_shard(group_keys)
    for shard in (f"{n:02x}" for n in range(HISTORY_FILES)):
        board_indices = boards_by_shard.get(shard, [])
        entries = [
            f"{json.dumps(name)}:{{{points.get(name, _NO_POINTS)}{chart}}}"
            for name, chart in zip(
                (overview.boards.board[position] for position in board_indices),
                _board_charts(overview, board_indices),
                strict=True,
            )
        ]
        for key in (group_keys[position] for position in groups_by_shard.get(shard, [])):
            chart = groups[key].script_text
            entries += [f"{json.dumps(key)}:{{{chart[1:]}}}"] if chart else []
        yield shard, ",".join(entries)


def _by_shard(names: Sequence[str]) -> dict[str, list[int]]:
    indices_by_shard: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        indices_by_shard.setdefault(history_shard(name), []).append(index)
    return indices_by_shard


def _board_alarm_limit(overview: FleetOverview) -> float | None:
    """Return the shift, in standard deviations, at which one more board would raise an alarm.

    This is the Benjamini-Hochberg limit of tonight, see `ewma_charts.benjamini_hochberg`.
    """
    tests = sum(int(np.isfinite(chart.variance).sum()) for chart in overview.charts)
    if not tests:
        return None
    alarm_count = int(overview.drifting.sum())
    return _two_sided_limit(FALSE_DISCOVERY_RATE * min(alarm_count + 1, tests) / tests)


def _group_alarm_limit(overview: FleetOverview) -> float | None:
    """Return the alarm limit of groups in standard deviations, as `shifted_groups` uses it."""
    return _two_sided_limit(_group_tail_probability(overview)) if overview.charts else None


def _group_tail_probability(overview: FleetOverview) -> float:
    groups = sum(len(grouping.names) for grouping in _groupings(overview)) + 1  # and the fleet
    return GROUP_FALSE_ALARM_RATE / max(len(overview.charts) * groups, 1)


def _two_sided_limit(tail_probability: float) -> float:
    """Return the two-sided quantile of the normal distribution."""
    return round(float(-special.ndtri(0.5 * tail_probability)), 3)


def _groupings(overview: FleetOverview) -> list[Grouping]:
    return [Grouping.by_name(kind, overview.boards.group_names(kind)) for kind in GROUP_KINDS]


def _board_charts(overview: FleetOverview, board_indices: Sequence[int]) -> list[str]:
    """Return the charts of boards as text, "" before the first baseline."""
    if not overview.charts:
        return [""] * len(board_indices)
    columns = np.array(board_indices, dtype=np.intp)
    tail_probability = board_tail_probability(overview.charts)
    per_parameter = [
        _board_chart_texts(chart, columns, tail_probability) for chart in overview.charts
    ]
    return [_chart_entry(texts) for texts in zip(*per_parameter, strict=True)]


def _board_chart_texts(
    chart: DriftChart, columns: npt.NDArray[np.intp], tail_probability: float
) -> list[str]:
    """Return one parameter's charts of boards as text; see `_chart_texts`."""
    widening = student_factor(chart.degrees_of_freedom[columns], tail_probability)
    return _chart_texts(
        chart.ewma_history[:, columns],
        chart.ewma_history_std[:, columns] * widening,
        np.stack(
            [
                chart.baseline[columns],
                chart.reference_temperature_c[columns],
                chart.slope_per_c[columns],
                np.sqrt(chart.variance[columns]) * widening,
            ]
        ),
    )


def group_charts(overview: FleetOverview) -> dict[str, GroupDriftChart]:
    """Return the charts of all rigs, lots and sites by `group_key`.

    The shift that is reported for a group is subtracted from its boards in the charts of all
    other groups: a lot that was measured on a drifting rig has not shifted itself.
    """
    groupings = _groupings(overview)
    tail_probability = _group_tail_probability(overview)
    by_parameter = [
        _group_histories(chart, groupings, overview.group_shifts, tail_probability)
        for chart in overview.charts
    ]
    charts: dict[str, GroupDriftChart] = {}
    for key in by_parameter[0] if by_parameter else ():
        shift, std = (
            np.stack([histories[key][part] for histories in by_parameter], 1) for part in (0, 1)
        )
        charts[key] = GroupDriftChart(shift, std)
    return charts


def _group_histories(
    chart: DriftChart,
    groupings: Sequence[Grouping],
    shifts: Sequence[GroupShift],
    tail_probability: float,
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return EWMA and standard deviation, each (nights,), of every group by `group_key`."""
    subtracted = np.zeros(chart.ewma_history.shape)
    reported: dict[str, tuple[FloatArray, FloatArray]] = {}
    by_kind = {grouping.kind: grouping for grouping in groupings}
    for shift in shifts:  # in the order of their significance
        grouping = by_kind.get(shift.kind)
        if shift.parameter != chart.parameter or grouping is None:
            continue
        number = list(grouping.names).index(shift.group)
        columns = _group_ewma(chart, grouping, subtracted, tail_probability)
        ewma, std = (column[:, number] for column in columns)
        reported[group_key(shift.kind, shift.group)] = ewma, std
        subtracted[:, grouping.group_index == number] += np.nan_to_num(ewma)[:, None]
    histories: dict[str, tuple[FloatArray, FloatArray]] = {}
    for grouping in groupings:
        ewma, std = _group_ewma(chart, grouping, subtracted, tail_probability)
        for number, name in enumerate(grouping.names):
            histories[group_key(grouping.kind, name)] = ewma[:, number], std[:, number]
    return histories | reported


def _group_ewma(
    chart: DriftChart, grouping: Grouping, subtracted: FloatArray, tail_probability: float
) -> tuple[FloatArray, FloatArray]:
    """Return EWMA and standard deviation of groups, (nights, groups), NaN before the first.

    Boards are weighted as in `ewma_charts.shifted_groups`, with the error of their sensor's
    temperature slope. A board that was not measured on a night counts with its last night.

    Args:
        chart: of one parameter.
        grouping: the groups.
        subtracted: shift to subtract per night and board, (nights, boards).
        tail_probability: of the groups' alarm limit.
    """
    count = len(grouping.names)
    nights, boards = chart.ewma_history.shape
    ewma, std = np.full((2, nights, count), np.nan)
    last = np.full((3, boards), np.nan)  # EWMA, standard deviation, temperature offset
    for night in range(nights):
        tonight = (
            chart.ewma_history[night] - subtracted[night],
            chart.ewma_history_std[night],
            chart.temperature_offset_history_c[night],
        )
        last = np.where(np.isfinite(chart.ewma_history[night]), tonight, last)
        ewma[night], variance = group_means_of_chart(
            chart, grouping, last[0], last[1] ** 2, last[2], tail_probability
        )
        std[night] = np.sqrt(variance)
    return ewma, std


def _chart_texts(ewma: npt.NDArray[Any], std: npt.NDArray[Any], scales: FloatArray) -> list[str]:
    """Return charts as text, "null" before the first baseline.

    Each is [first night, baseline, reference temperature, slope, unit, EWMA per night, its
    standard deviation per night], the last two in hundredths of the unit.

    Args:
        ewma: (nights, n).
        std: standard deviation of the EWMA, (nights, n).
        scales: baseline, reference temperature, slope and unit, which is the last standard
            deviation, (4, n).
    """
    has_started = np.isfinite(ewma)
    first_night = has_started.argmax(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = [(STEPS_PER_STD * values / scales[3]).T for values in (ewma, std)]
    texts: list[str] = []
    for index, first in enumerate(first_night.tolist()):
        if not has_started[:, index].any():
            texts.append("null")
            continue
        head = ",".join(map(_json_number, scales[:, index].tolist()))
        series = ",".join(f"[{_rounded_numbers(values[index, first:])}]" for values in scaled)
        texts.append(f"[{first},{head},{series}]")
    return texts


def _chart_entry(texts: Sequence[str]) -> str:
    return "" if all(text == "null" for text in texts) else f',"chart":[{",".join(texts)}]'


def _rounded_numbers(values: npt.NDArray[Any]) -> str:
    return ",".join(f"{value:.0f}" if math.isfinite(value) else "null" for value in values.tolist())


def _json_number(value: float) -> str:
    return f"{value:.{_SIGNIFICANT_DIGITS}g}" if math.isfinite(value) else "null"


def _board_points(index: StoreIndex, overview: FleetOverview) -> dict[str, str]:
    """Return the members of each board's object, assembled by the database."""
    if not overview.boards.board:
        return {}
    sql = f"""
        WITH latest AS (
            SELECT board, version, epoch(start) AS seconds, {", ".join(_POINT_COLUMNS)} FROM rows
            WHERE status = 'ok' QUALIFY
            row_number() OVER (PARTITION BY board ORDER BY {NEWEST_FIRST_SQL})
            <= {MAX_POINTS_PER_BOARD}
        ), points AS (
            SELECT board, version, seconds,
            '[' || version || ',' || {_sql_number_list("seconds", *_POINT_COLUMNS)} || ']' AS point
            FROM latest
        ), boards AS (
            SELECT board, string_agg(point, ',' ORDER BY seconds NULLS FIRST, version) AS points
            FROM points GROUP BY board
        )
        SELECT board, '"points":[' || points || '],"std":['
        || {_sql_number_list(*(f"{name}_std" for name in PARAMETER_COLUMNS))} || '],"shrunk":['
        || {_sql_number_list(*(f"{name}_shrunk" for name in PARAMETER_COLUMNS))} || ']'
        FROM boards JOIN newest USING (board)
    """  # noqa: S608 - ours
    newest: dict[str, Any] = {"board": np.array(overview.boards.board, dtype=object)}
    for column, name in enumerate(PARAMETER_COLUMNS):
        newest[f"{name}_std"] = overview.boards.std[name]
        newest[f"{name}_shrunk"] = overview.shrunk[:, column]
    with index.connect() as database:
        database.register("newest", newest)
        return dict(database.execute(sql).fetchall())


def _sql_number_list(*columns: str) -> str:
    """Return SQL for the elements of a JSON list of numbers."""
    return f"concat_ws(',', {', '.join(_sql_number(column) for column in columns)})"


def _sql_number(column: str) -> str:
    """Return SQL for a number in JSON."""
    digits = {"seconds": 10}.get(column, _SIGNIFICANT_DIGITS)
    text = f"format('{{:.{digits}g}}', {column}::DOUBLE)"
    return f"CASE WHEN isfinite({column}) THEN {text} ELSE 'null' END"
