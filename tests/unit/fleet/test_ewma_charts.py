"""Drift charts: their false alarms by simulation, and what they find, how soon."""

import numpy as np
import pytest
from scipy.stats import false_discovery_control, norm

from gyrorig_solver.fleet.drift.ewma_charts import (
    EWMA_WEIGHT,
    DriftChart,
    Grouping,
    ParameterHistory,
    benjamini_hochberg,
    board_p_values,
    detect_drift,
    ewma_chart,
    shifted_groups,
)

NIGHTS, BOARDS, RIGS = 30, 400, 8


def quiet(rng: np.random.Generator, missing: float = 0.2) -> ParameterHistory:
    """Boards that scatter by 1 from night to night, beside calibrations good to 0.5 to 1.5."""
    variance = (rng.uniform(0.5, 1.5, BOARDS) ** 2)[None] * np.ones((NIGHTS, 1))
    value = rng.normal(0.0, 10.0, BOARDS) + rng.normal(size=(NIGHTS, BOARDS)) * np.sqrt(
        variance + 1.0
    )
    value[rng.random(value.shape) < missing] = np.nan
    return ParameterHistory("scale_x", value, np.where(np.isfinite(value), variance, np.nan))


RIG = Grouping("rig", [f"rig-{n}" for n in range(RIGS)], np.arange(BOARDS) % RIGS)
SITE = Grouping("site", ["north", "south"], np.arange(BOARDS) % RIGS // 4)
ALL = Grouping("fleet", ["all"], np.zeros(BOARDS, dtype=np.intp))
GROUPS = [RIG, SITE, ALL]


def moves(drift_chart: DriftChart) -> list[tuple[str, str]]:
    return [(move.kind, move.group) for move in shifted_groups(drift_chart, GROUPS, 11)[0]]


def test_stable_boards_have_standard_normal_scores() -> None:
    rng = np.random.default_rng(1)
    charts = [ewma_chart(quiet(rng)) for _ in range(20)]
    z = np.concatenate([drift_chart.z(1e-3) for drift_chart in charts])
    assert np.std(z) == pytest.approx(1.0, abs=0.03)
    assert np.mean(np.abs(z) > 3.0) == pytest.approx(0.0027, abs=0.0015)
    assert charts[0].night_scatter_std[0] == pytest.approx(1.0, abs=0.1)
    assert (
        sum(int(benjamini_hochberg(board_p_values([drift_chart])).sum()) for drift_chart in charts)
        <= 1
    )
    assert not any(moves(drift_chart) for drift_chart in charts)


@pytest.mark.parametrize(
    ("selected", "expected"),
    [
        (RIG.group_index == 3, ("rig", "rig-3")),
        (SITE.group_index == 1, ("site", "south")),
        (RIG.group_index >= 0, ("fleet", "all")),
    ],
)
def test_a_common_drift_is_reported_once_with_its_size(
    selected: np.ndarray, expected: tuple[str, str]
) -> None:
    rng = np.random.default_rng(2)
    nights = quiet(rng)
    nights.value[15:, selected] += 0.1 * np.arange(1, 16)[:, None]
    drift_chart = ewma_chart(nights)
    assert moves(drift_chart) == [expected]
    (move,), rest = shifted_groups(drift_chart, GROUPS, 11)
    assert move.z > 5.0
    assert move.board_count == selected.sum()
    assert not benjamini_hochberg(board_p_values([rest])).any()


def test_a_drifting_board_is_not_attributed_to_its_rig() -> None:
    rng = np.random.default_rng(3)
    nights = quiet(rng)
    nights.value[12:, 77] += 60.0
    drift_chart = ewma_chart(nights)
    assert moves(drift_chart) == []
    assert list(np.flatnonzero(benjamini_hochberg(board_p_values([drift_chart]))[:, 0])) == [77]


def test_a_temperature_slope_is_not_a_drift() -> None:
    rng = np.random.default_rng(4)
    nights = quiet(rng)
    temperature = (
        20.0
        + 10.0 * np.sin(np.arange(NIGHTS) / 5.0)[:, None]
        + rng.normal(0.0, 1.0, (NIGHTS, BOARDS))
    )
    nights.value[:] += 0.7 * temperature
    raw, reported = (
        ewma_chart(nights),
        ewma_chart(ParameterHistory("b", nights.value, nights.variance, temperature)),
    )
    assert reported.slope_per_c == pytest.approx(np.full(BOARDS, 0.7), abs=0.02)
    assert benjamini_hochberg(board_p_values([raw])).sum() > 20
    assert benjamini_hochberg(board_p_values([reported])).sum() == 0


def test_a_small_span_of_temperature_gives_no_slope() -> None:
    nights = quiet(np.random.default_rng(5))
    steady = np.full(nights.value.shape, 21.0) + np.arange(NIGHTS)[:, None] * 0.05
    drift_chart = ewma_chart(ParameterHistory("b", nights.value, nights.variance, steady))
    assert np.isnan(drift_chart.slope_per_c).all()
    assert drift_chart.slope_variances == []


def test_a_board_without_a_baseline_has_no_chart() -> None:
    value = np.full((NIGHTS, 3), np.nan)
    value[-1] = 1.0
    value[:9, 1] = 1.0
    value[:2, 2] = 1.0
    drift_chart = ewma_chart(
        ParameterHistory("b", value, np.where(np.isfinite(value), 0.1, np.nan))
    )
    assert list(np.isfinite(drift_chart.variance)) == [False, True, False]


def test_without_gaps_the_drift_chartis_the_plain_ewma() -> None:
    """With equal variances the score is Roberts' (1959), the baseline's error added."""
    rng = np.random.default_rng(6)
    value = rng.normal(size=(40, 5))
    drift_chart = ewma_chart(ParameterHistory("b", value, np.full(value.shape, 1.0)))
    base, ewma = value[:10].mean(axis=0), np.zeros(5)
    for night in value[10:]:
        ewma = (1.0 - EWMA_WEIGHT) * ewma + EWMA_WEIGHT * (night - base)
    np.testing.assert_allclose(drift_chart.shift, ewma)
    noise = 1.0 + drift_chart.night_scatter_std[0] ** 2
    left = 1.0 - (1.0 - EWMA_WEIGHT) ** 60
    expected = noise * (EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * left + (1.0 - 0.8**30) ** 2 / 10.0)
    np.testing.assert_allclose(drift_chart.variance, expected)


def steady_charts(
    rng: np.random.Generator, nights: int, scatter: np.ndarray, kind: np.ndarray, parameters: int
) -> list[DriftChart]:
    """Charts of boards without a drift, whose calibrations are better than the scatter."""
    shape = (nights, scatter.size)
    variance = np.full(shape, 0.15**2)
    charts = []
    for _ in range(parameters):
        value = rng.normal(0.0, 10.0, scatter.size) + rng.normal(0.0, 1.0, shape) * scatter
        value += rng.normal(0.0, 0.15, shape)
        charts.append(ewma_chart(ParameterHistory("scale_x", value, variance, kind=kind)))
    return charts


@pytest.mark.parametrize(("quiet_boards", "boards"), [(4, 8), (60, 100)])
def test_a_sensor_that_scatters_more_does_not_drift(quiet_boards: int, boards: int) -> None:
    rng = np.random.default_rng(8)
    is_loud = np.arange(boards) >= quiet_boards
    kind, scatter = is_loud.astype(np.intp), np.where(is_loud, 1.0, 0.1)
    alarms, z = 0, []
    for _ in range(20):
        charts = steady_charts(rng, 14, scatter, kind, parameters=3)
        alarms += bool(benjamini_hochberg(board_p_values(charts)).any())
        z += [chart.z(1e-3) for chart in charts]
    assert alarms <= 2
    loud, still = np.array(z)[:, is_loud].std(), np.array(z)[:, ~is_loud].std()
    assert 0.6 < loud / still < 1.6


@pytest.mark.parametrize(("boards", "nights"), [(1, 14), (2, 10), (4, 6), (8, 14)])
def test_charts_of_few_boards_have_the_stated_false_alarm_rate(boards: int, nights: int) -> None:
    """At 1 %, few of 100 nights; the scatter is known from 9 to 72 pairs of nights."""
    rng = np.random.default_rng(9)
    kind = np.zeros(boards, dtype=np.intp)
    groupings = [Grouping.by_name("rig", ["a"] * boards)]
    board_alarms, group_alarms = 0, 0
    for _ in range(100):
        charts = steady_charts(rng, nights, np.ones(boards), kind, parameters=4)
        result = detect_drift(charts, groupings)
        board_alarms += bool(result.drifting.any())
        group_alarms += bool(result.group_shifts)
    assert board_alarms <= 4
    assert group_alarms == 0


def test_a_scatter_from_too_few_nights_gives_no_chart() -> None:
    value = np.random.default_rng(10).normal(size=(9, 1))
    variance = np.full(value.shape, 0.01)
    assert np.isinf(ewma_chart(ParameterHistory("b", value, variance)).variance).all()


def test_benjamini_hochberg_agrees_with_scipy() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        p = 2.0 * norm.sf(np.abs(rng.normal(size=300) + 4.0 * (rng.random(300) < 0.05)))
        np.testing.assert_array_equal(benjamini_hochberg(p), false_discovery_control(p) <= 0.01)
    assert not benjamini_hochberg(np.array([np.nan])).any()


def test_a_rig_drifting_with_the_season_does_not_shift_others() -> None:
    """The boards' common slope with temperature is their median: a quarter of them bends none."""
    rng = np.random.default_rng(17)
    nights, boards = 16, 24
    night = np.arange(nights)[:, None]
    rig = np.arange(boards) % 4
    warm = 25.0 + 4.0 * np.sin(night / 4.0) + rng.normal(0.0, 0.5, (nights, boards))
    sigma = 3e-4
    value = rng.normal(0.0, sigma, (nights, boards)) + rng.normal(0.0, 8e-3, boards)
    value += 5e-4 * np.maximum(night - 11, 0) * (rig == 1)
    drift_chart = ewma_chart(
        ParameterHistory("misalignment_x", value, np.full(value.shape, sigma**2), warm)
    )
    ((_, slope_variance),) = drift_chart.slope_variances
    assert abs(drift_chart.slope_per_c[0]) < 4.0 * np.sqrt(slope_variance)
    groupings = [
        Grouping.by_name("rig", [f"rig-{n}" for n in rig]),
        Grouping.by_name("fleet", ["all"] * boards),
    ]
    result, _ = shifted_groups(drift_chart, groupings, 13 * 5)
    assert [(move.kind, move.group) for move in result] == [("rig", "rig-1")]


def test_the_slope_error_counts_for_a_group() -> None:
    """However many boards: the error of a common slope is common to them."""
    rng = np.random.default_rng(18)
    worst = []
    for _ in range(40):
        warm = 25.0 + 0.3 * np.arange(14)[:, None] + rng.normal(0.0, 0.3, (14, 60))
        value = rng.normal(0.0, 1.0, warm.shape) + 0.5 * (warm - 25.0)
        drift_chart = ewma_chart(ParameterHistory("bias_x", value, np.ones(warm.shape), warm))
        weight = 1.0 / drift_chart.variance
        mean = float((weight * drift_chart.shift).sum() / weight.sum())
        lever = float((weight * drift_chart.temperature_offset_c).sum() / weight.sum())
        ((_, slope_variance),) = drift_chart.slope_variances
        worst.append(mean / np.sqrt(1.0 / weight.sum() + lever**2 * slope_variance))
    assert 0.5 < float(np.std(worst)) < 1.5


def season(rng: np.random.Generator) -> np.ndarray:
    """Rooms that follow the season, from 4 degrees below their mean to 4 above."""
    turn = 4.0 * np.sin((np.arange(NIGHTS) - 15.0) / 10.0)[:, None]
    rooms: np.ndarray = 25.0 + turn + rng.normal(0.0, 0.5, (NIGHTS, BOARDS))
    return rooms


def test_boards_with_different_slopes_are_not_drifting() -> None:
    """20 fleets of nothing: a false-discovery rate of 1 % is one fleet in a hundred.

    What is left after the kind's slope is the board's own difference times how warm it is; with
    that taken out of the variance again, as it once was, boards are told by the dozen.
    """
    rng = np.random.default_rng(31)
    fleets, without, spreads = 0, 0, []
    for _ in range(20):
        nights, warm = quiet(rng), season(rng)
        nights.value[:] += (0.7 + rng.normal(0.0, 0.5, BOARDS)) * (warm - 25.0)
        drift_chart = ewma_chart(ParameterHistory("bias_x", nights.value, nights.variance, warm))
        fleets += bool(benjamini_hochberg(board_p_values([drift_chart])).any())
        spreads.append(float(drift_chart.slope_spread[0]))
        bare = (
            drift_chart.variance
            - (drift_chart.temperature_offset_c * drift_chart.slope_spread) ** 2
        )
        without += int(
            benjamini_hochberg(2.0 * norm.sf(np.abs(drift_chart.shift) / np.sqrt(bare))).sum()
        )
        assert not moves(drift_chart)
    assert fleets <= 2
    assert without > 20 * 24
    assert np.mean(spreads) == pytest.approx(0.5, rel=0.1)


def test_a_drift_is_found_among_boards_with_different_slopes() -> None:
    rng = np.random.default_rng(32)
    nights, warm = quiet(rng), season(rng)
    nights.value[:] += rng.normal(0.0, 0.5, BOARDS) * (warm - 25.0)
    nights.value[12:, 77] += 60.0
    drift_chart = ewma_chart(ParameterHistory("bias_x", nights.value, nights.variance, warm))
    assert list(np.flatnonzero(benjamini_hochberg(board_p_values([drift_chart]))[:, 0])) == [77]


def test_each_sensor_has_its_own_slope() -> None:
    rng = np.random.default_rng(33)
    nights, warm = quiet(rng), season(rng)
    kind = (np.arange(BOARDS) % 5 < 2).astype(np.intp)
    nights.value[:] += np.where(kind == 0, 0.7, -0.4) * (warm - 25.0)
    reported = ewma_chart(ParameterHistory("bias_x", nights.value, nights.variance, warm, kind))
    assert reported.slope_per_c == pytest.approx(np.where(kind == 0, 0.7, -0.4), abs=0.05)
    assert float(reported.slope_spread.max()) < 0.1
    assert not benjamini_hochberg(board_p_values([reported])).any()
    # taken for one kind, the season is a drift of those that are fewer
    mixed = ewma_chart(ParameterHistory("bias_x", nights.value, nights.variance, warm))
    assert benjamini_hochberg(board_p_values([mixed])).sum() > 100


def test_sensors_with_few_boards_share_a_slope() -> None:
    rng = np.random.default_rng(34)
    nights, warm = quiet(rng), season(rng)
    kind = np.where(np.arange(BOARDS) < 12, np.arange(BOARDS) // 3, 4)
    nights.value[:] += 0.7 * (warm - 25.0)
    drift_chart = ewma_chart(ParameterHistory("bias_x", nights.value, nights.variance, warm, kind))
    assert len(drift_chart.slope_variances) == 2
    assert len(set(drift_chart.slope_per_c[:12])) == 1
    assert len(set(drift_chart.slope_per_c)) == 2
