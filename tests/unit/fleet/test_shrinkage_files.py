"""Shrunk values lie beside the calibrations, are never changed, and never come back."""

from pathlib import Path

import duckdb
import numpy as np
import pytest
from tests.bench.synthetic_fleet import FleetPlan, write_fleet

from gyrorig_protocol.errors import InputError
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS, build_overview
from gyrorig_solver.fleet.drift.shrinkage_files import (
    SHRINKAGE_FOLDER,
    read_shrinkage_estimates,
    write_shrinkage_estimates,
)
from gyrorig_solver.storage import storage_at


@pytest.fixture
def store(tmp_path: Path) -> Path:
    write_fleet(tmp_path / "store", FleetPlan(boards=40, nights=4, seed=6))
    return tmp_path / "store"


def test_estimates_are_written_once_and_agree_with_the_overview(store: Path) -> None:
    overview = build_overview(store)
    name = write_shrinkage_estimates(store, overview)
    assert name is not None
    path = store / name
    assert path.parent == store / SHRINKAGE_FOLDER
    before = path.read_bytes()
    assert write_shrinkage_estimates(store, overview) == name
    assert path.read_bytes() == before
    assert len(list((store / SHRINKAGE_FOLDER).iterdir())) == 1
    estimates = read_shrinkage_estimates(store, "B000007")
    assert tuple(estimates) == PARAMETER_COLUMNS
    index = PARAMETER_COLUMNS.index("scale_x")
    assert estimates["scale_x"].value == overview.shrunk[7, index]
    assert estimates["scale_x"].std == overview.shrunk_std[7, index]
    assert read_shrinkage_estimates(store, "nobody") == {}


def test_estimates_never_change_the_prior(store: Path) -> None:
    first = build_overview(store)
    write_shrinkage_estimates(store, first)
    again = build_overview(store)
    assert np.array_equal(first.shrunk, again.shrunk, equal_nan=True)
    assert first.boards.value["bias_x"].tolist() == again.boards.value["bias_x"].tolist()
    for key, item in first.populations.items():
        assert (item.mean, item.spread) == (
            again.populations[key].mean,
            again.populations[key].spread,
        )


def test_prior_dominated_parameters_are_named(store: Path, tmp_path: Path) -> None:
    parquet = next((store / "index").glob("*.parquet"))
    loose = tmp_path / "loose.parquet"
    wide = "CASE WHEN board = 'B000003' THEN 1.0 ELSE time_offset_std END AS time_offset_std"
    sql = f"COPY (SELECT * REPLACE ({wide}) FROM '{parquet}') TO '{loose}' (FORMAT parquet)"  # noqa: S608
    with duckdb.connect(":memory:") as database:
        database.execute(sql)
    loose.replace(parquet)
    overview = build_overview(store)
    name = write_shrinkage_estimates(store, overview)
    estimates = read_shrinkage_estimates(store, "B000003")
    assert estimates["time_offset"].prior_dominated
    assert not estimates["scale_x"].prior_dominated
    sql = f"SELECT board FROM '{store}/{name}' WHERE list_contains(prior_dominated, 'time_offset')"  # noqa: S608
    with duckdb.connect(":memory:") as database:
        rows = database.execute(sql).fetchall()
    assert rows == [("B000003",)]


def test_a_small_fleet_has_no_estimates_and_damage_is_reported(tmp_path: Path, store: Path) -> None:
    write_fleet(tmp_path / "few", FleetPlan(boards=3, nights=2))
    assert write_shrinkage_estimates(tmp_path / "few", build_overview(tmp_path / "few")) is None
    assert read_shrinkage_estimates(tmp_path / "few", "B000001") == {}
    name = write_shrinkage_estimates(store, build_overview(store))
    assert name is not None
    (store / name).write_bytes(b"PAR1")
    with pytest.raises(InputError, match="write it again with"):
        read_shrinkage_estimates(store, "B000001")


def test_a_fleet_in_a_bucket_has_its_page_and_estimates_there(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    bucket = storage_at(f"memory://{tmp_path.name}/fleet")
    for path in store.rglob("*"):
        if path.is_file():
            bucket.write(str(path.relative_to(store)), path.read_bytes())
    assert run(["fleet", bucket.location]) == 0
    output = capsys.readouterr().out
    assert f"Page: {bucket.location}/fleet/index.html" in output
    names = {entry.name for entry in bucket.list_files()}
    assert {"fleet/index.html", "fleet/app.js", "fleet/data.js", "fleet/history/00.js"} <= names
    assert tuple(read_shrinkage_estimates(bucket, "B000007")) == PARAMETER_COLUMNS
    assert run(["fleet", bucket.location, "--out", str(tmp_path / "page")]) == 0
    assert (tmp_path / "page" / "data.js").read_bytes().count(bucket.location.encode()) == 1
