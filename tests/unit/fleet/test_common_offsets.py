"""The same on every unit, or different on each: wrong constants, truncation, clocks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.fleet.parts import ERROR, SCATTER, SPREAD
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.drift import FleetOverview, build_overview, describe_offsets
from gyrorig_solver.fleet.drift.fleet_overview import read_origins
from gyrorig_solver.fleet.page import Alert, fleet_alerts

COUNT_RAD_S = float(np.deg2rad(8.75e-3))  # L3G4200D at 250 dps


def overview_of(tmp_path: Path, **hidden: Any) -> FleetOverview:
    store = tmp_path / "store"
    table = write_fleet(store, FleetPlan(boards=80, nights=4, rigs=4, seed=5, **hidden))
    return build_overview(store, read_origins(table))


def answers(result: FleetOverview) -> dict[tuple[str, str], str]:
    """Return which it is, by kind or rig and parameter."""
    return {
        (item.name, item.result.parameter): item.result.answer for item in result.offset_comparisons
    }


def constants(result: FleetOverview) -> list[Alert]:
    return [item for item in fleet_alerts(result) if item.kind == "constant"]


def test_a_wrong_constant_is_common_and_part_spread_is_different(tmp_path: Path) -> None:
    result = overview_of(tmp_path, constant=("scale_y", 0.14))
    answer_of = answers(result)
    assert answer_of["L3G4200D", "scale_y"] == "same"
    assert answer_of["L3G4200D", "scale_x"] == "different"
    assert "time_offset" not in {name for _, name in answer_of}
    (same, different) = describe_offsets(result.offset_comparisons)
    boards = len(result.boards.board)
    assert same.startswith(f"the same on every unit on {boards} L3G4200D: scale.y (")
    assert different.startswith(f"different on each unit on {boards} L3G4200D: bias.x, ")
    assert "scale.x, scale.z, " in different
    assert "caused by the parts" in different
    (item,) = constants(result)
    assert item.finding.startswith("scale.y is off by +0.1")


def test_equal_parts_are_neither_common_nor_different(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SPREAD, "scale", 0.0)
    monkeypatch.setitem(SCATTER, "scale", 0.0)
    result = overview_of(tmp_path)
    assert answers(result)["L3G4200D", "scale_x"] == "open"
    lines = describe_offsets(result.offset_comparisons)
    assert any("neither common nor different on " in item and "scale.x" in item for item in lines)


def test_a_truncation_is_half_a_count_on_every_axis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of parts that were trimmed at the factory: their biases differ by less than a count."""
    for sizes, size in ((SPREAD, 1e-5), (SCATTER, 5e-6), (ERROR, 5e-6)):
        monkeypatch.setitem(sizes, "bias", size)
    result = overview_of(tmp_path, count_rad_s=COUNT_RAD_S, truncated=True)
    biases = [
        item for item in result.offset_comparisons if item.result.parameter.startswith("bias")
    ]
    assert [item.result.answer for item in biases] == ["same"] * 3
    for bias in biases:
        assert bias.count_size_rad_s == pytest.approx(COUNT_RAD_S)
        assert bias.result.offset / COUNT_RAD_S == pytest.approx(-0.5, abs=0.05)
    (item,) = constants(result)
    assert item.finding.startswith("bias.x, bias.y, bias.z are off by -0.004")
    assert "of one count" in item.reason
    assert "truncating instead of rounding" in item.action
    assert not any(
        "cannot be detected" in line for line in describe_offsets(result.offset_comparisons)
    )


def test_a_truncation_among_different_biases_is_reported_as_hidden(tmp_path: Path) -> None:
    result = overview_of(tmp_path, count_rad_s=COUNT_RAD_S, truncated=True)
    answer_of = answers(result)
    assert [answer_of["L3G4200D", f"bias_{axis}"] for axis in "xyz"] == ["different"] * 3
    assert constants(result) == []
    (line,) = [item for item in describe_offsets(result.offset_comparisons) if "truncation" in item]
    assert line.startswith(
        "truncation of the counts (a bias of 0.0044 deg/s on every axis) cannot be detected on"
    )


def test_boards_with_unknown_count_size_hide_no_truncation(tmp_path: Path) -> None:
    result = overview_of(tmp_path)
    assert not any(item.hides_truncation for item in result.offset_comparisons)


def test_a_hosts_clock_is_off_on_all_boards_of_its_rig(tmp_path: Path) -> None:
    result = overview_of(tmp_path, clock_ppm=10.0, host_ppm={2: 150.0})
    answer_of = answers(result)
    assert answer_of["rig-2", "clock_skew"] == "same"
    assert [answer_of[f"rig-{n}", "clock_skew"] for n in (0, 1, 3)] == ["different"] * 3
    assert answer_of["L3G4200D", "clock_skew"] == "different"
    (item,) = constants(result)
    assert item.finding.startswith("the clocks of all boards of rig-2 are off by -1")
    assert "a common error comes from the host" in item.action
    assert item.search_filter == "rig:rig-2"
    lines = describe_offsets(result.offset_comparisons)
    assert any("the same on every unit on the boards of rig-2 (-1" in line for line in lines)
    assert any("different on each unit on the boards of rig-0 (" in line for line in lines)


def test_a_clock_within_crystal_tolerance_raises_no_alert(tmp_path: Path) -> None:
    result = overview_of(tmp_path, clock_ppm=1.0, host_ppm={2: 30.0})
    assert answers(result)["rig-2", "clock_skew"] == "same"
    assert constants(result) == []


def test_a_sensors_tick_rate_is_off_on_all_rigs(tmp_path: Path) -> None:
    result = overview_of(tmp_path, clock_ppm=10.0, tick_ppm=400.0)
    answer_of = answers(result)
    assert answer_of["L3G4200D", "clock_skew"] == "same"
    assert [answer_of[f"rig-{n}", "clock_skew"] for n in range(4)] == ["different"] * 4
    (item,) = constants(result)
    assert item.finding.startswith("the clock of every L3G4200D is off by +")
    assert "host's clock is not the cause" in item.action
    assert item.search_filter == "sensor:L3G4200D"


def test_different_sensor_clocks_raise_no_alert(tmp_path: Path) -> None:
    result = overview_of(tmp_path, clock_ppm=2000.0)
    answer_of = answers(result)
    assert {answer_of[name, "clock_skew"] for name in ("L3G4200D", "rig-0", "rig-3")} == {
        "different"
    }
    assert constants(result) == []
    kind, rigs = [item for item in describe_offsets(result.offset_comparisons) if "clocks" in item]
    assert kind.startswith("different on each unit on ")
    assert rigs.startswith("different on each unit on the boards of rig-0 (")
    assert rigs.endswith("): clocks (caused by the boards' clocks)")


def test_boards_without_their_own_clock_are_not_tested(tmp_path: Path) -> None:
    assert all(
        item.result.parameter != "clock_skew" for item in overview_of(tmp_path).offset_comparisons
    )
