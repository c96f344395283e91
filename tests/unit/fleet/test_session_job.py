"""One piece of work: what its key rests upon, what a fault of ours becomes, its memory."""

import resource
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from tests.unit.fleet.test_batch import make_job

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import create_store
from gyrorig_solver.fleet.jobs import BatchSummary, SolveSettings, run_batch, session_job
from gyrorig_solver.fleet.jobs.session_job import (
    Job,
    JobResult,
    failure_row,
    run_job_memory_limited,
)
from gyrorig_solver.fleet.jobs.workers import WorkerPool, run_all
from gyrorig_solver.fleet.store import StoreIndex, job_key

BOARD = BoardId("GY80-1")


def night(folder: Path, settings: SolveSettings) -> BatchSummary:
    pools = [WorkerPool(lambda: ThreadPoolExecutor(1))]
    return run_batch(folder / "spool", folder / "store", settings, pools)


def test_a_key_depends_on_inputs_solver_and_configuration() -> None:
    config = SolveSettings("0.1.0").config_sha256
    key = job_key(["b", "a"], "0.1.0", config)
    assert key == job_key(["a", "b"], "0.1.0", config)  # parts come in any order
    others = [
        job_key(["a"], "0.1.0", config),
        job_key(["a", "c"], "0.1.0", config),
        job_key(["a", "b"], "0.2.0", config),
        job_key(["a", "b"], "0.1.0", SolveSettings("0.1.0", extend=()).config_sha256),
    ]
    assert len({key, *others}) == 5


def test_another_solver_or_configuration_repeats_the_work(
    tmp_path: Path, recorded: list[Path]
) -> None:
    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool" / "a.mcap")
    (tmp_path / "spool" / "foreign.mcap").write_bytes(b"hello")
    first = SolveSettings(solver_version="0.1.0")
    assert night(tmp_path, first).sessions_by_status == Counter(ok=1, rejected=1)
    again = night(tmp_path, first)
    assert (again.done_before, again.sessions_by_status) == (2, Counter())
    for number, other in enumerate(
        (
            SolveSettings(solver_version="0.1.0", extend=()),
            SolveSettings(solver_version="0.2.0"),
        ),
        2,
    ):
        repeated = night(tmp_path, other)
        assert (repeated.done_before, repeated.sessions_by_status) == (0, Counter(ok=1, rejected=1))
        assert len(create_store(tmp_path / "store").versions(BOARD)) == number
    assert night(tmp_path, first).done_before == 2  # what it did is still done


@pytest.mark.parametrize("where", ["solve_and_store", "read_recording"])
def test_an_error_of_the_program_is_a_failure_with_its_trace(
    tmp_path: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    def broken(*_arguments: object, **_more: object) -> None:
        raise ZeroDivisionError("as asked")

    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool" / "a.mcap")
    (tmp_path / "spool" / "foreign.mcap").write_bytes(b"hello")
    monkeypatch.setattr(session_job, where, broken)
    summary = night(tmp_path, SolveSettings(solver_version="0.1.0"))
    assert summary.sessions_by_status["failed"] >= 1
    assert summary.finished == 2  # the other recording has its end too
    index = StoreIndex(tmp_path / "store")
    ((reason, trace),) = index.query("SELECT reason, trace FROM rows WHERE names[1] = 'a.mcap'")
    assert reason == "an error of the program, ZeroDivisionError: as asked"
    assert trace.startswith("Traceback")
    assert "in broken" in trace
    assert trace.rstrip().endswith("ZeroDivisionError: as asked")


def test_a_failed_joint_fit_is_reported_and_boards_are_solved_singly(
    tmp_path: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_arguments: object, **_more: object) -> None:
        raise ZeroDivisionError("as asked")

    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool" / "a.mcap")
    monkeypatch.setattr(session_job, "fit_together", broken)
    summary = night(tmp_path, SolveSettings(solver_version="0.1.0"))
    assert summary.sessions_by_status == Counter(ok=1)
    (failure,) = summary.joint_fit_failures
    assert failure == (
        "a.mcap: the boards were solved singly, because their joint fit failed with an error of "
        "the program, ZeroDivisionError: as asked"
    )
    index = StoreIndex(tmp_path / "store")
    ((status, reason, trace),) = index.query("SELECT status, reason, trace FROM rows")
    assert (status, f"a.mcap: {reason}") == ("ok", failure)
    assert trace.rstrip().endswith("ZeroDivisionError: as asked")
    assert len(create_store(tmp_path / "store").versions(BOARD)) == 1


LIMITED = """
import resource, sys
from pathlib import Path
from gyrorig_solver.fleet.jobs.resource_limits import limit_memory
pages = int(Path("/proc/self/statm").read_text().split()[0])
here = pages * resource.getpagesize()
more, wanted = int(sys.argv[1]), 64 << 20
limit_memory(here + more)
try:
    held = bytearray(wanted)
except MemoryError:
    print("refused")
else:
    print("given")
"""


@pytest.mark.parametrize(("more_bytes", "output"), [(16 << 20, "refused"), (256 << 20, "given")])
def test_a_process_gets_no_more_memory_than_its_limit(more_bytes: int, output: str) -> None:
    command = [sys.executable, "-c", LIMITED, str(more_bytes)]
    process = subprocess.run(command, capture_output=True, text=True, check=True)
    assert process.stdout.strip() == output


def test_a_borrowed_process_is_limited_during_the_job_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []

    def look(item: Job, unfinished: list[str]) -> list[Any]:
        seen.append(resource.getrlimit(resource.RLIMIT_AS)[0])
        raise MemoryError

    before = resource.getrlimit(resource.RLIMIT_AS)
    monkeypatch.setattr(session_job, "_solve_boards", look)
    settings = SolveSettings(solver_version="0.1.0", memory_bytes=64 << 30)
    answer = make_job("k", tmp_path)
    reported = run_job_memory_limited(
        Job(answer.key, answer.batch, answer.store, answer.spool, (), ("00",), settings)
    )
    assert seen == [64 << 30]
    assert resource.getrlimit(resource.RLIMIT_AS) == before
    (row,) = reported.rows
    assert (row.status, row.reason) == (
        "failed",
        "the session needs more than 65536 MB of memory. "
        "Repeat it with --retry failed and a larger --memory.",
    )


class DiedError(Exception):
    """What an executor says of work whose worker died."""


class AtOnce(Executor):
    """Does work where it is given, and holds the answer until it is asked for."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except DiedError as fault:
            future.set_exception(fault)
        return future


def test_jobs_that_waited_next_to_a_death_are_repeated_alone(
    tmp_path: Path,
) -> None:
    """A scheduler tells a worker's death to all that waited there, not only to who caused it."""
    neighbours: dict[str, list[int]] = {}
    pool = WorkerPool(AtOnce, capacity=4, death_exceptions=(DiedError,))

    def work(item: Job) -> JobResult:
        neighbours.setdefault(item.key, []).append(len(pool.running_jobs))
        if item.key == "poison" or (item.key.startswith("near") and len(neighbours[item.key]) == 1):
            raise DiedError
        return JobResult(item.key, (failure_row(item, "rejected", reason="as asked"),))

    pool.job_function = work
    jobs = [make_job(key, tmp_path) for key in ("a", "near1", "poison", "near2", "b", "c", "d")]
    reported = {item.key: item for item in run_all(jobs, [pool]) if isinstance(item, JobResult)}
    ended = {key: item.rows[0].status for key, item in reported.items()}
    assert ended == {
        item.key: "quarantined" if item.key == "poison" else "rejected" for item in jobs
    }
    assert {key: len(tries) for key, tries in neighbours.items() if len(tries) > 1} == {
        "near1": 2,
        "poison": 2,
        "near2": 2,
    }
    assert all(tries[1] == 0 for tries in neighbours.values() if len(tries) > 1)  # alone
