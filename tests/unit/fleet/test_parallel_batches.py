"""Batches on one store at the same moment: whatever falls together, nothing is lost or refused."""

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Barrier, Event, Semaphore

import pytest
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import BusyError, UsageError
from gyrorig_solver.calibration import STORE_FILE, create_store
from gyrorig_solver.fleet.jobs import SolveSettings, local_pools, run_batch
from gyrorig_solver.fleet.store import StoreIndex, coordination, rebuild_index
from gyrorig_solver.fleet.store.coordination import BatchClaims, RowJournal, live_batches
from gyrorig_solver.storage import Folder


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

    def item(number: int) -> None:
        start.wait()
        work(number)

    with ThreadPoolExecutor(count) as pool:
        futures: list[Future[None]] = [pool.submit(item, number) for number in range(count)]
    for each in futures:
        each.result()


def test_several_threads_can_create_one_store(tmp_path: Path) -> None:
    def make(folder: Path) -> None:
        assert create_store(folder).sharded
        (folder / "journal").mkdir(exist_ok=True)

    for turn in range(30):
        together(4, lambda _, folder=tmp_path / str(turn): make(folder))  # type: ignore[misc]


def test_an_interrupted_creation_of_a_store_is_completed(tmp_path: Path) -> None:
    (tmp_path / f".{STORE_FILE}.k1lled").touch()
    assert create_store(tmp_path).sharded
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").touch()
    with pytest.raises(UsageError, match=r"contains notes\.txt"):
        create_store(tmp_path / "other")


def test_readers_see_every_row_while_journals_are_merged(tmp_path: Path) -> None:
    nights, over = 40, Event()

    def write() -> None:
        try:
            for night in range(nights):
                with RowJournal(Folder(tmp_path), f"night{night}") as journal:
                    journal.add([row(f"k{night}")])
                StoreIndex(tmp_path).merge_ended_batches()
        finally:
            over.set()

    def read() -> None:
        seen: set[str] = set()
        while not over.is_set():
            now = StoreIndex(tmp_path).finished_keys()
            assert seen <= now
            seen = now

    together(2, lambda number: read() if number else write())
    assert len(StoreIndex(tmp_path).finished_keys()) == nights


def test_overlapping_batches_lose_no_row(tmp_path: Path) -> None:
    batches, nights = 3, 20

    def run(number: int) -> None:
        for night in range(nights):
            name = f"b{number}n{night}"
            index, claims = StoreIndex(tmp_path), BatchClaims(Folder(tmp_path), name)
            with claims.begin_batch() as journal:
                journal.add([row(f"{name}-first")])
                index.merge_batch(name)
                assert name in live_batches(Folder(tmp_path))
                journal.add([row(f"{name}-second")])
                index.merge_batch(name)

    together(batches, run)
    StoreIndex(tmp_path).merge_ended_batches()
    rows = StoreIndex(tmp_path).query("SELECT key FROM all_rows")
    assert len(rows) == len(set(rows)) == batches * nights * 2


def test_rebuilding_the_index_during_batches_loses_no_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(coordination, "EXCLUSIVE_POLL_S", 0.01)
    create_store(tmp_path)
    nights, turn = 10, Semaphore(0)  # a rebuilding a night: more would keep the nights waiting

    def write() -> None:
        for night in range(nights):
            turn.release()
            index, claims = StoreIndex(tmp_path), BatchClaims(Folder(tmp_path), f"night{night}")
            with claims.begin_batch() as journal:
                journal.add([row(f"k{night}", board="", status="rejected", reason="no MCAP")])
                index.merge_batch(f"night{night}")

    def make_anew() -> None:
        for _ in range(nights):
            turn.acquire()
            with suppress(BusyError):
                rebuild_index(tmp_path)

    together(2, lambda number: make_anew() if number else write())
    assert StoreIndex(tmp_path).finished_keys() == {f"k{night}" for night in range(nights)}


def test_parallel_batches_do_every_job_once(tmp_path: Path) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    for size in range(4):
        (spool / f"{size}.mcap").write_bytes(b"x" * size)
    for turn in range(2):
        store = tmp_path / f"store{turn}"
        ended: list[int] = []

        def run(_: int, store: Path = store, ended: list[int] = ended) -> None:
            pools = local_pools(1, 4 << 30)
            summary = run_batch(
                spool, store, SolveSettings(solver_version="0.1.0", extend=()), pools
            )
            assert not summary.deferral_reason + summary.unmerged_reason
            ended.append(sum(summary.sessions_by_status.values()))

        together(3, run)
        assert sum(ended) == 4
        assert len(StoreIndex(store).query("SELECT * FROM all_rows")) == 4
