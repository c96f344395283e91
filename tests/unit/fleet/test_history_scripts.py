"""What the page's charts are drawn from: the statistics' own, to a hundredth of a deviation."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS, FleetOverview, build_overview
from gyrorig_solver.fleet.drift.ewma_charts import HISTORY_NIGHTS, board_tail_probability
from gyrorig_solver.fleet.drift.fleet_overview import read_origins
from gyrorig_solver.fleet.page.history_scripts import (
    STEPS_PER_STD,
    group_charts,
    group_key,
    history_scripts,
    history_shard,
    shared_chart_data,
)
from gyrorig_solver.fleet.store import StoreIndex
from gyrorig_solver.numerics import student_factor

Histories = dict[str, dict[str, Any]]


def read(store: Path, overview: FleetOverview) -> Histories:
    histories: Histories = {}
    shards = dict(history_scripts(StoreIndex(store), overview, group_charts(overview)))
    assert list(shards) == [f"{n:02x}" for n in range(256)]
    for shard, text in shards.items():
        selected = json.loads(f"{{{text}}}")
        assert all(history_shard(name) == shard for name in selected)
        histories |= selected
    return histories


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> tuple[FleetOverview, Histories]:
    store = tmp_path_factory.mktemp("histories") / "store"
    table = write_fleet(
        store,
        FleetPlan(
            boards=60,
            nights=30,
            rig_drift=(3, "misalignment_x", 18, 3e-4),
            board_drift=(17, "scale_y", 15, 6e-4),
            temperature_per_c={"bias_x": 1e-3},
        ),
    )
    overview = build_overview(store, read_origins(table))
    return overview, read(store, overview)


def nights_of(histories: list[Any]) -> tuple[int, np.ndarray, np.ndarray]:
    first, base, _, _, unit, moved, std = histories
    values = [
        np.array([np.nan if value is None else value for value in each]) for each in (moved, std)
    ]
    return first, (base or 0.0) + values[0] * unit / STEPS_PER_STD, values[1] * unit / STEPS_PER_STD


def test_a_boards_chart_agrees_with_the_statistics(fleet: tuple[FleetOverview, Histories]) -> None:
    overview, histories = fleet
    compared, tail_probability = 0, board_tail_probability(overview.charts)
    for index, board in enumerate(overview.boards.board):
        for which, chart in enumerate(overview.charts):
            first, ewma, std = nights_of(histories[board]["chart"][which])
            widening = float(student_factor(chart.degrees_of_freedom, tail_probability)[index])
            unit = float(np.sqrt(chart.variance[index])) * widening
            wanted = chart.baseline[index] + chart.ewma_history[first:, index]
            assert np.isnan(chart.ewma_history[:first, index]).all()
            np.testing.assert_allclose(ewma, wanted, atol=0.006 * unit, rtol=1e-6)
            np.testing.assert_allclose(
                std, chart.ewma_history_std[first:, index] * widening, atol=0.006 * unit
            )
            last = np.flatnonzero(np.isfinite(ewma))[-1]
            assert ewma[last] - chart.baseline[index] == pytest.approx(
                chart.shift[index], abs=0.011 * unit
            )
            assert std[last] == pytest.approx(unit, rel=0.01)
            compared += 1
    assert compared == 60 * len(PARAMETER_COLUMNS)


def test_a_rigs_chart_ends_at_its_reported_score(
    fleet: tuple[FleetOverview, Histories],
) -> None:
    overview, histories = fleet
    (move,) = [group_shift for group_shift in overview.group_shifts if group_shift.kind == "rig"]
    chart = histories[group_key("rig", "rig-3")]["chart"][PARAMETER_COLUMNS.index("misalignment_x")]
    _, ewma, std = nights_of(chart)
    assert ewma[-1] == pytest.approx(move.shift, rel=0.02)
    assert ewma[-1] / std[-1] == pytest.approx(move.z, rel=0.02)
    assert abs(ewma[-1] / std[-1]) > shared_chart_data(overview)["limits"]["group"]
    score = group_charts(overview)[group_key("rig", "rig-3")].z["misalignment_x"]
    assert score == pytest.approx(move.z, abs=0.01)
    kinds = {key.partition(":")[0] for key in histories if ":" in key}
    assert kinds == {"rig", "lot", "site"}


def test_groups_that_share_boards_with_a_drifting_rig_have_not_shifted(
    fleet: tuple[FleetOverview, Histories],
) -> None:
    """Its move is taken off its boards in the charts of lots and sites."""
    overview, _ = fleet
    charts, limit = group_charts(overview), shared_chart_data(overview)["limits"]["group"]
    beyond = {key for key, chart in charts.items() if abs(chart.z["misalignment_x"] or 0.0) > limit}
    assert beyond == {group_key("rig", "rig-3")}
    # a lot half of whose boards were measured on it
    assert abs(charts[group_key("lot", "lot-3")].z["misalignment_x"] or 0.0) < 4.0


def test_the_alarm_limit_separates_drifting_boards(fleet: tuple[FleetOverview, Histories]) -> None:
    overview, _ = fleet
    limit = shared_chart_data(overview)["limits"]["board"]
    assert overview.drifting[17, PARAMETER_COLUMNS.index("scale_y")]
    assert (np.abs(overview.drift_z[overview.drifting]) >= limit).all()
    assert (np.abs(overview.drift_z[~overview.drifting]) < limit).all()


def test_temperature_corrected_values_can_be_computed(
    fleet: tuple[FleetOverview, Histories],
) -> None:
    """As the page does it: less the slope times how much warmer it was than the board's mean."""
    overview, histories = fleet
    which = PARAMETER_COLUMNS.index("bias_x")
    shrunk = []
    for board in overview.boards.board:
        _, _, warm, slope, *_ = histories[board]["chart"][which]
        assert slope == pytest.approx(1e-3, rel=0.1)
        points = np.array(
            [[history[2], history[3 + which]] for history in histories[board]["points"]]
        )
        taken = points[:, 1] - slope * (points[:, 0] - warm)
        shrunk.append(taken.std() / points[:, 1].std())
    assert float(np.median(shrunk)) < 0.3  # 3e-3 of season against 4e-4 of a night's scatter


def test_only_the_latest_nights_are_kept(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=9, nights=HISTORY_NIGHTS + 7, measured=1.0))
    overview = build_overview(store)
    histories = read(store, overview)
    assert len(shared_chart_data(overview)["days"]) == HISTORY_NIGHTS
    assert shared_chart_data(overview)["days"][-1] == overview.night_days[-1]
    assert all(len(chart.ewma_history) == HISTORY_NIGHTS for chart in overview.charts)
    first, ewma, _ = nights_of(histories["B000003"]["chart"][0])
    assert first + len(ewma) == HISTORY_NIGHTS
    unit = float(np.sqrt(overview.charts[0].variance[3]))
    wanted = overview.charts[0].baseline[3] + overview.charts[0].shift[3]
    assert ewma[-1] == pytest.approx(wanted, abs=0.011 * unit)


def test_boards_without_a_baseline_have_points_and_no_chart(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=9, nights=2, measured=1.0))
    overview = build_overview(store)
    histories = read(store, overview)
    assert set(histories) == set(overview.boards.board)
    assert all(
        len(history["points"]) == 2 and "chart" not in history for history in histories.values()
    )
