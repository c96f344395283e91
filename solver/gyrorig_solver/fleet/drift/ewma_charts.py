"""EWMA drift charts: shifts from night to night, first of rigs, lots and sites, then of boards.

What to use when: `ewma_chart` for one `ParameterHistory`, `detect_drift` for all parameters. A rig
that drifts shifts all its boards at once. Therefore groups are tested first, and the shift of a
group is subtracted from its boards before they are tested.

Each board has a baseline, the mean of its first nights. The chart is an exponentially weighted
moving average of the later nights (EWMA; Roberts 1959) with lambda = 0.2. Its variance is computed,
not assumed. It includes the calibrations, the ordinary scatter from night to night, the baseline,
whose error every later night shares, and the difference between the board's temperature slope and
its sensor's (`temperature_slopes`). Therefore the first night after a baseline and the hundredth
have the same false-alarm rate, in any season. The scatter is estimated per sensor; therefore alarm
limits are those of Student's t, which few boards widen.

Boards are tested together by the false-discovery rate (Benjamini and Hochberg 1995) over all boards
and parameters of a night. With the usual limit of three sigma, a million boards with 13 parameters
would raise 35 000 false alarms per night.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy import special

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.fleet.drift.night_scatter import estimate_night_scatter
from gyrorig_solver.fleet.drift.temperature_slopes import correct_temperature, slope_spread
from gyrorig_solver.numerics import student_factor

EWMA_WEIGHT = 0.2  # usual lambda for small shifts: Lucas and Saccucci 1990, 0.05 to 0.25
BASELINE_NIGHTS = 10
MIN_BASELINE_NIGHTS = 3
GROUP_FALSE_ALARM_RATE = 1e-4  # per night, over all groups and parameters
FALSE_DISCOVERY_RATE = 0.01
HISTORY_NIGHTS = 60  # kept for the page; all nights of many boards take gigabytes

IntArray = npt.NDArray[np.intp]
HistoryArray = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class ParameterHistory:
    """The history of one parameter: nights by boards, NaN where a board was not measured."""

    parameter: str
    value: FloatArray  # (nights, boards)
    variance: FloatArray  # (nights, boards), of the calibrations
    temperature_c: FloatArray | None = None  # (nights, boards)
    kind: IntArray | None = None  # (boards,): number of the sensor; None: one sensor for all


@dataclass(frozen=True, slots=True, eq=False)
class DriftChart:
    """EWMA of one parameter after the last night, for all boards."""

    parameter: str
    # (boards,): of its sensor from night to night, in addition to the calibrations' own
    night_scatter_std: FloatArray
    degrees_of_freedom: FloatArray  # (boards,), of that scatter; 0 if it is unknown
    slope_per_c: FloatArray  # (boards,): of its sensor, subtracted; NaN if unknown
    slope_spread: FloatArray  # (boards,): standard deviation of boards' slopes about it
    slope_variances: list[tuple[BoolArray, float]]  # boards of a sensor, variance of its slope
    temperature_offset_c: FloatArray  # (boards,): EWMA of temperature minus baseline
    shift: FloatArray  # (boards,): EWMA minus baseline, in the parameter's unit
    variance: FloatArray  # (boards,), inf before the baseline
    baseline: FloatArray  # (boards,): mean of the first nights, at the reference temperature
    reference_temperature_c: FloatArray  # (boards,): of corrected values; NaN if uncorrected
    # Of the last nights, (at most HISTORY_NIGHTS, boards), float32, NaN within baselines:
    ewma_history: HistoryArray  # the EWMA
    ewma_history_std: HistoryArray  # its standard deviation
    temperature_offset_history_c: HistoryArray  # `temperature_offset_c` of that night

    def z(self, tail_probability: float) -> FloatArray:
        """Return the shift of each board in standard deviations; 0 before its baseline.

        Args:
            tail_probability: of the alarm limit, at which the scores have the tail probability of a
                normal variable. Far from it, they are only approximately normal.
        """
        widening = student_factor(self.degrees_of_freedom, tail_probability)
        score: FloatArray = np.where(
            np.isfinite(self.variance), self.shift / (np.sqrt(self.variance) * widening), 0.0
        )
        return score


@dataclass(frozen=True, slots=True)
class GroupShift:
    """Common shift of the boards of a rig, lot or site, or of the whole fleet."""

    parameter: str
    kind: str
    group: str
    board_count: int
    shift: float  # in the parameter's unit
    z: float
    p_value: float


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """One way to group boards, such as by rig."""

    kind: str
    names: Sequence[str]
    group_index: IntArray  # (boards,): number of the group, -1 for none

    @classmethod
    def by_name(cls, kind: str, names: Sequence[str]) -> Self:
        """Return the groups of boards, given the name of each board's group, "" for none."""
        groups = sorted({name for name in names if name})
        number = {name: index for index, name in enumerate(groups)}
        group_index = np.array([number.get(name, -1) for name in names], dtype=np.intp)
        return cls(kind, groups, group_index)


@dataclass(frozen=True, slots=True, eq=False)
class DriftResult:
    """Shifted groups and drifting boards of all parameters after the last night."""

    group_shifts: list[GroupShift]  # the most significant first
    drifting: BoolArray  # (boards, parameters), after subtraction of the groups' shifts
    z: FloatArray  # (boards, parameters), after that subtraction


def ewma_chart(parameter_history: ParameterHistory) -> DriftChart:
    """Return the EWMA chart of one parameter.

    Boards with fewer than `MIN_BASELINE_NIGHTS` nights before the last have no chart, nor have
    boards of a sensor whose scatter from night to night is not known.
    """
    corrected = correct_temperature(
        parameter_history.value,
        parameter_history.variance,
        parameter_history.temperature_c,
        parameter_history.kind,
    )
    value, temperature_offset_c = corrected.value, corrected.temperature_offset_c
    measured = np.isfinite(value)
    count = np.cumsum(measured, axis=0)
    baseline_length = np.clip(count[-1] - 1, 0, BASELINE_NIGHTS)
    in_baseline = measured & (count <= baseline_length)
    kind = parameter_history.kind
    scatter = estimate_night_scatter(
        value,
        parameter_history.variance,
        in_baseline,
        np.zeros(value.shape[1], dtype=np.intp) if kind is None else kind,
    )
    noise = np.where(measured, parameter_history.variance + scatter.variance, np.inf)
    slope_std = slope_spread(corrected, scatter.variance)
    weight = np.where(in_baseline, 1.0 / noise, 0.0)
    total_weight = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        baseline = (weight * np.where(measured, value, 0.0)).sum(axis=0) / total_weight
        baseline_variance = 1.0 / total_weight
        baseline_offset_c = (weight * temperature_offset_c).sum(axis=0) / total_weight
    charted = (baseline_length >= MIN_BASELINE_NIGHTS) & (scatter.degrees_of_freedom > 0.0)
    baseline_variance[~charted] = 0.0  # no chart; inf times 0 would be NaN
    shift, ewma_offset_c = np.zeros(value.shape[1]), np.zeros(value.shape[1])
    nights_variance = np.zeros(value.shape[1])  # variance of the nights after the baseline
    baseline_share = np.zeros(value.shape[1])  # share of the baseline's error in the EWMA
    first = max(len(value) - HISTORY_NIGHTS, 0)
    recent = np.full((3, len(value) - first, value.shape[1]), np.nan, dtype=np.float32)
    for night in range(len(value)):
        is_updated = measured[night] & ~in_baseline[night] & charted
        step = np.where(is_updated, EWMA_WEIGHT, 0.0)
        deviation = np.where(is_updated, value[night] - baseline, 0.0)
        shift += step * (deviation - shift)
        offset_c = np.where(is_updated, temperature_offset_c[night] - baseline_offset_c, 0.0)
        ewma_offset_c += step * (offset_c - ewma_offset_c)
        added_variance = np.where(is_updated, EWMA_WEIGHT**2 * noise[night], 0.0)
        nights_variance = (1.0 - step) ** 2 * nights_variance + added_variance
        baseline_share += step * (1.0 - baseline_share)
        if night >= first:
            ewma_variance = _ewma_variance(
                nights_variance, baseline_share, baseline_variance, ewma_offset_c, slope_std
            )
            row = (shift, np.sqrt(ewma_variance), ewma_offset_c)
            recent[:, night - first] = np.where(is_updated, row, np.nan)
    ewma_variance = _ewma_variance(
        nights_variance, baseline_share, baseline_variance, ewma_offset_c, slope_std
    )
    variance = np.where(charted & (baseline_share > 0.0), ewma_variance, np.inf)
    return DriftChart(
        parameter=parameter_history.parameter,
        night_scatter_std=np.sqrt(scatter.variance),
        degrees_of_freedom=scatter.degrees_of_freedom,
        slope_per_c=corrected.slope_per_c,
        slope_spread=slope_std,
        slope_variances=corrected.slope_variances,
        temperature_offset_c=ewma_offset_c,
        shift=shift,
        variance=variance,
        baseline=baseline,
        reference_temperature_c=corrected.mean_temperature_c,
        ewma_history=recent[0],
        ewma_history_std=recent[1],
        temperature_offset_history_c=recent[2],
    )


def detect_drift(charts: Sequence[DriftChart], groupings: Sequence[Grouping]) -> DriftResult:
    """Test groups, then boards, over all parameters.

    Args:
        charts: one per parameter, of the same boards.
        groupings: the smaller groups first.
    """
    tests = len(charts) * sum(len(grouping.names) for grouping in groupings)
    group_shifts: list[GroupShift] = []
    remaining: list[DriftChart] = []
    for chart in charts:
        shifts, chart_without_shifts = shifted_groups(chart, groupings, tests)
        group_shifts += shifts
        remaining.append(chart_without_shifts)
    tail_probability = board_tail_probability(remaining)
    return DriftResult(
        group_shifts=sorted(group_shifts, key=lambda shift: -abs(shift.z)),
        drifting=benjamini_hochberg(board_p_values(remaining)),
        z=np.stack([chart.z(tail_probability) for chart in remaining], 1),
    )


def shifted_groups(
    chart: DriftChart, groupings: Sequence[Grouping], tests: int
) -> tuple[list[GroupShift], DriftChart]:
    """Return the groups whose boards have shifted together, and the chart without these shifts.

    A group's shift is the weighted mean of its boards' charts. The square of its z score is the
    chi-square that this one number explains. The group that explains most is selected first and
    its shift is subtracted from its boards, until no group explains enough. One drifting rig of
    eight shifts the fleet's mean too, but its chart explains more than the fleet's.
    A whole site explains more than any of its rigs. A group whose median board has not shifted is
    skipped, so that a single outlier is not taken for its rig.

    Args:
        chart: of one parameter.
        groupings: the smaller groups first: of two that explain the same, the first counts.
        tests: number of groups times parameters that are tested on this night.
    """
    shift = chart.shift.copy()
    shifts: list[GroupShift] = []
    selected_groups: set[tuple[str, str]] = set()
    tail_probability = GROUP_FALSE_ALARM_RATE / max(tests, 1)
    while True:
        best: GroupShift | None = None
        members: BoolArray | None = None
        for grouping in groupings:
            for candidate, boards in _candidate_shifts(chart, grouping, shift, tail_probability):
                is_better = best is None or abs(candidate.z) > abs(best.z) * (1.0 + 1e-9)
                if is_better and (candidate.kind, candidate.group) not in selected_groups:
                    best, members = candidate, boards
        if best is None or members is None:
            return shifts, replace(chart, shift=shift)
        shifts.append(best)
        selected_groups.add((best.kind, best.group))
        shift[members] -= best.shift


def _candidate_shifts(
    chart: DriftChart, grouping: Grouping, shift: FloatArray, tail_probability: float
) -> Iterator[tuple[GroupShift, BoolArray]]:
    """Yield the groups that have shifted by more than the limit, with their boards.

    The error of a sensor's temperature slope does not average out over its boards. It is
    multiplied by the temperature difference between the group's nights and its baseline.
    """
    variance = chart.variance
    mean, mean_variance = group_means_of_chart(
        chart, grouping, shift, variance, chart.temperature_offset_c, tail_probability
    )
    limit = float(-special.ndtri(0.5 * tail_probability))
    z = mean / np.sqrt(mean_variance)
    charted = np.isfinite(variance) & (grouping.group_index >= 0)
    board_count = np.bincount(grouping.group_index[charted], minlength=len(grouping.names))
    for index in np.flatnonzero((board_count >= 2) & (np.abs(np.nan_to_num(z)) > limit)):
        members: BoolArray = charted & (grouping.group_index == index)
        widening = student_factor(chart.degrees_of_freedom[members], tail_probability)
        scores = shift[members] / (np.sqrt(variance[members]) * widening)
        median_score = float(np.median(scores)) * np.sign(z[index])
        # the mean of the scores of n boards is z / sqrt(n); their median must be near it
        if median_score > abs(z[index]) / np.sqrt(board_count[index]) / 3.0:
            score = float(z[index])
            p_value = float(2.0 * special.ndtr(-abs(score)))
            group_shift = GroupShift(
                chart.parameter,
                grouping.kind,
                grouping.names[int(index)],
                int(board_count[index]),
                float(mean[index]),
                score,
                p_value,
            )
            yield group_shift, members


def group_means_of_chart(
    chart: DriftChart,
    grouping: Grouping,
    shift: FloatArray,
    variance: FloatArray,
    temperature_offset_c: FloatArray,
    tail_probability: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean shift of each group and its variance, (groups,), NaN without any.

    The variance is multiplied by the square of `student_factor` at the alarm limit. The degrees
    of freedom of a group are the weighted harmonic mean of those of its boards, which is at most
    the value by Satterthwaite (1946).

    Args:
        chart: whose slopes have errors.
        grouping: the groups.
        shift: of each board, shape (boards,).
        variance: of each shift; a board without a finite one does not count.
        temperature_offset_c: of each board.
        tail_probability: of the alarm limit.
    """
    counted = np.isfinite(variance) & (grouping.group_index >= 0)
    group, count = np.where(counted, grouping.group_index, 0), len(grouping.names)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(counted, 1.0 / variance, 0.0)
        total = np.bincount(group, weight, count)
        mean = np.bincount(group, np.where(counted, weight * shift, 0.0), count) / total
        inverse_degrees = np.where(counted, weight / chart.degrees_of_freedom, 0.0)
        degrees_of_freedom = total / np.bincount(group, inverse_degrees, count)
        mean_variance = 1.0 / total
        for of_sensor, slope_variance in chart.slope_variances:
            offset_c = np.where(counted & of_sensor, weight * temperature_offset_c, 0.0)
            mean_variance += (np.bincount(group, offset_c, count) / total) ** 2 * slope_variance
        mean_variance *= student_factor(degrees_of_freedom, tail_probability) ** 2
    return mean, np.where(total > 0.0, mean_variance, np.nan)


def benjamini_hochberg(
    p_value: FloatArray, false_discovery_rate: float = FALSE_DISCOVERY_RATE
) -> BoolArray:
    """Return which of many tests are significant at a false-discovery rate.

    Args:
        p_value: any shape; NaN where nothing was tested.
        false_discovery_rate: expected share of false ones among the significant tests.

    Source: Benjamini and Hochberg 1995.
    """
    tested = p_value[np.isfinite(p_value)]
    ordered = np.sort(tested)
    limits = false_discovery_rate * np.arange(1, len(ordered) + 1) / max(len(ordered), 1)
    passing = np.flatnonzero(ordered <= limits)
    limit = ordered[passing[-1]] if len(passing) else -1.0
    accepted: BoolArray = np.isfinite(p_value) & (p_value <= limit)
    return accepted


def board_p_values(charts: Sequence[DriftChart]) -> FloatArray:
    """Return two-sided p values, shape (boards, parameters); NaN before the baseline."""
    columns = []
    for chart in charts:
        with np.errstate(invalid="ignore", divide="ignore"):
            t = chart.shift / np.sqrt(chart.variance)
        p_value = 2.0 * special.stdtr(chart.degrees_of_freedom, -np.abs(t))
        columns.append(np.where(np.isfinite(chart.variance), p_value, np.nan))
    return np.stack(columns, axis=1)


def board_tail_probability(charts: Sequence[DriftChart]) -> float:
    """Return the largest p value at which the first board raises an alarm, over all charts."""
    tests = sum(int(np.isfinite(chart.variance).sum()) for chart in charts)
    return FALSE_DISCOVERY_RATE / max(tests, 1)


def _ewma_variance(
    nights_variance: FloatArray,
    baseline_share: FloatArray,
    baseline_variance: FloatArray,
    temperature_offset_c: FloatArray,
    slope_std: FloatArray,
) -> FloatArray:
    """Return the variance of an EWMA, from its nights, its baseline and the board's slope."""
    return (
        nights_variance
        + baseline_share**2 * baseline_variance
        + (temperature_offset_c * slope_std) ** 2
    )
