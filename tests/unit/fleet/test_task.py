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
from tests.unit.fleet.test_batch import order

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.store import make_sharded
from gyrorig_solver.fleet import task
from gyrorig_solver.fleet.batch import Summary, run_batch
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.lanes import Lane, through
from gyrorig_solver.fleet.task import Order, Outcome, Settings, carry_out_within, key_of, row_of

BOARD = BoardId("GY80-1")


def night(folder: Path, settings: Settings) -> Summary:
    lanes = [Lane(lambda: ThreadPoolExecutor(1))]
    return run_batch(folder / "spool", folder / "store", settings, lanes)


def test_a_key_is_of_inputs_solver_and_configuration() -> None:
    config = Settings("0.1.0").config_sha256
    key = key_of(["b", "a"], "0.1.0", config)
    assert key == key_of(["a", "b"], "0.1.0", config)  # parts come in any order
    others = [
        key_of(["a"], "0.1.0", config),
        key_of(["a", "c"], "0.1.0", config),
        key_of(["a", "b"], "0.2.0", config),
        key_of(["a", "b"], "0.1.0", Settings("0.1.0", extend=("auto",)).config_sha256),
    ]
    assert len({key, *others}) == 5


def test_another_solver_or_configuration_does_the_work_anew(
    tmp_path: Path, recorded: list[Path]
) -> None:
    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool" / "a.mcap")
    (tmp_path / "spool" / "foreign.mcap").write_bytes(b"hello")
    first = Settings(solver_version="0.1.0")
    assert night(tmp_path, first).ended == Counter(ok=1, rejected=1)
    again = night(tmp_path, first)
    assert (again.done_before, again.ended) == (2, Counter())
    for number, other in enumerate(
        (Settings(solver_version="0.1.0", extend=("auto",)), Settings(solver_version="0.2.0")), 2
    ):
        anew = night(tmp_path, other)
        assert (anew.done_before, anew.ended) == (0, Counter(ok=1, rejected=1))
        assert len(make_sharded(tmp_path / "store").versions(BOARD)) == number
    assert night(tmp_path, first).done_before == 2  # what it did is still done


@pytest.mark.parametrize("where", ["solve_into", "read_recording"])
def test_a_fault_of_the_program_is_a_failure_with_its_trace(
    tmp_path: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    def broken(*_arguments: object, **_more: object) -> None:
        raise ZeroDivisionError("as asked")

    (tmp_path / "spool").mkdir()
    shutil.copy(recorded[0], tmp_path / "spool" / "a.mcap")
    (tmp_path / "spool" / "foreign.mcap").write_bytes(b"hello")
    monkeypatch.setattr(task, where, broken)
    summary = night(tmp_path, Settings(solver_version="0.1.0"))
    assert summary.ended["failed"] >= 1
    assert summary.finished == 2  # the other recording has its end too
    index = Index(tmp_path / "store")
    ((reason, trace),) = index.ask("SELECT reason, trace FROM rows WHERE names[1] = 'a.mcap'")
    assert reason == "a fault of the program, ZeroDivisionError: as asked"
    assert trace.startswith("Traceback")
    assert "in broken" in trace
    assert trace.rstrip().endswith("ZeroDivisionError: as asked")


LIMITED = """
import resource, sys
from pathlib import Path
from gyrorig_solver.fleet.limits import limit_memory
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


@pytest.mark.parametrize(("more_bytes", "said"), [(16 << 20, "refused"), (256 << 20, "given")])
def test_a_process_gets_no_more_memory_than_its_limit(more_bytes: int, said: str) -> None:
    command = [sys.executable, "-c", LIMITED, str(more_bytes)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == said


def test_a_borrowed_process_is_limited_for_the_work_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []

    def look(one: Order) -> list[Any]:
        seen.append(resource.getrlimit(resource.RLIMIT_AS)[0])
        raise MemoryError

    before = resource.getrlimit(resource.RLIMIT_AS)
    monkeypatch.setattr(task, "_solve", look)
    settings = Settings(solver_version="0.1.0", memory_bytes=64 << 30)
    asked = order("k", tmp_path)
    told = carry_out_within(
        Order(asked.key, asked.batch, asked.store, asked.spool, (), ("00",), settings)
    )
    assert seen == [64 << 30]
    assert resource.getrlimit(resource.RLIMIT_AS) == before
    (row,) = told.rows
    assert (row.status, row.reason) == (
        "failed",
        "it needs more than 65536 MB of memory: --retry failed, and more with --memory",
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


def test_who_only_waited_beside_a_death_is_tried_alone_and_not_quarantined(
    tmp_path: Path,
) -> None:
    """A scheduler tells a worker's death to all that waited there, not only to who caused it."""
    beside: dict[str, list[int]] = {}
    lane = Lane(AtOnce, holds=4, deaths=(DiedError,))

    def work(one: Order) -> Outcome:
        beside.setdefault(one.key, []).append(len(lane.held))
        if one.key == "poison" or (one.key.startswith("near") and len(beside[one.key]) == 1):
            raise DiedError
        return Outcome(one.key, (row_of(one, "rejected", reason="as asked"),))

    lane.work = work
    orders = [order(key, tmp_path) for key in ("a", "near1", "poison", "near2", "b", "c", "d")]
    told = {one.key: one for one in through(orders, [lane]) if isinstance(one, Outcome)}
    ended = {key: one.rows[0].status for key, one in told.items()}
    assert ended == {
        one.key: "quarantined" if one.key == "poison" else "rejected" for one in orders
    }
    assert {key: len(tries) for key, tries in beside.items() if len(tries) > 1} == {
        "near1": 2,
        "poison": 2,
        "near2": 2,
    }
    assert all(tries[1] == 0 for tries in beside.values() if len(tries) > 1)  # alone
