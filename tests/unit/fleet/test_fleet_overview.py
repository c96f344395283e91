"""A fleet in which something is hidden: told, and nothing else; and its page's data."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.fleet.parts import ERROR
from tests.bench.synthetic_fleet import FleetPlan, write_fleet
from tests.support.quick_cases import quick_cases
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_solver.calibration import create_store
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS, build_overview, fleet_overview
from gyrorig_solver.fleet.drift.fleet_overview import read_origins
from gyrorig_solver.fleet.drift.latest_calibrations import LatestCalibrations, latest_calibrations
from gyrorig_solver.fleet.page import fleet_alerts, write_fleet_page
from gyrorig_solver.fleet.page.history_scripts import history_shard
from gyrorig_solver.fleet.store import StoreIndex
from gyrorig_solver.fleet.store.coordination import RowJournal
from gyrorig_solver.fleet.store.index_rows import IndexRow
from gyrorig_solver.storage import Folder

SLOPES = {"bias_x": 1e-3, "bias_z": -4e-4}


def reported_alerts(tmp_path: Path, **hidden: Any) -> list[tuple[str, str]]:
    store = tmp_path / "store"
    table = write_fleet(store, FleetPlan(temperature_per_c=SLOPES, **hidden))
    return [
        (item.kind, item.finding)
        for item in fleet_alerts(build_overview(store, read_origins(table)))
    ]


@pytest.mark.parametrize("seed", quick_cases([11, 12, 13], [11]))
def test_a_fleet_without_faults_has_no_alerts(tmp_path: Path, seed: int) -> None:
    assert reported_alerts(tmp_path, seed=seed) == []


def test_a_drifting_rig_is_reported_without_its_boards(tmp_path: Path) -> None:
    (item,) = reported_alerts(tmp_path, rig_drift=(3, "misalignment_x", 20, 1.5e-4))
    assert item[0] == "rig"
    assert item[1].startswith("rig-3: misalignment.x has shifted by +0.0")
    assert item[1].endswith(" deg")


def test_a_bad_lot_is_reported_without_its_rigs(tmp_path: Path) -> None:
    (item,) = reported_alerts(tmp_path, bad_lot=(2, "scale_z", 0.015))
    assert item[0] == "lot"
    assert "lot-2 differs in scale.z" in item[1]


def test_a_wrong_constant_is_reported_as_common(tmp_path: Path) -> None:
    (item,) = reported_alerts(
        tmp_path, constant=("scale_y", 16.0 / (900.0 * np.pi / 180.0) * 2 - 1.9)
    )
    assert item[0] == "constant"
    assert "scale.y is off by +0.13" in item[1]


def test_a_drifting_board_and_an_outlier_are_reported_by_name(tmp_path: Path) -> None:
    result = reported_alerts(
        tmp_path, board_drift=(17, "scale_y", 15, 4e-4), odd_board=(33, "scale_x", 0.08)
    )
    assert [kind for kind, _ in result] == ["drift", "odd"]
    assert "B000017" in result[0][1]
    assert "B000033" in result[1][1]


def test_refused_calibrations_do_not_count(tmp_path: Path) -> None:
    faults = {"board_drift": (17, "scale_y", 25, 0.05), "odd_board": (17, "scale_x", 0.3)}
    result = reported_alerts(tmp_path, boards=60, refused_board=17, **faults)
    assert [kind for kind, _ in result] == ["trust"]


def test_a_store_without_calibrations_is_not_an_error(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=2, nights=1, measured=0.0))
    result = build_overview(store)
    assert fleet_alerts(result) == []
    assert Path(write_fleet_page(store, result)).is_file()


def write_rows(store: Path, *rows: IndexRow) -> None:
    create_store(store)
    with RowJournal(Folder(store), "night") as journal:
        journal.add(rows)
    StoreIndex(store).merge_ended_batches()


def test_only_the_newest_outcome_of_the_same_recordings_counts(tmp_path: Path) -> None:
    later = {"created": "2026-03-01T02:30:00Z"}
    write_rows(
        tmp_path,
        row("a", inputs=["1", "2"], status="rejected"),
        row("b", inputs=["2", "1"], board="B1", **later),
        row("c", inputs=["3"], status="failed"),
        row("d", inputs=["3"], status="rejected", **later),
        row("e", inputs=["4"], board="B2"),
        row("f", inputs=["4"], status="failed", **later),
    )
    assert build_overview(tmp_path).unsuccessful == [("failed", 1), ("rejected", 1)]


def test_a_batch_can_add_boards_meanwhile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store, new = tmp_path / "store", tmp_path / "new"
    write_fleet(store, FleetPlan(boards=10, nights=6))
    write_fleet(new, FleetPlan(boards=12, nights=6))

    def latest_before_a_batch(*args: Any) -> LatestCalibrations:
        boards = latest_calibrations(*args)
        shutil.copy(new / "index" / "synthetic-0000.parquet", store / "index" / "added.parquet")
        return boards

    monkeypatch.setattr(fleet_overview, "latest_calibrations", latest_before_a_batch)
    assert len(build_overview(store).boards.board) == 10


def test_a_changed_configuration_begins_a_new_baseline(tmp_path: Path) -> None:
    """A smaller bandwidth moves the time offset by 4 ms; the board does not drift."""
    rng = np.random.default_rng(51)
    rows = []
    for night in range(1, 27):
        for number in range(8):
            is_changed = night > 12 and number == 3
            offset = 4e-3 * is_changed + float(rng.normal(0.0, 1e-4))
            rows.append(
                row(
                    f"{night}-{number}",
                    inputs=[f"{night}-{number}"],
                    board=f"B{number}",
                    sensor="S",
                    config_hash="new" if is_changed else "old",
                    start=f"2026-01-{night:02d}T02:00:00Z",
                    version=night,
                    file=f"B{number}/{night}",
                    parameters={"time_offset": offset, "time_offset_std": 1e-4},
                )
            )
    write_rows(tmp_path, *rows)
    overview = build_overview(tmp_path)
    assert not overview.drifting.any()
    chart = overview.charts[PARAMETER_COLUMNS.index("time_offset")]
    assert np.isfinite(chart.variance).all()
    assert chart.baseline[3] == pytest.approx(4e-3, abs=2e-4)


def script(path: Path, function: str) -> list[Any]:
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"{function}(")
    return list(json.loads("[" + text[len(function) + 1 : -3] + "]"))


def test_the_page_contains_every_board_and_its_history(tmp_path: Path) -> None:
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
    shard, history = script(folder / "history" / f"{history_shard('B000005')}.js", "HISTORY")
    assert shard == history_shard("B000005")
    item = history["B000005"]
    version, seconds, temperature, *values = item["points"][-1]
    assert version == boards["version"][5]
    assert (seconds > 1.7e9, 15.0 < temperature < 35.0) == (True, True)
    assert len(values) == len(item["std"]) == len(item["shrunk"]) == len(PARAMETER_COLUMNS)
    assert all(0.0 < std < 1e-3 for std in item["std"])


def test_a_hostile_name_cannot_end_a_script(tmp_path: Path) -> None:
    store = tmp_path / "store"
    write_fleet(store, FleetPlan(boards=10, nights=2))
    table = tmp_path / "boards.csv"
    table.write_text("board,lot\nB000001,</script><script>alert(1)\n", encoding="utf-8")
    write_fleet_page(store, build_overview(store, read_origins(table)))
    text = (store / "fleet" / "data.js").read_text(encoding="utf-8")
    assert "</script" not in text
    assert "alert(1)" in text


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe", "not a text in UTF-8"),
        (b"a,b\n1,2\n", "no column `board`"),
        (b"board\n../x\n", "not a valid board name"),
        (
            b"board,lot\nGY-1,7\n,8\n",
            r"line 3 of the table of boards .*t\.csv has '' in the column",
        ),
        (b"board\n" + 200_000 * b"x" + b"\n", "field larger than field limit"),
    ],
)
def test_invalid_tables_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_origins(tmp_path / "t.csv")


def test_spaces_around_names_do_not_matter(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("board, lot , site\n\na , 7, here\n,,\n")
    origins = read_origins(tmp_path / "t.csv")
    assert (origins.lot, origins.site) == ({"a": "7"}, {"a": "here"})


def test_a_missing_table_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_origins(tmp_path / "t.csv")


def test_uncertain_parameters_are_reported_as_prior_dominated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ERROR, "time", 1e-2)  # ten times what boards differ by
    (item,) = reported_alerts(tmp_path, seed=21)
    assert item[0] == "prior"
    assert item[1] == (
        "the calibrations of 200 of 200 L3G4200D determine time_offset worse than the fleet's mean "
        "does"
    )
