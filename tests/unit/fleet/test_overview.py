"""A fleet in which something is hidden: told, and nothing else; and its page's data."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.fleet.parts import ERROR
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.histories import shard_of
from gyrorig_solver.fleet.overview import PARAMETERS, overview, read_origins
from gyrorig_solver.fleet.page import write_page
from gyrorig_solver.fleet.worries import worries

SLOPES = {"bias_x": 1e-3, "bias_z": -4e-4}


def told(tmp_path: Path, **hidden: Any) -> list[tuple[str, str]]:
    store = tmp_path / "store"
    table = write_fleet(store, FleetPlan(temperature_per_c=SLOPES, **hidden))
    return [(one.kind, one.what) for one in worries(overview(store, read_origins(table)))]


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_a_fleet_in_which_nothing_is_hidden_says_so(tmp_path: Path, seed: int) -> None:
    assert told(tmp_path, seed=seed) == []


def test_a_drifting_rig_is_told_and_no_board_of_it(tmp_path: Path) -> None:
    (one,) = told(tmp_path, rig_drift=(3, "misalignment_x", 20, 1.5e-4))
    assert one[0] == "rig"
    assert one[1].startswith("rig-3 has moved misalignment x by +0.00")
    assert one[1].endswith(" rad")


def test_a_bad_lot_is_told_and_none_of_its_rigs(tmp_path: Path) -> None:
    (one,) = told(tmp_path, bad_lot=(2, "scale_z", 0.015))
    assert one[0] == "lot"
    assert "lot-2 differs in scale z" in one[1]


def test_a_wrong_constant_is_told_as_one(tmp_path: Path) -> None:
    (one,) = told(tmp_path, constant=("scale_y", 16.0 / (900.0 * np.pi / 180.0) * 2 - 1.9))
    assert one[0] == "constant"
    assert "scale y is off by +0.13" in one[1]


def test_a_drifting_board_and_an_odd_one_are_told_by_name(tmp_path: Path) -> None:
    found = told(tmp_path, board_drift=(17, "scale_y", 15, 4e-4), odd_board=(33, "scale_x", 0.08))
    assert [kind for kind, _ in found] == ["drift", "odd"]
    assert "B000017" in found[0][1]
    assert "B000033" in found[1][1]


def test_a_store_without_calibrations_is_no_fault(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=2, nights=1, measured=0.0))
    found = overview(store)
    assert worries(found) == []
    assert Path(write_page(store, found)).is_file()


def script(path: Path, function: str) -> list[Any]:
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"{function}(")
    return list(json.loads("[" + text[len(function) + 1 : -3] + "]"))


def test_the_page_holds_every_board_and_its_history(tmp_path: Path) -> None:
    store = tmp_path / "store"
    table = write_fleet(store, FleetPlan(boards=40, nights=6))
    assert run(["fleet", str(store), "--boards", str(table)]) == 0
    folder = store / "fleet"
    (data,) = script(folder / "data.js", "FLEET")
    boards = data["boards"]
    assert len(boards["id"]) == 40
    assert {len(column) for column in boards["value"].values()} == {40}
    assert data["up"] == "../"
    assert boards["file"][0].startswith("calib/")
    shard, history = script(folder / "history" / f"{shard_of('B000005')}.js", "HISTORY")
    assert shard == shard_of("B000005")
    one = history["B000005"]
    version, seconds, temperature, *values = one["points"][-1]
    assert version == boards["version"][5]
    assert (seconds > 1.7e9, 15.0 < temperature < 35.0) == (True, True)
    assert len(values) == len(one["std"]) == len(one["shrunk"]) == len(PARAMETERS)
    assert all(0.0 < std < 1e-3 for std in one["std"])


def test_a_hostile_name_ends_no_script(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=10, nights=2))
    table = tmp_path / "boards.csv"
    table.write_text("board,lot\nB000001,</script><script>alert(1)\n", encoding="utf-8")
    write_page(store, overview(store, read_origins(table)))
    text = (store / "fleet" / "data.js").read_text(encoding="utf-8")
    assert "</script" not in text
    assert "alert(1)" in text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe", "no text"),
        (b"a,b\n1,2\n", "no column board"),
        (b"board\n../x\n", "no board name"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_origins(tmp_path / "t.csv")


def test_a_table_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_origins(tmp_path / "t.csv")


def test_what_calibrations_leave_open_is_said_to_be_the_fleets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ERROR, "time", 1e-2)  # ten times what boards differ by
    (one,) = told(tmp_path, seed=21)
    assert one[0] == "prior"
    assert one[1] == "time offset of 200 of 200 L3G4200D says less than the fleet"
