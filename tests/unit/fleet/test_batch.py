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
from tests.unit.fleet.test_spool import write

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.store import STORE_FILE, make_sharded
from gyrorig_solver.fleet.batch import Shard, run_batch
from gyrorig_solver.fleet.claims import Claims
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.lanes import Lane, PutOff, local_lanes, through
from gyrorig_solver.fleet.task import Order, Outcome, Settings, carry_out, row_of
from gyrorig_solver.fleet.verifying import verify
from gyrorig_solver.places.folder import Folder

BOARD = BoardId("GY80-1")
SETTINGS = Settings(solver_version="0.1.0")
GIGABYTES = 1 << 30


def order(key: str, store: Path, *paths: Path) -> Order:
    names = tuple(PurePosixPath(path) for path in paths)
    return Order(key, "night", Folder(store), Folder(Path("/")), names, ("00",), SETTINGS)


def night(spool: Path, store: Path, workers: int = 1, **more: object):  # type: ignore[no-untyped-def]
    return run_batch(spool, store, SETTINGS, local_lanes(workers, 4 * GIGABYTES), **more)  # type: ignore[arg-type]


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


def test_every_recording_comes_to_one_end_once(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    first = night(spool, store)
    assert first.ended == Counter(ok=2, rejected=3)
    assert first.in_part
    kept = Index(store).ask("SELECT status, reason, board, version, trust FROM rows ORDER BY ALL")
    assert Counter(status for status, *_ in kept) == Counter(ok=2, rejected=3)
    assert all(reason for status, reason, *_ in kept if status == "rejected")
    assert [path.name for path in make_sharded(store).folder_of(BOARD).glob("*.yaml")]
    assert verify(store).faults == ()

    second = night(spool, store)
    assert (second.done_before, second.to_do, second.finished) == (5, 0, 0)
    assert not second.in_part
    again = night(spool, store, retry=["rejected"])
    assert again.ended == Counter(rejected=3)
    assert len(make_sharded(store).versions(BOARD)) == 2
    assert len(Index(store).ask("SELECT * FROM rows WHERE status = 'ok'")) == 2


def test_shards_share_the_work(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    ended: Counter[str] = Counter()
    for number in (1, 2, 3):
        ended += night(spool, store, shard=Shard(number, 3)).ended
    assert ended == Counter(ok=2, rejected=3)


def test_another_batchs_claims_are_kept_while_it_runs(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    make_sharded(store)
    rival = Claims(store, "rival")
    with rival.begin(Index(store)):
        keys = [path.name for path in (store / "claims").glob("??/*")]
        assert keys == []
        mine = Claims(store, "mine")
        assert rival.take("aa1")
        assert not mine.take("aa1")
        rival.done("aa1")
        assert not mine.take("aa1")
        assert rival.take("aa2")
    assert mine.take("aa2")  # the rival died with it
    assert not mine.take("aa1")  # it had done it
    mine.give_back("aa2")
    with Claims(store, "next").begin(Index(store)):
        assert not list((store / "claims").glob("??/*"))


def test_a_version_without_its_row_is_found_again(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    night(spool, store)
    shutil.rmtree(store / "index")  # as if each batch had died before its row
    shutil.rmtree(store / "journal")
    again = night(spool, store)
    assert again.ended == Counter(ok=2, rejected=3)
    assert len(make_sharded(store).versions(BOARD)) == 2
    assert verify(store).faults == ()


def test_two_boards_with_one_name_are_not_mixed(
    spool: Path, tmp_path: Path, recorded: list[Path]
) -> None:
    store = tmp_path / "store"
    night(spool, store)
    (path,) = [v.path for v in make_sharded(store).versions(BOARD)][-1:]
    text = path.read_text(encoding="utf-8")
    uid = json.loads(text.split("uid: ")[1].splitlines()[0])
    path.write_text(text.replace(uid, "another"), encoding="utf-8")
    told = carry_out(order("k", store, recorded[0]))
    (row,) = told.rows
    # its digest is not the order's: what has changed is refused before anything is solved
    assert (row.status, "changed since" in row.reason) == ("rejected", True)
    from gyrorig_protocol.recording.reader import read_recording  # noqa: PLC0415

    digest = read_recording(recorded[0]).sha256
    told = carry_out(replace(order("k", store, recorded[0]), digests=(digest,)))
    assert "two boards have one name" in told.rows[0].reason


def test_a_deadline_fails_the_work_and_keeps_the_trace(
    recorded: list[Path], tmp_path: Path
) -> None:
    make_sharded(tmp_path / "store")
    from gyrorig_protocol.recording.reader import read_recording  # noqa: PLC0415

    digests = (read_recording(recorded[0]).sha256,)
    hurried = Settings(solver_version="0.1.0", deadline_s=0.02)
    told = carry_out(
        replace(order("k", tmp_path / "store", recorded[0]), digests=digests, settings=hurried)
    )
    (row,) = told.rows
    assert row.status == "failed"
    assert "0.02 s" in row.reason
    assert "TooLongError" in row.trace


def test_a_row_of_a_board_without_a_calibration_is_written(tmp_path: Path) -> None:
    make_sharded(tmp_path)
    index = Index(tmp_path)
    with Claims(tmp_path, "night").begin(index) as journal:
        journal.add([row_of(order("k", tmp_path), "rejected", reason="no motion", board=BOARD)])
    assert index.ask("SELECT board, reason FROM rows") == [(BOARD, "no motion")]


def dies_of_poison(one: Order) -> Outcome:
    if one.key.startswith("poison"):
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome(one.key, (row_of(one, "rejected", reason="as asked"),))


def refuses(one: Order) -> Outcome:
    raise MachineError("the disk is full", "make room")


def lanes(count: int, work: object) -> list[Lane]:
    return [Lane(lambda: ProcessPoolExecutor(1), work=work) for _ in range(count)]  # type: ignore[arg-type]


def test_work_that_kills_its_worker_twice_is_quarantined_and_no_other(tmp_path: Path) -> None:
    orders = [order(f"{'poison' if n % 5 == 0 else 'k'}{n}", tmp_path) for n in range(20)]
    told = {
        one.key: one
        for one in through(orders, lanes(2, dies_of_poison))
        if isinstance(one, Outcome)
    }
    assert set(told) == {one.key for one in orders}
    for key, outcome in told.items():
        wanted = "quarantined" if key.startswith("poison") else "rejected"
        assert [row.status for row in outcome.rows] == [wanted]


def test_what_the_machine_refuses_is_put_off(tmp_path: Path) -> None:
    told = list(through([order("k", tmp_path)], lanes(1, refuses)))
    assert [type(one) for one in told] == [PutOff]


def test_work_that_no_worker_takes_is_put_off_and_the_batch_ends(tmp_path: Path) -> None:
    def none() -> ProcessPoolExecutor:
        raise OSError("no more processes")

    orders = [order(f"k{number}", tmp_path) for number in range(5)]
    told = list(through(orders, [Lane(none), Lane(none)]))
    assert [type(one) for one in told] == [PutOff] * 5


def test_a_store_that_takes_nothing_ends_the_batch_early(tmp_path: Path) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    for number in range(60):
        (spool / f"{number}.mcap").write_bytes(b"%d" % number)
    summary = run_batch(spool, tmp_path / "store", SETTINGS, lanes(2, refuses))
    assert summary.gave_up
    assert 20 <= summary.put_off <= 22
    assert summary.not_begun >= 38
    assert "make room" in summary.put_off_why
    after = night(spool, tmp_path / "store")
    assert after.ended == Counter(rejected=60)


def test_a_folder_of_something_else_is_no_store(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x", encoding="utf-8")
    with pytest.raises(UsageError, match=r"holds thesis\.tex"):
        make_sharded(tmp_path)


def test_a_newer_store_is_refused(tmp_path: Path) -> None:
    (tmp_path / STORE_FILE).write_text('schema: "gyrorig/store/9"\n', encoding="utf-8")
    with pytest.raises(InputError, match="gyrorig/store/9"):
        make_sharded(tmp_path)


def test_a_batch_killed_again_and_again_loses_nothing_and_does_nothing_twice(
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
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 5, done.stderr
    kept = Index(store).ask("SELECT status FROM rows")
    assert Counter(status for (status,) in kept) == Counter(ok=2, rejected=6)
    assert len(make_sharded(store).versions(BOARD)) == 2
    assert verify(store).faults == ()
    assert not list((store / "journal").iterdir())


def lines(store: Path) -> int:
    """Count the lines of journals, one of which may be folded while we look."""
    found = 100 * len(list((store / "index").glob("*.parquet")))
    for path in (store / "journal").glob("*.jsonl"):
        with contextlib.suppress(FileNotFoundError):
            found += path.read_bytes().count(b"\n")
    return found


def test_two_batches_at_once_do_everything_once(spool: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    command = [str(Path(sys.executable).with_name("gyrorig")), "batch", "--workers", "1", "--json"]
    command += ["--spool", str(spool), "--store", str(store)]
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    told = [one.communicate() for one in both]
    ended: Counter[str] = Counter()
    for out, err in told:
        assert out, err
        ended += Counter(json.loads(out)["ended"])
    assert ended == Counter(ok=2, rejected=3)
    assert len(make_sharded(store).versions(BOARD)) == 2
    assert verify(store).faults == ()
