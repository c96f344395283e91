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
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import Journal, is_running, left_behind, others_run, whole_lines
from gyrorig_solver.fleet.rows import parameter_columns, sql_columns


def folded(store: Path) -> list[Path]:
    return sorted((store / "index").glob("*.parquet"))


def test_rows_are_there_before_and_after_a_fold(tmp_path: Path) -> None:
    index = Index(tmp_path)
    with Journal(tmp_path, "night") as journal:
        journal.add([row("k1"), row("k1", "C")])
        assert index.done() == {"k1"}
        index.fold(journal.next_part())
        journal.add([row("k2")])
        assert index.done() == {"k1", "k2"}
    index.fold_left_behind()
    assert index.done() == {"k1", "k2"}
    assert not list((tmp_path / "journal").iterdir())
    asked = index.ask("SELECT board, created, bias_x, bias_x_std, bias_y FROM rows ORDER BY board")
    assert asked[0] == ("B", datetime(2026, 1, 31, 2, 30), 0.25, 0.5, None)
    assert [one[0] for one in asked] == ["B", "B", "C"]


def test_any_duckdb_reads_the_index_by_itself(tmp_path: Path) -> None:
    with Journal(tmp_path, "night") as journal:
        journal.add([row("k1")])
    Index(tmp_path).fold_left_behind()
    rows = duckdb.connect().read_parquet(str(tmp_path / "index" / "*.parquet"))
    assert rows.columns == list(sql_columns())
    assert set(parameter_columns()) < set(rows.columns)
    assert rows.fetchall()[0][0] == "k1"


def test_a_running_batchs_journal_is_not_folded(tmp_path: Path) -> None:
    with Journal(tmp_path, "night") as journal:
        journal.add([row("k1")])
        assert is_running(tmp_path, "night")
        assert others_run(tmp_path, "mine")
        assert not others_run(tmp_path, "night")
        assert Index(tmp_path).fold_left_behind() == 0
        assert folded(tmp_path) == []
    assert not is_running(tmp_path, "night")
    assert Index(tmp_path).fold_left_behind() == 1
    assert len(folded(tmp_path)) == 1


KILLED = """
import os, signal, sys
from pathlib import Path
from gyrorig_solver.fleet.journal import Journal
from tests.unit.fleet.conftest import row
journal = Journal(Path(sys.argv[1]), "night")
journal.add([row("k1")])
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_batchs_rows_are_kept(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], cwd=root, check=False)
    assert done.returncode == -9
    assert not is_running(tmp_path, "night")
    assert Index(tmp_path).fold_left_behind() == 1
    assert Index(tmp_path).done() == {"k1"}


@pytest.mark.parametrize("cut", [2, 20, 200, 300])
def test_a_torn_last_line_hides_no_other(tmp_path: Path, cut: int) -> None:
    with Journal(tmp_path, "night") as journal:
        journal.add([row("k1")])
        journal.add([row("k2")])
    (path,) = (tmp_path / "journal").iterdir()
    path.write_bytes(path.read_bytes()[:-cut])
    assert Index(tmp_path).done() == {"k1"}
    Index(tmp_path).fold_left_behind()
    assert Index(tmp_path).done() == {"k1"}


def test_a_fold_that_was_cut_off_after_its_file_is_not_done_twice(tmp_path: Path) -> None:
    with Journal(tmp_path, "night") as journal:
        journal.add([row("k1")])
    (path,) = (tmp_path / "journal").iterdir()
    text = path.read_bytes()
    Index(tmp_path).fold_left_behind()
    path.write_bytes(text)  # the power went between the file and the journal's end
    assert len(Index(tmp_path).ask("SELECT * FROM rows")) == 1
    Index(tmp_path).fold_left_behind()
    assert len(Index(tmp_path).ask("SELECT * FROM all_rows")) == 1


def test_a_row_that_was_written_twice_counts_once(tmp_path: Path) -> None:
    with Journal(tmp_path, "one") as journal:
        journal.add([row("k1")])
    with Journal(tmp_path, "two") as journal:
        journal.add([row("k1", batch="other")])
    assert len(Index(tmp_path).ask("SELECT * FROM all_rows")) == 2
    assert len(Index(tmp_path).ask("SELECT * FROM rows")) == 1


def test_work_that_was_done_again_has_one_end(tmp_path: Path) -> None:
    later = "2026-02-01T02:30:00Z"
    with Journal(tmp_path, "night") as journal:
        journal.add([row("whole", status="quarantined", board="")])
        journal.add([row("whole"), row("whole", "C", status="failed")])
        journal.add([row("board", "C", status="failed"), row("board")])
        journal.add([row("board", "C"), row("board")])
        journal.add([row("worse", status="failed", board="", reason="slow")])
        journal.add([row("worse", status="quarantined", board="", created=later)])
    asked = Index(tmp_path).ask("SELECT key, board, status FROM rows ORDER BY ALL")
    assert asked == [
        ("board", "B", "ok"),
        ("board", "C", "ok"),
        ("whole", "B", "ok"),
        ("whole", "C", "failed"),
        ("worse", "", "quarantined"),
    ]
    assert Index(tmp_path).done(["quarantined"]) == {"board", "whole"}


def test_work_to_be_done_again_is_not_done(tmp_path: Path) -> None:
    with Journal(tmp_path, "night") as journal:
        journal.add([row("good"), row("bad", status="failed", board="")])
    assert Index(tmp_path).done() == {"good", "bad"}
    assert Index(tmp_path).done(["failed"]) == {"good"}


def test_a_damaged_index_is_said_with_its_remedy(tmp_path: Path) -> None:
    (tmp_path / "index").mkdir()
    (tmp_path / "index" / "a.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(InputError, match="rebuild-index"):
        Index(tmp_path).done()


FULL = """
import resource, sys
from pathlib import Path
from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.journal import Journal
from tests.unit.fleet.conftest import row
journal = Journal(Path(sys.argv[1]), "night")
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


def test_a_full_disk_leaves_whole_lines(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    command = [sys.executable, "-c", FULL, str(tmp_path)]
    done = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True)
    assert "make room" in done.stdout
    (path,) = (tmp_path / "journal").iterdir()
    assert len(path.read_bytes().splitlines()) == 1
    assert json.loads(path.read_bytes())["key"] == "k1"


@given(st.text(max_size=60), st.lists(st.text(max_size=20), max_size=4))
@settings(max_examples=25, deadline=None)
def test_any_text_comes_back_from_the_index(
    tmp_path_factory: pytest.TempPathFactory, reason: str, names: list[str]
) -> None:
    store = tmp_path_factory.mktemp("text")
    said = reason.encode("utf-8", "replace").decode()
    kept = [name.encode("utf-8", "replace").decode() for name in names]
    with Journal(store, "night") as journal:
        journal.add([row("k1", reason=said, names=kept)])
    Index(store).fold_left_behind()
    assert Index(store).ask("SELECT reason, names FROM rows") == [(said, kept)]


def test_whole_lines_of_an_empty_journal(tmp_path: Path) -> None:
    path = tmp_path / "j"
    path.write_bytes(b"{torn")
    assert whole_lines(path) == b""


def test_a_journal_that_vanishes_is_no_fault(tmp_path: Path) -> None:
    with Journal(tmp_path, "night"):
        pass
    with left_behind(tmp_path) as journals:
        assert len(journals) == 1
        with left_behind(tmp_path) as again:
            assert again == []  # another batch folds it
