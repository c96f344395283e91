"""The same on every unit, or different on each: wrong constants, truncation, clocks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.fleet.parts import ERROR, SCATTER, SPREAD
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_solver.fleet.constants import in_words
from gyrorig_solver.fleet.overview import Overview, overview, read_origins
from gyrorig_solver.fleet.worries import Worry, worries

COUNT_RAD_S = float(np.deg2rad(8.75e-3))  # L3G4200D at 250 dps


def asked(tmp_path: Path, **hidden: Any) -> Overview:
    store = tmp_path / "store"
    table = write_fleet(store, FleetPlan(boards=80, nights=4, rigs=4, seed=5, **hidden))
    return overview(store, read_origins(table))


def answers(found: Overview) -> dict[tuple[str, str], str]:
    """Return which it is, by kind or rig and parameter."""
    return {(one.name, one.told.parameter): one.told.answer for one in found.constants}


def constants(found: Overview) -> list[Worry]:
    return [one for one in worries(found) if one.kind == "constant"]


def test_a_wrong_constant_is_the_same_and_what_parts_do_is_different(tmp_path: Path) -> None:
    found = asked(tmp_path, constant=("scale_y", 0.14))
    told = answers(found)
    assert told["L3G4200D", "scale_y"] == "same"
    assert told["L3G4200D", "scale_x"] == "different"
    assert "time_offset" not in {name for _, name in told}
    (same, different) = in_words(found.constants)
    boards = len(found.boards.board)
    assert same.startswith(f"the same on every unit on {boards} L3G4200D: scale y;")
    assert different.startswith(f"different per unit on {boards} L3G4200D: bias x, ")
    assert "scale x, scale z, " in different
    assert "the parts' own" in different
    (one,) = constants(found)
    assert one.what.startswith("scale y is off by +0.1")


def test_parts_that_do_not_differ_are_said_to_be_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(SPREAD, "scale", 0.0)
    monkeypatch.setitem(SCATTER, "scale", 0.0)
    found = asked(tmp_path)
    assert answers(found)["L3G4200D", "scale_x"] == "open"
    lines = in_words(found.constants)
    assert any("neither off nor different on " in one and "scale x" in one for one in lines)


def test_a_truncation_is_half_a_count_on_every_axis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of parts that were trimmed at the factory: their biases differ by less than a count."""
    for sizes, size in ((SPREAD, 1e-5), (SCATTER, 5e-6), (ERROR, 5e-6)):
        monkeypatch.setitem(sizes, "bias", size)
    found = asked(tmp_path, count_rad_s=COUNT_RAD_S, truncated=True)
    biases = [one for one in found.constants if one.told.parameter.startswith("bias")]
    assert [one.told.answer for one in biases] == ["same"] * 3
    for bias in biases:
        assert bias.count_rad_s == pytest.approx(COUNT_RAD_S)
        assert bias.told.offset / COUNT_RAD_S == pytest.approx(-0.5, abs=0.05)
    (one,) = constants(found)
    assert one.what.startswith("bias x and bias y and bias z are off by -7.")
    assert "of a count" in one.why
    assert "cut off instead of rounded" in one.do
    assert not any("could not be told" in line for line in in_words(found.constants))


def test_a_truncation_beside_biases_that_differ_is_said_not_to_be_seen(tmp_path: Path) -> None:
    found = asked(tmp_path, count_rad_s=COUNT_RAD_S, truncated=True)
    told = answers(found)
    assert [told["L3G4200D", f"bias_{axis}"] for axis in "xyz"] == ["different"] * 3
    assert constants(found) == []
    (line,) = [one for one in in_words(found.constants) if "truncation" in one]
    assert line.startswith("a truncation, 7.6e-05 rad/s on every axis, could not be told on")


def test_boards_whose_count_is_not_known_are_not_said_to_hide_one(tmp_path: Path) -> None:
    found = asked(tmp_path)
    assert not any(one.hides_truncation for one in found.constants)


def test_a_hosts_clock_is_off_on_all_boards_of_its_rig(tmp_path: Path) -> None:
    found = asked(tmp_path, clock_ppm=10.0, host_ppm={2: 150.0})
    told = answers(found)
    assert told["rig-2", "clock_skew"] == "same"
    assert [told[f"rig-{n}", "clock_skew"] for n in (0, 1, 3)] == ["different"] * 3
    assert told["L3G4200D", "clock_skew"] == "different"
    (one,) = constants(found)
    assert one.what.startswith("the clocks of all boards of rig-2 are off by -1")
    assert "it is the host's" in one.do
    assert one.find == "rig:rig-2"
    lines = in_words(found.constants)
    assert any("the same on every unit on the boards of rig-2 (-1" in line for line in lines)
    assert any("different per unit on the boards of rig-0 (" in line for line in lines)


def test_a_clock_as_good_as_crystals_are_is_told_and_no_worry(tmp_path: Path) -> None:
    found = asked(tmp_path, clock_ppm=1.0, host_ppm={2: 30.0})
    assert answers(found)["rig-2", "clock_skew"] == "same"
    assert constants(found) == []


def test_a_kinds_tick_rate_is_off_on_all_rigs(tmp_path: Path) -> None:
    found = asked(tmp_path, clock_ppm=10.0, tick_ppm=400.0)
    told = answers(found)
    assert told["L3G4200D", "clock_skew"] == "same"
    assert [told[f"rig-{n}", "clock_skew"] for n in range(4)] == ["different"] * 4
    (one,) = constants(found)
    assert one.what.startswith("the clock of every L3G4200D is off by +")
    assert "no host's" in one.do
    assert one.find == "sensor:L3G4200D"


def test_sensors_own_clocks_are_different_and_no_worry(tmp_path: Path) -> None:
    found = asked(tmp_path, clock_ppm=2000.0)
    told = answers(found)
    assert {told[name, "clock_skew"] for name in ("L3G4200D", "rig-0", "rig-3")} == {"different"}
    assert constants(found) == []
    kind, rigs = [one for one in in_words(found.constants) if "clocks" in one]
    assert kind.startswith("different per unit on ")
    assert rigs.startswith("different per unit on the boards of rig-0 (")
    assert rigs.endswith("): clocks; the boards' own, no host's")


def test_boards_without_a_clock_of_their_own_are_not_asked(tmp_path: Path) -> None:
    assert all(one.told.parameter != "clock_skew" for one in asked(tmp_path).constants)
