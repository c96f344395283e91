"""What the page's charts are drawn from: the statistics' own, to a hundredth of a deviation."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.charts import HISTORY_NIGHTS
from gyrorig_solver.fleet.histories import (
    PER_DEVIATION,
    drawn,
    group_charts,
    group_key,
    histories,
    shard_of,
)
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.overview import PARAMETERS, Overview, overview, read_origins

Told = dict[str, dict[str, Any]]


def read(store: Path, found: Overview) -> Told:
    told: Told = {}
    shards = dict(histories(Index(store), found, group_charts(found)))
    assert list(shards) == [f"{n:02x}" for n in range(256)]
    for shard, text in shards.items():
        here = json.loads(f"{{{text}}}")
        assert all(shard_of(name) == shard for name in here)
        told |= here
    return told


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Overview, Told]:
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
    found = overview(store, read_origins(table))
    return found, read(store, found)


def nights_of(told: list[Any]) -> tuple[int, np.ndarray, np.ndarray]:
    first, base, _, _, unit, moved, std = told
    values = [np.array([np.nan if one is None else one for one in each]) for each in (moved, std)]
    return first, (base or 0.0) + values[0] * unit / PER_DEVIATION, values[1] * unit / PER_DEVIATION


def test_a_boards_chart_is_that_of_the_statistics(fleet: tuple[Overview, Told]) -> None:
    found, told = fleet
    compared = 0
    for at, board in enumerate(found.boards.board):
        for which, one in enumerate(found.charts):
            first, ewma, std = nights_of(told[board]["chart"][which])
            unit = float(np.sqrt(one.variance[at]))
            wanted = one.base[at] + one.history[first:, at]
            assert np.isnan(one.history[:first, at]).all()
            np.testing.assert_allclose(ewma, wanted, atol=0.006 * unit, rtol=1e-6)
            np.testing.assert_allclose(std, one.history_std[first:, at], atol=0.006 * unit)
            last = np.flatnonzero(np.isfinite(ewma))[-1]
            assert ewma[last] - one.base[at] == pytest.approx(one.moved[at], abs=0.011 * unit)
            assert std[last] == pytest.approx(unit, rel=0.01)
            compared += 1
    assert compared == 60 * len(PARAMETERS)


def test_a_rigs_chart_ends_at_the_score_that_it_is_told_by(fleet: tuple[Overview, Told]) -> None:
    found, told = fleet
    (move,) = [one for one in found.moved if one.kind == "rig"]
    chart = told[group_key("rig", "rig-3")]["chart"][PARAMETERS.index("misalignment_x")]
    _, ewma, std = nights_of(chart)
    assert ewma[-1] == pytest.approx(move.moved, rel=0.02)
    assert ewma[-1] / std[-1] == pytest.approx(move.z, rel=0.02)
    assert abs(ewma[-1] / std[-1]) > drawn(found)["limits"]["group"]
    score = group_charts(found)[group_key("rig", "rig-3")].z["misalignment_x"]
    assert score == pytest.approx(move.z, abs=0.01)
    kinds = {key.partition(":")[0] for key in told if ":" in key}
    assert kinds == {"rig", "lot", "site"}


def test_who_shares_boards_with_a_drifting_rig_has_not_moved(
    fleet: tuple[Overview, Told],
) -> None:
    """Its move is taken off its boards in the charts of lots and sites."""
    found, _ = fleet
    charts, limit = group_charts(found), drawn(found)["limits"]["group"]
    beyond = {key for key, one in charts.items() if abs(one.z["misalignment_x"] or 0.0) > limit}
    assert beyond == {group_key("rig", "rig-3")}
    # a lot half of whose boards were measured on it
    assert abs(charts[group_key("lot", "lot-3")].z["misalignment_x"] or 0.0) < 4.0


def test_the_limit_parts_what_is_told_from_what_is_not(fleet: tuple[Overview, Told]) -> None:
    found, _ = fleet
    limit = drawn(found)["limits"]["board"]
    assert found.drifting[17, PARAMETERS.index("scale_y")]
    assert (np.abs(found.drift_z[found.drifting]) >= limit).all()
    assert (np.abs(found.drift_z[~found.drifting]) < limit).all()


def test_what_a_value_is_without_temperature_can_be_told(fleet: tuple[Overview, Told]) -> None:
    """As the page does it: less the slope times how much warmer it was than the board's mean."""
    found, told = fleet
    which = PARAMETERS.index("bias_x")
    shrunk = []
    for board in found.boards.board:
        _, _, warm, slope, *_ = told[board]["chart"][which]
        assert slope == pytest.approx(1e-3, rel=0.1)
        points = np.array([[one[2], one[3 + which]] for one in told[board]["points"]])
        taken = points[:, 1] - slope * (points[:, 0] - warm)
        shrunk.append(taken.std() / points[:, 1].std())
    assert float(np.median(shrunk)) < 0.3  # 3e-3 of season against 4e-4 of a night's scatter


def test_only_the_latest_nights_are_kept(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=9, nights=HISTORY_NIGHTS + 7, measured=1.0))
    found = overview(store)
    told = read(store, found)
    assert len(drawn(found)["days"]) == HISTORY_NIGHTS
    assert drawn(found)["days"][-1] == found.days[-1]
    assert all(len(one.history) == HISTORY_NIGHTS for one in found.charts)
    first, ewma, _ = nights_of(told["B000003"]["chart"][0])
    assert first + len(ewma) == HISTORY_NIGHTS
    unit = float(np.sqrt(found.charts[0].variance[3]))
    wanted = found.charts[0].base[3] + found.charts[0].moved[3]
    assert ewma[-1] == pytest.approx(wanted, abs=0.011 * unit)


def test_boards_without_a_baseline_have_points_and_no_chart(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=9, nights=2, measured=1.0))
    found = overview(store)
    told = read(store, found)
    assert set(told) == set(found.boards.board)
    assert all(len(one["points"]) == 2 and "chart" not in one for one in told.values())
