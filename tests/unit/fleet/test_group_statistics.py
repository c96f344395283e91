"""What lots, rigs and sites are like, beside numpy; in JSON and among the page's data."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student
from tests.unit.fleet.conftest import row
from tests.unit.fleet.test_fleet_overview import script

from gyrorig_solver.calibration import create_store
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.store import StoreIndex
from gyrorig_solver.fleet.store.coordination import RowJournal
from gyrorig_solver.storage import Folder

STD = 1e-3
REFUSED = ("lot-a-3", "lot-a-4")  # two boards of one session
LOTS = {"lot-a": 24, "lot-b": 20, "lot-c": 5}
VALUES = {
    name: np.random.default_rng(41 + index).normal(1.0 + 0.02 * index, 2e-3, count)
    for index, (name, count) in enumerate(LOTS.items())
}


@pytest.fixture
def fleet_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Two lots of different mean, and one of too few boards, as `gyrorig fleet --json` has them."""
    create_store(tmp_path / "store")
    rows, lines = [], ["board,lot,site"]
    for lot, values in VALUES.items():
        for index, value in enumerate(values):
            board = f"{lot}-{index}"
            parameters = {"scale_x": float(value), "scale_x_std": STD}
            rows.append(row(board, board=board, sensor="S", rig="r", parameters=parameters))
            lines.append(f"{board},{lot},")
    later = "2026-02-01T02:30:00Z"
    for board in REFUSED:
        rows.append(row("bad", board=board, status="rejected", created=later, rig="r"))
    with RowJournal(Folder(tmp_path / "store"), "night") as journal:
        journal.add(rows)
    StoreIndex(tmp_path / "store").merge_ended_batches()
    (tmp_path / "boards.csv").write_text("\n".join(lines), encoding="utf-8")
    command = ["fleet", str(tmp_path / "store"), "--boards", str(tmp_path / "boards.csv"), "--json"]
    assert run(command) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def groups(fleet_json: dict[str, Any], kind: str) -> dict[str, Any]:
    return {item["name"]: item for item in fleet_json["groups"] if item["kind"] == kind}


def test_mean_and_spread_of_each_lot_agree_with_numpy(fleet_json: dict[str, Any]) -> None:
    entries = groups(fleet_json, "lot")
    assert list(entries) == ["lot-a", "lot-b"]  # five boards say next to nothing of a spread
    for name, item in entries.items():
        values = VALUES[name]
        scale = item["parameters"]["scale_x"]
        assert (item["sensor"], item["boards"], scale["count"]) == ("S", LOTS[name], LOTS[name])
        assert scale["mean"] == pytest.approx(np.mean(values), rel=1e-9)
        spread = np.sqrt(np.var(values, ddof=1) - STD**2)
        assert scale["spread"] == pytest.approx(spread, rel=1e-5)
        std = np.std(values, ddof=1) / np.sqrt(values.size)
        assert scale["mean_std"] == pytest.approx(std, rel=1e-5)


def test_the_difference_of_a_lot_agrees_with_numpy(fleet_json: dict[str, Any]) -> None:
    """By the variance within all lots, as in an analysis of variance."""
    within = sum(float(((v - v.mean()) ** 2).sum()) for v in VALUES.values())
    degrees_of_freedom = sum(LOTS.values()) - len(LOTS)
    variance = within / degrees_of_freedom
    for name, item in groups(fleet_json, "lot").items():
        values = VALUES[name]
        others = np.concatenate([v for other, v in VALUES.items() if other != name])
        t = (values.mean() - others.mean()) / np.sqrt(
            variance * (1 / values.size + 1 / others.size)
        )
        z = norm.ppf(student.cdf(-abs(t), degrees_of_freedom)) * -np.sign(t)
        assert item["parameters"]["scale_x"]["z"] == pytest.approx(z, rel=1e-5)
        assert abs(z) > 10.0


def test_a_single_rig_has_no_z_and_boards_have_their_latest_status(
    fleet_json: dict[str, Any],
) -> None:
    assert groups(fleet_json, "site") == {}
    (rig,) = groups(fleet_json, "rig").values()
    assert rig["parameters"]["scale_x"]["z"] is None
    assert rig["boards"] == sum(LOTS.values())
    assert rig["states"] == {"ok": sum(LOTS.values()) - 2, "rejected": 2}
    assert groups(fleet_json, "lot")["lot-b"]["states"] == {"ok": LOTS["lot-b"]}


def test_boards_of_one_session_are_one_rejected_session(fleet_json: dict[str, Any]) -> None:
    assert [item["what"] for item in fleet_json["worries"]][-1:] == ["1 session rejected"]


def test_the_page_has_the_same_groups(fleet_json: dict[str, Any], tmp_path: Path) -> None:
    (data,) = script(tmp_path / "store" / "fleet" / "data.js", "FLEET")
    for group, selected in zip(data["groups"], fleet_json["groups"], strict=True):
        assert {key: group[key] for key in selected} == selected
