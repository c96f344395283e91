"""Rows on their way from a worker to the index: nothing lost, nothing twice, whatever ends it."""

import json
import os
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import duckdb
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import InputError
from gyrorig_solver.fleet.store import StoreIndex, parameter_columns
from gyrorig_solver.fleet.store.coordination import RowJournal, live_batches
from gyrorig_solver.fleet.store.index_rows import json_lines, sql_columns
from gyrorig_solver.storage import Folder, Storage, storage_at


@pytest.fixture(params=["folder", "bucket"])
def store(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Storage:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    if request.param == "folder":
        return Folder(tmp_path / "store")
    return storage_at(f"memory://{tmp_path.name}/store")


def names(store: Storage, folder: str) -> list[str]:
    return [entry.name for entry in store.list_files(folder)]


def test_rows_are_visible_before_and_after_a_merge(store: Storage) -> None:
    index = StoreIndex(store)
    with RowJournal(store, "night") as journal:
        journal.add([row("k1"), row("k1", "C")])
        assert index.finished_keys() == {"k1"}
        index.merge_batch("night")
        journal.add([row("k2")])
        assert index.finished_keys() == {"k1", "k2"}
    index.merge_ended_batches()
    assert index.finished_keys() == {"k1", "k2"}
    assert names(store, "journal") == []
    answer = index.query(
        "SELECT board, created, bias_x, bias_x_std, bias_y FROM rows ORDER BY board"
    )
    assert answer[0] == ("B", datetime(2026, 1, 31, 2, 30), 0.25, 0.5, None)
    assert [item[0] for item in answer] == ["B", "B", "C"]


def test_plain_duckdb_reads_the_index(tmp_path: Path) -> None:
    with RowJournal(Folder(tmp_path), "night") as journal:
        journal.add([row("k1")])
    StoreIndex(tmp_path).merge_ended_batches()
    rows = duckdb.connect().read_parquet(str(tmp_path / "index" / "*.parquet"))
    assert rows.columns == list(sql_columns())
    assert set(parameter_columns()) < set(rows.columns)
    assert rows.fetchall()[0][0] == "k1"


def test_the_journal_of_a_running_batch_is_not_merged(store: Storage) -> None:
    with RowJournal(store, "night") as journal:
        journal.add([row("k1")])
        assert live_batches(store) == {"night"}
        assert StoreIndex(store).merge_ended_batches() == 0
        assert names(store, "index") == []
    assert live_batches(store) == set()
    assert StoreIndex(store).merge_ended_batches() == 1
    assert len(names(store, "index")) == 1


def with_tests() -> dict[str, str]:
    """Return an environment in which the tests can be imported, also in safe-path mode."""
    return {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[3])}


KILLED = """
import os, signal, sys
from pathlib import Path
from gyrorig_solver.fleet.store.coordination import RowJournal
from gyrorig_solver.storage import Folder
from tests.unit.fleet.conftest import row
journal = RowJournal(Folder(Path(sys.argv[1])), "night")
journal.add([row("k1")])
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_rows_of_a_killed_batch_are_kept(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], env=with_tests(), check=False
    )
    assert process.returncode == -9
    assert names(Folder(tmp_path), "alive") == ["alive/night"]
    assert live_batches(Folder(tmp_path)) == set()
    assert StoreIndex(tmp_path).merge_ended_batches() == 1
    assert StoreIndex(tmp_path).finished_keys() == {"k1"}


@pytest.mark.parametrize("name", ["night-0000.jsonl", "night-0000/000000.jsonl"])
@pytest.mark.parametrize("cut", [2, 20, 200, 300])
def test_journals_of_older_versions_are_merged(store: Storage, name: str, cut: int) -> None:
    """They could end with an incomplete line, which hides no other."""
    store.write(f"journal/{name}", json_lines([row("k1"), row("k2")])[:-cut])
    assert StoreIndex(store).finished_keys() == {"k1"}
    assert StoreIndex(store).merge_ended_batches() == 1
    assert StoreIndex(store).finished_keys() == {"k1"}
    assert names(store, "journal") == []


def test_a_merge_interrupted_after_its_file_is_not_repeated(store: Storage) -> None:
    with RowJournal(store, "night") as journal:
        journal.add([row("k1")])
    (name,) = names(store, "journal")
    text = store.read(name) or b""
    StoreIndex(store).merge_ended_batches()
    store.write(name, text)  # the power went between the file and the journal's end
    assert len(StoreIndex(store).query("SELECT * FROM rows")) == 1
    StoreIndex(store).merge_ended_batches()
    assert len(StoreIndex(store).query("SELECT * FROM all_rows")) == 1


def test_a_row_that_was_written_twice_counts_once(store: Storage) -> None:
    with RowJournal(store, "one") as journal:
        journal.add([row("k1")])
    with RowJournal(store, "two") as journal:
        journal.add([row("k1", batch="other")])
    assert len(StoreIndex(store).query("SELECT * FROM all_rows")) == 2
    assert len(StoreIndex(store).query("SELECT * FROM rows")) == 1


def test_a_repeated_job_has_one_result(store: Storage) -> None:
    later = "2026-02-01T02:30:00Z"
    with RowJournal(store, "night") as journal:
        journal.add([row("whole", status="quarantined", board="")])
        journal.add([row("whole"), row("whole", "C", status="failed")])
        journal.add([row("board", "C", status="failed"), row("board")])
        journal.add([row("board", "C"), row("board")])
        journal.add([row("worse", status="failed", board="", reason="slow")])
        journal.add([row("worse", status="quarantined", board="", created=later)])
    answer = StoreIndex(store).query("SELECT key, board, status FROM rows ORDER BY ALL")
    assert answer == [
        ("board", "B", "ok"),
        ("board", "C", "ok"),
        ("whole", "B", "ok"),
        ("whole", "C", "failed"),
        ("worse", "", "quarantined"),
    ]
    assert StoreIndex(store).finished_keys(["quarantined"]) == {"board", "whole"}


def test_a_job_to_be_repeated_is_not_finished(store: Storage) -> None:
    with RowJournal(store, "night") as journal:
        journal.add([row("good"), row("bad", status="failed", board="")])
    assert StoreIndex(store).finished_keys() == {"good", "bad"}
    assert StoreIndex(store).finished_keys(["failed"]) == {"good"}


def test_a_damaged_index_is_reported_with_its_remedy(tmp_path: Path) -> None:
    (tmp_path / "index").mkdir()
    (tmp_path / "index" / "a.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="rebuild-index"):
        StoreIndex(tmp_path).finished_keys()


FULL = """
import resource, sys
from pathlib import Path
from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.store.coordination import RowJournal
from gyrorig_solver.storage import Folder
from tests.unit.fleet.conftest import row
journal = RowJournal(Folder(Path(sys.argv[1])), "night")
journal.add([row("k1")])
import signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (50, 50))
try:
    journal.add([row("k2")])
except MachineError as fault:
    print(fault)
"""


def test_a_full_disk_leaves_the_rows_of_other_jobs(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL, str(tmp_path)]
    process = subprocess.run(command, env=with_tests(), check=True, capture_output=True, text=True)
    assert "night-000001.jsonl cannot be written" in process.stdout
    (path,) = (tmp_path / "journal").iterdir()
    assert len(path.read_bytes().splitlines()) == 1
    assert json.loads(path.read_bytes())["key"] == "k1"


@given(st.text(max_size=60), st.lists(st.text(max_size=20), max_size=4))
@settings(max_examples=25, deadline=None)
def test_any_text_comes_back_from_the_index(
    tmp_path_factory: pytest.TempPathFactory, reason: str, names: list[str]
) -> None:
    store = tmp_path_factory.mktemp("text")
    output = reason.encode("utf-8", "replace").decode()
    rows_in_index = [name.encode("utf-8", "replace").decode() for name in names]
    with RowJournal(Folder(store), "night") as journal:
        journal.add([row("k1", reason=output, names=rows_in_index)])
    StoreIndex(store).merge_ended_batches()
    assert StoreIndex(store).query("SELECT reason, names FROM rows") == [(output, rows_in_index)]
