"""A night on real recordings: every one comes to one end, once, whatever is killed."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest
from tests.unit.fleet.test_spool_scanner import write

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import STORE_FILE, create_store
from gyrorig_solver.fleet.jobs import SolveSettings, local_pools, resource_limits, run_batch
from gyrorig_solver.fleet.jobs.batch_run import Shard
from gyrorig_solver.fleet.jobs.session_job import Job, JobResult, failure_row, run_job
from gyrorig_solver.fleet.jobs.workers import DeferredJob, WorkerPool, run_all
from gyrorig_solver.fleet.store import StoreIndex, verify
from gyrorig_solver.fleet.store.coordination import BatchClaims
from gyrorig_solver.storage import Folder

BOARD = BoardId("GY80-1")
SETTINGS = SolveSettings(solver_version="0.1.0", extend=())
GIGABYTES = 1 << 30


def make_job(key: str, store: Path, *paths: Path) -> Job:
    names = tuple(PurePosixPath(path) for path in paths)
    return Job(key, "night", Folder(store), Folder(Path("/")), names, ("00",), SETTINGS)


def night(spool: Path, store: Path, workers: int = 1, **more: object):  # type: ignore[no-untyped-def]
    return run_batch(spool, store, SETTINGS, local_pools(workers, 4 * GIGABYTES), **more)  # type: ignore[arg-type]


@pytest.fixture
def spool(tmp_path: Path, recorded: list[Path]) -> Path:
    folder = tmp_path / "spool"
    folder.mkdir()
    for number, path in enumerate(recorded):
        shutil.copy(path, folder / f"{number}.mcap")
    (folder / "foreign.mcap").write_bytes(b"hello")
    (folder / "empty.mcap").write_bytes(b"")
    write(folder / "boardless.mcap")
    return folder


def test_every_recording_ends_with_one_status(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    first = night(spool, store)
    assert first.sessions_by_status == Counter(ok=2, rejected=3)
    assert first.is_partial
    rows_in_index = StoreIndex(store).query(
        "SELECT status, reason, board, version, trust FROM rows ORDER BY ALL"
    )
    assert Counter(status for status, *_ in rows_in_index) == Counter(ok=2, rejected=3)
    assert all(reason for status, reason, *_ in rows_in_index if status == "rejected")
    assert [path.name for path in create_store(store).folder_of(BOARD).glob("*.yaml")]
    assert verify(store).faults == ()

    second = night(spool, store)
    assert (second.done_before, second.to_do, second.finished) == (5, 0, 0)
    assert not second.is_partial
    again = night(spool, store, retry=["rejected"])
    assert again.sessions_by_status == Counter(rejected=3)
    assert len(create_store(store).versions(BOARD)) == 2
    assert len(StoreIndex(store).query("SELECT * FROM rows WHERE status = 'ok'")) == 2


def test_shards_share_the_work(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    ended: Counter[str] = Counter()
    for number in (1, 2, 3):
        ended += night(spool, store, shard=Shard(number, 3)).sessions_by_status
    assert ended == Counter(ok=2, rejected=3)


def test_claims_of_a_running_batch_are_kept(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    create_store(store)
    other = BatchClaims(Folder(store), "rival")
    with other.begin_batch():
        keys = [path.name for path in (store / "claims").glob("??/*")]
        assert keys == []
        mine = BatchClaims(Folder(store), "mine")
        assert other.try_claim("aa1")
        assert not mine.try_claim("aa1")
        other.mark_done("aa1")
        assert not mine.try_claim("aa1")
        assert other.try_claim("aa2")
    assert mine.try_claim("aa2")  # the rival died with it
    assert not mine.try_claim("aa1")  # it had done it
    mine.release("aa2")
    with BatchClaims(Folder(store), "next").begin_batch():
        assert not list((store / "claims").glob("??/*"))


def test_a_version_without_its_row_is_found_again(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    night(spool, store)
    shutil.rmtree(store / "index")  # as if each batch had died before its row
    shutil.rmtree(store / "journal")
    again = night(spool, store)
    assert again.sessions_by_status == Counter(ok=2, rejected=3)
    assert len(create_store(store).versions(BOARD)) == 2
    assert verify(store).faults == ()


def test_two_boards_with_one_name_are_not_mixed(
    spool: Path, tmp_path: Path, recorded: list[Path]
) -> None:
    store = tmp_path / "store"
    night(spool, store)
    (path,) = [v.path for v in create_store(store).versions(BOARD)][-1:]
    text = path.read_text(encoding="utf-8")
    uid = json.loads(text.split("uid: ")[1].splitlines()[0])
    path.write_text(text.replace(uid, "another"), encoding="utf-8")
    reported = run_job(make_job("k", store, recorded[0]))
    (row,) = reported.rows
    # its digest is not the order's: what has changed is refused before anything is solved
    assert (row.status, "was changed while" in row.reason) == ("rejected", True)
    from gyrorig_protocol.recording.reader import read_recording  # noqa: PLC0415

    digest = read_recording(recorded[0]).sha256
    reported = run_job(replace(make_job("k", store, recorded[0]), digests=(digest,)))
    assert "two boards have the same name" in reported.rows[0].reason


# The first alarm can come in a callback of the garbage collector. Python then drops the exception,
# and the alarm comes again.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_deadline_fails_the_work_and_keeps_the_trace(
    recorded: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The hard deadline ends the process. A busy machine could be that late.
    monkeypatch.setattr(resource_limits, "HARD_DEADLINE_FACTOR", 1e4)
    create_store(tmp_path / "store")
    from gyrorig_protocol.recording.reader import read_recording  # noqa: PLC0415

    digests = (read_recording(recorded[0]).sha256,)
    short_deadline = SolveSettings(solver_version="0.1.0", extend=(), deadline_s=0.02)
    reported = run_job(
        replace(
            make_job("k", tmp_path / "store", recorded[0]), digests=digests, settings=short_deadline
        )
    )
    (row,) = reported.rows
    assert row.status == "failed"
    assert "0.02 s" in row.reason
    assert "DeadlineExceededError" in row.trace


def test_a_board_without_a_calibration_has_a_row(tmp_path: Path) -> None:
    create_store(tmp_path)
    index = StoreIndex(tmp_path)
    with BatchClaims(Folder(tmp_path), "night").begin_batch() as journal:
        journal.add(
            [failure_row(make_job("k", tmp_path), "rejected", reason="no motion", board=BOARD)]
        )
    assert index.query("SELECT board, reason FROM rows") == [(BOARD, "no motion")]


def dies_of_poison(item: Job) -> JobResult:
    if item.key.startswith("poison"):
        os.kill(os.getpid(), signal.SIGKILL)
    return JobResult(item.key, (failure_row(item, "rejected", reason="as asked"),))


def refuses(item: Job) -> JobResult:
    raise MachineError("the disk is full", "make room")


def pools(count: int, work: object) -> list[WorkerPool]:
    return [WorkerPool(lambda: ProcessPoolExecutor(1), job_function=work) for _ in range(count)]  # type: ignore[arg-type]


def test_only_the_job_that_kills_its_worker_twice_is_quarantined(tmp_path: Path) -> None:
    jobs = [make_job(f"{'poison' if n % 5 == 0 else 'k'}{n}", tmp_path) for n in range(20)]
    reported = {
        item.key: item
        for item in run_all(jobs, pools(2, dies_of_poison))
        if isinstance(item, JobResult)
    }
    assert set(reported) == {item.key for item in jobs}
    for key, outcome in reported.items():
        wanted = "quarantined" if key.startswith("poison") else "rejected"
        assert [row.status for row in outcome.rows] == [wanted]


def test_a_job_that_the_machine_refuses_is_deferred(tmp_path: Path) -> None:
    reported = list(run_all([make_job("k", tmp_path)], pools(1, refuses)))
    assert [type(item) for item in reported] == [DeferredJob]


def test_jobs_without_workers_are_deferred_and_the_batch_ends(tmp_path: Path) -> None:
    def none() -> ProcessPoolExecutor:
        raise OSError("no more processes")

    jobs = [make_job(f"k{number}", tmp_path) for number in range(5)]
    reported = list(run_all(jobs, [WorkerPool(none), WorkerPool(none)]))
    assert [type(item) for item in reported] == [DeferredJob] * 5


def test_a_store_that_refuses_everything_ends_the_batch_early(tmp_path: Path) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    for number in range(60):
        (spool / f"{number}.mcap").write_bytes(b"%d" % number)
    summary = run_batch(spool, tmp_path / "store", SETTINGS, pools(2, refuses))
    assert summary.gave_up
    assert 20 <= summary.deferred <= 22
    assert summary.not_started >= 38
    assert "make room" in summary.deferral_reason
    after = night(spool, tmp_path / "store")
    assert after.sessions_by_status == Counter(rejected=60)


def test_a_folder_with_other_files_is_not_a_store(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x", encoding="utf-8")
    with pytest.raises(UsageError, match=r"contains thesis\.tex"):
        create_store(tmp_path)


def test_a_newer_store_is_refused(tmp_path: Path) -> None:
    (tmp_path / STORE_FILE).write_text('schema: "gyrorig/store/9"\n', encoding="utf-8")
    with pytest.raises(InputError, match="gyrorig/store/9"):
        create_store(tmp_path)


def test_a_batch_killed_repeatedly_loses_and_repeats_nothing(
    tmp_path: Path, recorded: list[Path]
) -> None:
    """Killed the moment its n-th line is in the journal: the least there is to go on from."""
    spool, store = tmp_path / "spool", tmp_path / "store"
    spool.mkdir()
    for number in range(6):
        (spool / f"foreign{number}.mcap").write_bytes(b"%d" % number)
    for number, path in enumerate(recorded):
        shutil.copy(path, spool / f"{number}.mcap")
    command = [str(Path(sys.executable).with_name("gyrorig")), "batch", "--workers", "1"]
    command += ["--spool", str(spool), "--store", str(store)]
    for _ in range(2):
        child = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        before = lines(store)
        deadline_s = time.monotonic() + 60
        while child.poll() is None and lines(store) <= before and time.monotonic() < deadline_s:
            time.sleep(0.005)  # between looks; what is waited for is the line
        with contextlib.suppress(ProcessLookupError):  # it has ended by itself
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    process = subprocess.run(command, check=False, capture_output=True, text=True)
    assert process.returncode == 5, process.stderr
    rows_in_index = StoreIndex(store).query("SELECT status FROM rows")
    assert Counter(status for (status,) in rows_in_index) == Counter(ok=2, rejected=6)
    assert len(create_store(store).versions(BOARD)) == 2
    assert verify(store).faults == ()
    assert not list((store / "journal").iterdir())


def lines(store: Path) -> int:
    """Count the lines of journals, one of which may be folded while we look."""
    result = 100 * len(list((store / "index").glob("*.parquet")))
    for path in (store / "journal").glob("*.jsonl"):
        with contextlib.suppress(FileNotFoundError):
            result += path.read_bytes().count(b"\n")
    return result


def test_two_parallel_batches_do_every_job_once(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    command = [str(Path(sys.executable).with_name("gyrorig")), "batch", "--workers", "1", "--json"]
    command += ["--spool", str(spool), "--store", str(store)]
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    reported = [item.communicate() for item in processes]
    ended: Counter[str] = Counter()
    for out, err in reported:
        assert out, err
        ended += Counter(json.loads(out)["ended"])
    assert ended == Counter(ok=2, rejected=3)
    assert len(create_store(store).versions(BOARD)) == 2
    assert verify(store).faults == ()
