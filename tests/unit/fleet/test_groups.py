"""What lots, rigs and sites are like, beside numpy; in JSON and among the page's data."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.fleet.conftest import row
from tests.unit.fleet.test_overview import script

from gyrorig_solver.calibration.store import make_sharded
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import Journal

STD = 1e-3
LOTS = {"lot-a": 24, "lot-b": 20, "lot-c": 5}
VALUES = {
    name: np.random.default_rng(41 + at).normal(1.0 + 0.02 * at, 2e-3, count)
    for at, (name, count) in enumerate(LOTS.items())
}


@pytest.fixture
def told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Two lots of different mean, and one of too few boards, as `gyrorig fleet --json` has them."""
    make_sharded(tmp_path / "store")
    rows, lines = [], ["board,lot,site"]
    for lot, values in VALUES.items():
        for at, value in enumerate(values):
            board = f"{lot}-{at}"
            found = {"scale_x": float(value), "scale_x_std": STD}
            rows.append(row(board, board=board, sensor="S", rig="r", parameters=found))
            lines.append(f"{board},{lot},")
    later = "2026-02-01T02:30:00Z"
    rows.append(row("bad", board="lot-a-3", status="rejected", created=later, rig="r"))
    with Journal(tmp_path / "store", "night") as journal:
        journal.add(rows)
    Index(tmp_path / "store").fold_left_behind()
    (tmp_path / "boards.csv").write_text("\n".join(lines), encoding="utf-8")
    command = ["fleet", str(tmp_path / "store"), "--boards", str(tmp_path / "boards.csv"), "--json"]
    assert run(command) == 0
    found_: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found_


def groups(told: dict[str, Any], kind: str) -> dict[str, Any]:
    return {one["name"]: one for one in told["groups"] if one["kind"] == kind}


def test_mean_and_spread_of_each_lot_are_numpys(told: dict[str, Any]) -> None:
    found = groups(told, "lot")
    assert list(found) == ["lot-a", "lot-b"]  # five boards say next to nothing of a spread
    for name, one in found.items():
        values = VALUES[name]
        scale = one["parameters"]["scale_x"]
        assert (one["sensor"], one["boards"], scale["count"]) == ("S", LOTS[name], LOTS[name])
        assert scale["mean"] == pytest.approx(np.mean(values), rel=1e-9)
        spread = np.sqrt(np.var(values, ddof=1) - STD**2)
        assert scale["spread"] == pytest.approx(spread, rel=1e-5)
        std = np.std(values, ddof=1) / np.sqrt(values.size)
        assert scale["mean_std"] == pytest.approx(std, rel=1e-5)


def test_how_far_a_lot_is_from_the_others_is_numpys(told: dict[str, Any]) -> None:
    """By the variance within all lots, as in an analysis of variance."""
    within = sum(float(((v - v.mean()) ** 2).sum()) for v in VALUES.values())
    variance = within / (sum(LOTS.values()) - len(LOTS))
    for name, one in groups(told, "lot").items():
        own = VALUES[name]
        others = np.concatenate([v for other, v in VALUES.items() if other != name])
        z = (own.mean() - others.mean()) / np.sqrt(variance * (1 / own.size + 1 / others.size))
        assert one["parameters"]["scale_x"]["z"] == pytest.approx(z, rel=1e-5)
        assert abs(z) > 10.0


def test_the_only_rig_has_no_others_and_boards_have_the_state_of_their_latest_work(
    told: dict[str, Any],
) -> None:
    assert groups(told, "site") == {}
    (rig,) = groups(told, "rig").values()
    assert rig["parameters"]["scale_x"]["z"] is None
    assert rig["boards"] == sum(LOTS.values())
    assert rig["states"] == {"ok": sum(LOTS.values()) - 1, "rejected": 1}
    assert groups(told, "lot")["lot-b"]["states"] == {"ok": LOTS["lot-b"]}


def test_the_page_has_the_same_groups(told: dict[str, Any], tmp_path: Path) -> None:
    (data,) = script(tmp_path / "store" / "fleet" / "data.js", "FLEET")
    for there, here in zip(data["groups"], told["groups"], strict=True):
        assert {key: there[key] for key in here} == here
