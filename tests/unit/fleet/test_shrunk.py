"""Shrunk values lie beside the calibrations, are never changed, and never come back."""

from pathlib import Path

import duckdb
import numpy as np
import pytest
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_protocol.errors import InputError
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.overview import PARAMETERS, overview
from gyrorig_solver.fleet.shrunk import FOLDER, keep_shrunk, shrunk_of
from gyrorig_solver.places.choose import place_at


@pytest.fixture
def store(tmp_path: Path) -> Path:
    write_fleet(tmp_path / "store", FleetPlan(boards=40, nights=4, seed=6))
    return tmp_path / "store"


def test_they_are_kept_once_and_are_those_of_the_overview(store: Path) -> None:
    found = overview(store)
    name = keep_shrunk(store, found)
    assert name is not None
    path = store / name
    assert path.parent == store / FOLDER
    before = path.read_bytes()
    assert keep_shrunk(store, found) == name
    assert path.read_bytes() == before
    assert len(list((store / FOLDER).iterdir())) == 1
    told = shrunk_of(store, "B000007")
    assert tuple(told) == PARAMETERS
    at = PARAMETERS.index("scale_x")
    assert told["scale_x"].value == found.shrunk[7, at]
    assert told["scale_x"].std == found.shrunk_std[7, at]
    assert shrunk_of(store, "nobody") == {}


def test_they_never_feed_the_prior(store: Path) -> None:
    first = overview(store)
    keep_shrunk(store, first)
    again = overview(store)
    assert np.array_equal(first.shrunk, again.shrunk, equal_nan=True)
    assert first.boards.value["bias_x"].tolist() == again.boards.value["bias_x"].tolist()
    for key, one in first.populations.items():
        assert (one.mean, one.spread) == (
            again.populations[key].mean,
            again.populations[key].spread,
        )


def test_what_is_more_the_fleets_than_its_own_is_named(store: Path, tmp_path: Path) -> None:
    parquet = next((store / "index").glob("*.parquet"))
    loose = tmp_path / "loose.parquet"
    wide = "CASE WHEN board = 'B000003' THEN 1.0 ELSE time_offset_std END AS time_offset_std"
    sql = f"COPY (SELECT * REPLACE ({wide}) FROM '{parquet}') TO '{loose}' (FORMAT parquet)"  # noqa: S608
    with duckdb.connect(":memory:") as database:
        database.execute(sql)
    loose.replace(parquet)
    found = overview(store)
    name = keep_shrunk(store, found)
    told = shrunk_of(store, "B000003")
    assert told["time_offset"].prior_dominated
    assert not told["scale_x"].prior_dominated
    sql = f"SELECT board FROM '{store}/{name}' WHERE list_contains(prior_dominated, 'time_offset')"  # noqa: S608
    with duckdb.connect(":memory:") as database:
        rows = database.execute(sql).fetchall()
    assert rows == [("B000003",)]


def test_a_fleet_of_few_has_none_and_a_damaged_file_is_said(tmp_path: Path, store: Path) -> None:
    write_fleet(tmp_path / "few", FleetPlan(boards=3, nights=2))
    assert keep_shrunk(tmp_path / "few", overview(tmp_path / "few")) is None
    assert shrunk_of(tmp_path / "few", "B000001") == {}
    name = keep_shrunk(store, overview(store))
    assert name is not None
    (store / name).write_bytes(b"PAR1")
    with pytest.raises(InputError, match="makes it anew"):
        shrunk_of(store, "B000001")


def test_a_fleet_in_a_bucket_has_its_page_and_its_shrunk_values_there(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    bucket = place_at(f"memory://{tmp_path.name}/fleet")
    for path in store.rglob("*"):
        if path.is_file():
            bucket.put(str(path.relative_to(store)), path.read_bytes())
    assert run(["fleet", bucket.text]) == 0
    said = capsys.readouterr().out
    assert f"the page: {bucket.text}/fleet/index.html" in said
    names = {entry.name for entry in bucket.entries()}
    assert {"fleet/index.html", "fleet/app.js", "fleet/data.js", "fleet/history/00.js"} <= names
    assert tuple(shrunk_of(bucket, "B000007")) == PARAMETERS
    assert run(["fleet", bucket.text, "--out", str(tmp_path / "page")]) == 0
    assert (tmp_path / "page" / "data.js").read_bytes().count(bucket.text.encode()) == 1
