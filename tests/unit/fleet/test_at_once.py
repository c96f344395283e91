"""Batches on one store at the same moment: whatever falls together, nothing is lost or refused."""

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Barrier, Event, Semaphore

import pytest
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import BusyError, MachineError, UsageError
from gyrorig_solver.calibration.store import STORE_FILE, make_sharded
from gyrorig_solver.fleet.batch import run_batch
from gyrorig_solver.fleet.claims import Claims
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.journal import Journal, is_running
from gyrorig_solver.fleet.lanes import local_lanes
from gyrorig_solver.fleet.shelf import rebuild_index
from gyrorig_solver.fleet.task import Settings


@pytest.fixture(autouse=True)
def quick_turns() -> Iterator[None]:
    """Let threads take turns 50 times as often as usual, so that they meet everywhere."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    yield
    sys.setswitchinterval(before)


def together(count: int, work: Callable[[int], object]) -> None:
    """Do work in so many threads that begin at one moment; what one raises is raised."""
    start = Barrier(count)

    def one(number: int) -> None:
        start.wait()
        work(number)

    with ThreadPoolExecutor(count) as pool:
        done: list[Future[None]] = [pool.submit(one, number) for number in range(count)]
    for each in done:
        each.result()


def test_a_store_is_made_by_many_at_once(tmp_path: Path) -> None:
    def make(folder: Path) -> None:
        assert make_sharded(folder).sharded
        (folder / "journal").mkdir(exist_ok=True)

    for turn in range(30):
        together(4, lambda _, folder=tmp_path / str(turn): make(folder))  # type: ignore[misc]


def test_a_store_whose_making_was_cut_off_is_made(tmp_path: Path) -> None:
    (tmp_path / f".{STORE_FILE}.k1lled").touch()
    assert make_sharded(tmp_path).sharded
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").touch()
    with pytest.raises(UsageError, match=r"holds notes\.txt"):
        make_sharded(tmp_path / "other")


def test_who_reads_beside_folds_sees_every_row_that_was_there(tmp_path: Path) -> None:
    nights, over = 40, Event()

    def write() -> None:
        try:
            for night in range(nights):
                with Journal(tmp_path, f"night{night}") as journal:
                    journal.add([row(f"k{night}")])
                Index(tmp_path).fold_left_behind()
        finally:
            over.set()

    def read() -> None:
        seen: set[str] = set()
        while not over.is_set():
            now = Index(tmp_path).done()
            assert seen <= now
            seen = now

    together(2, lambda number: read() if number else write())
    assert len(Index(tmp_path).done()) == nights


def test_batches_that_begin_and_end_beside_each_other_lose_no_row(tmp_path: Path) -> None:
    batches, nights = 3, 20

    def run(number: int) -> None:
        for night in range(nights):
            name = f"b{number}n{night}"
            index, claims = Index(tmp_path), Claims(tmp_path, name)
            with claims.begin(index) as journal:
                journal.add([row(f"{name}-first")])
                index.fold(journal.next_part())
                assert is_running(tmp_path, name)
                journal.add([row(f"{name}-second")])
            claims.end(index)

    together(batches, run)
    Index(tmp_path).fold_left_behind()
    rows = Index(tmp_path).ask("SELECT key FROM all_rows")
    assert len(rows) == len(set(rows)) == batches * nights * 2


def test_an_index_made_anew_beside_batches_loses_no_row(tmp_path: Path) -> None:
    make_sharded(tmp_path)
    nights, turn = 10, Semaphore(0)  # a rebuilding a night: more would keep the nights waiting

    def write() -> None:
        for night in range(nights):
            turn.release()
            index, claims = Index(tmp_path), Claims(tmp_path, f"night{night}")
            with claims.begin(index) as journal:
                journal.add([row(f"k{night}", board="", status="rejected", reason="no MCAP")])
            claims.end(index)

    def make_anew() -> None:
        for _ in range(nights):
            turn.acquire()
            with suppress(BusyError):
                rebuild_index(tmp_path)

    together(2, lambda number: make_anew() if number else write())
    assert Index(tmp_path).done() == {f"k{night}" for night in range(nights)}


def test_whole_batches_at_once_do_everything_once(tmp_path: Path) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    for size in range(4):
        (spool / f"{size}.mcap").write_bytes(b"x" * size)
    for turn in range(2):
        store = tmp_path / f"store{turn}"
        ended: list[int] = []

        def run(_: int, store: Path = store, ended: list[int] = ended) -> None:
            lanes = local_lanes(1, 4 << 30)
            summary = run_batch(spool, store, Settings(solver_version="0.1.0"), lanes)
            assert not summary.put_off_why + summary.unfolded_why
            ended.append(sum(summary.ended.values()))

        together(3, run)
        assert sum(ended) == 4
        assert len(Index(store).ask("SELECT * FROM all_rows")) == 4


def test_a_part_that_cannot_be_begun_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Journal(tmp_path, "night") as journal:
        journal.add([row("k1")])
        with monkeypatch.context() as patched:
            patched.setattr(Path, "rename", _refuse)
            with pytest.raises(MachineError, match="cannot write"):
                journal.next_part()
        journal.add([row("k2")])
        assert is_running(tmp_path, "night")
    Index(tmp_path).fold_left_behind()
    assert Index(tmp_path).done() == {"k1", "k2"}


def _refuse(*_: object) -> None:
    raise OSError(28, "No space left on device")
