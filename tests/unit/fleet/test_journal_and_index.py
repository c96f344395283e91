"""Rows on their way from a worker to the index: nothing lost, nothing twice, whatever ends it."""

import json
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
from gyrorig_solver.fleet.store.folder_journal import (
    FolderJournal,
    abandoned_journals,
    complete_lines,
    is_batch_running,
    other_batch_running,
)
from gyrorig_solver.fleet.store.index_rows import sql_columns


def folded(store: Path) -> list[Path]:
    return sorted((store / "index").glob("*.parquet"))


def test_rows_are_visible_before_and_after_a_merge(tmp_path: Path) -> None:
    index = StoreIndex(tmp_path)
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("k1"), row("k1", "C")])
        assert index.finished_keys() == {"k1"}
        index.merge_journal(journal.start_next_part())
        journal.add([row("k2")])
        assert index.finished_keys() == {"k1", "k2"}
    index.merge_abandoned_journals()
    assert index.finished_keys() == {"k1", "k2"}
    assert not list((tmp_path / "journal").iterdir())
    answer = index.query(
        "SELECT board, created, bias_x, bias_x_std, bias_y FROM rows ORDER BY board"
    )
    assert answer[0] == ("B", datetime(2026, 1, 31, 2, 30), 0.25, 0.5, None)
    assert [item[0] for item in answer] == ["B", "B", "C"]


def test_plain_duckdb_reads_the_index(tmp_path: Path) -> None:
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("k1")])
    StoreIndex(tmp_path).merge_abandoned_journals()
    rows = duckdb.connect().read_parquet(str(tmp_path / "index" / "*.parquet"))
    assert rows.columns == list(sql_columns())
    assert set(parameter_columns()) < set(rows.columns)
    assert rows.fetchall()[0][0] == "k1"


def test_the_journal_of_a_running_batch_is_not_merged(tmp_path: Path) -> None:
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("k1")])
        assert is_batch_running(tmp_path, "night")
        assert other_batch_running(tmp_path, "mine")
        assert not other_batch_running(tmp_path, "night")
        assert StoreIndex(tmp_path).merge_abandoned_journals() == 0
        assert folded(tmp_path) == []
    assert not is_batch_running(tmp_path, "night")
    assert StoreIndex(tmp_path).merge_abandoned_journals() == 1
    assert len(folded(tmp_path)) == 1


KILLED = """
import os, signal, sys
from pathlib import Path
from gyrorig_solver.fleet.store.folder_journal import FolderJournal
from tests.unit.fleet.conftest import row
journal = FolderJournal(Path(sys.argv[1]), "night")
journal.add([row("k1")])
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_rows_of_a_killed_batch_are_kept(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    process = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], cwd=root, check=False)
    assert process.returncode == -9
    assert not is_batch_running(tmp_path, "night")
    assert StoreIndex(tmp_path).merge_abandoned_journals() == 1
    assert StoreIndex(tmp_path).finished_keys() == {"k1"}


@pytest.mark.parametrize("cut", [2, 20, 200, 300])
def test_an_incomplete_last_line_hides_no_other(tmp_path: Path, cut: int) -> None:
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("k1")])
        journal.add([row("k2")])
    (path,) = (tmp_path / "journal").iterdir()
    path.write_bytes(path.read_bytes()[:-cut])
    assert StoreIndex(tmp_path).finished_keys() == {"k1"}
    StoreIndex(tmp_path).merge_abandoned_journals()
    assert StoreIndex(tmp_path).finished_keys() == {"k1"}


def test_a_merge_interrupted_after_its_file_is_not_repeated(tmp_path: Path) -> None:
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("k1")])
    (path,) = (tmp_path / "journal").iterdir()
    text = path.read_bytes()
    StoreIndex(tmp_path).merge_abandoned_journals()
    path.write_bytes(text)  # the power went between the file and the journal's end
    assert len(StoreIndex(tmp_path).query("SELECT * FROM rows")) == 1
    StoreIndex(tmp_path).merge_abandoned_journals()
    assert len(StoreIndex(tmp_path).query("SELECT * FROM all_rows")) == 1


def test_a_row_that_was_written_twice_counts_once(tmp_path: Path) -> None:
    with FolderJournal(tmp_path, "one") as journal:
        journal.add([row("k1")])
    with FolderJournal(tmp_path, "two") as journal:
        journal.add([row("k1", batch="other")])
    assert len(StoreIndex(tmp_path).query("SELECT * FROM all_rows")) == 2
    assert len(StoreIndex(tmp_path).query("SELECT * FROM rows")) == 1


def test_a_repeated_job_has_one_result(tmp_path: Path) -> None:
    later = "2026-02-01T02:30:00Z"
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("whole", status="quarantined", board="")])
        journal.add([row("whole"), row("whole", "C", status="failed")])
        journal.add([row("board", "C", status="failed"), row("board")])
        journal.add([row("board", "C"), row("board")])
        journal.add([row("worse", status="failed", board="", reason="slow")])
        journal.add([row("worse", status="quarantined", board="", created=later)])
    answer = StoreIndex(tmp_path).query("SELECT key, board, status FROM rows ORDER BY ALL")
    assert answer == [
        ("board", "B", "ok"),
        ("board", "C", "ok"),
        ("whole", "B", "ok"),
        ("whole", "C", "failed"),
        ("worse", "", "quarantined"),
    ]
    assert StoreIndex(tmp_path).finished_keys(["quarantined"]) == {"board", "whole"}


def test_a_job_to_be_repeated_is_not_finished(tmp_path: Path) -> None:
    with FolderJournal(tmp_path, "night") as journal:
        journal.add([row("good"), row("bad", status="failed", board="")])
    assert StoreIndex(tmp_path).finished_keys() == {"good", "bad"}
    assert StoreIndex(tmp_path).finished_keys(["failed"]) == {"good"}


def test_a_damaged_index_is_reported_with_its_remedy(tmp_path: Path) -> None:
    (tmp_path / "index").mkdir()
    (tmp_path / "index" / "a.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="rebuild-index"):
        StoreIndex(tmp_path).finished_keys()


FULL = """
import resource, sys
from pathlib import Path
from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.store.folder_journal import FolderJournal
from tests.unit.fleet.conftest import row
journal = FolderJournal(Path(sys.argv[1]), "night")
journal.add([row("k1")])
import signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
size = next((Path(sys.argv[1]) / "journal").iterdir()).stat().st_size
resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, size + 50))
try:
    journal.add([row("k2")])
except MachineError as fault:
    print(fault)
"""


def test_a_full_disk_leaves_complete_lines(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, "-c", FULL, str(tmp_path)]
    process = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True)
    assert "Free some disk space" in process.stdout
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
    with FolderJournal(store, "night") as journal:
        journal.add([row("k1", reason=output, names=rows_in_index)])
    StoreIndex(store).merge_abandoned_journals()
    assert StoreIndex(store).query("SELECT reason, names FROM rows") == [(output, rows_in_index)]


def test_complete_lines_of_an_empty_journal(tmp_path: Path) -> None:
    path = tmp_path / "j"
    path.write_bytes(b"{torn")
    assert complete_lines(path) == b""


def test_a_journal_that_disappears_is_not_an_error(tmp_path: Path) -> None:
    with FolderJournal(tmp_path, "night"):
        pass
    with abandoned_journals(tmp_path) as journals:
        assert len(journals) == 1
        with abandoned_journals(tmp_path) as again:
            assert again == []  # another batch folds it
