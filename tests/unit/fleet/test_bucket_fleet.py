"""A store in a bucket: claims without locks, batches that died or slept, rows counted once."""

import shutil
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from uuid import uuid4

import pytest
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import STORE_FILE, CalibrationStore, create_store
from gyrorig_solver.fleet.jobs import BatchSummary, SolveSettings, run_batch
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.store import StoreIndex, coordination, rebuild_index, verify
from gyrorig_solver.fleet.store.coordination import BatchClaims, RowJournal
from gyrorig_solver.fleet.store.store_queries import VersionFilter, all_versions, newest_versions
from gyrorig_solver.storage import Folder, Storage, storage_at
from gyrorig_solver.storage.bucket import Bucket

BOARD = BoardId("GY80-1")
SETTINGS = SolveSettings(solver_version="0.1.0", extend=())


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    storage = storage_at(f"memory://{tmp_path.name}/fleet")
    assert isinstance(storage, Bucket)
    return storage


def night(spool: Storage | Path, store: Storage, **more: object) -> BatchSummary:
    # In threads: the bucket of these tests is of this process.
    pools = [WorkerPool(lambda: ThreadPoolExecutor(1)) for _ in range(2)]
    return run_batch(spool, store, SETTINGS, pools, **more)  # type: ignore[arg-type]


def take_all_for_dead(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let all batches be on another machine, which has been silent for long."""
    monkeypatch.setattr(coordination, "this_machine", lambda: uuid4().hex)
    monkeypatch.setattr(coordination, "HEARTBEAT_TIMEOUT_S", -1.0)


@pytest.mark.long
def test_a_batch_from_a_bucket_into_a_bucket(bucket: Bucket, recorded: list[Path]) -> None:
    spool, store = (
        Bucket("memory", f"{bucket.prefix}/spool"),
        Bucket("memory", f"{bucket.prefix}/s"),
    )
    for number, path in enumerate(recorded):
        spool.write(f"day{number}/{path.name}", path.read_bytes())
    spool.write("foreign.mcap", b"hello")
    spool.write("day0/b.mcap.part", b"x")
    spool.write("unclean/b.mcap", b"x")
    first = night(spool, store)
    assert (first.sessions_by_status, first.deferral_reason) == (Counter(ok=2, rejected=1), "")
    assert first.spool.unfinished == 1
    assert len(CalibrationStore(store).versions(BOARD)) == 2
    result = verify(store)
    assert (result.faults, result.manifest_files) == ((), 4)
    # Two workers: which of the two nights got the second version is chance; the later is newest.
    starts = {item["version"]: item["start"] for item in all_versions(store, VersionFilter(), 10)}
    assert [item["version"] for item in newest_versions(store, VersionFilter(), 10)] == [
        max(starts, key=lambda version: starts[version])
    ]
    assert not list(store.list_files("journal"))
    assert not list(store.list_files("alive"))
    again = night(spool, store)
    assert (again.done_before, again.to_do) == (3, 0)
    assert rebuild_index(store) == 2
    assert verify(store).faults == ()
    assert night(spool, store).done_before == 3


def test_claims_are_kept_only_while_a_batch_lives(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    create_store(bucket)
    other, mine = BatchClaims(bucket, "rival"), BatchClaims(bucket, "mine")
    with other.begin_batch(), mine.begin_batch():
        assert other.try_claim("aa1")
        assert other.try_claim("aa1")  # it is its own
        assert not mine.try_claim("aa1")
        other.mark_done("aa1")
        other.try_claim("aa2")
        assert not mine.try_claim("aa2")
        other.release("aa2")
        other.release("aa3")  # which it never had
        assert mine.try_claim("aa2")
        other.try_claim("aa4")
    third = BatchClaims(bucket, "third")
    with third.begin_batch():
        assert not list(bucket.list_files("claims"))  # nobody ran when it began
    other.try_claim("aa4")
    take_all_for_dead(monkeypatch)
    assert third.try_claim("aa4")
    assert [item.name for item in bucket.list_files("claims")] == [
        "claims/aa/aa4.0000",
        "claims/aa/aa4.0001",
    ]


def test_a_batch_that_starts_during_another_keeps_its_heartbeat(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    create_store(bucket)
    living, late = coordination.live_batches, BatchClaims(bucket, "late")
    journals: list[RowJournal] = []

    def answer(storage: Storage) -> set[str]:
        result = living(storage)
        monkeypatch.setattr(coordination, "live_batches", living)
        journals.append(late.begin_batch())
        assert late.try_claim("aa1")
        return result

    monkeypatch.setattr(coordination, "live_batches", answer)
    early = BatchClaims(bucket, "early")
    with early.begin_batch(), journals[0]:
        assert living(bucket) == {"early", "late"}
        assert not early.try_claim("aa1")


def test_rows_of_a_dead_batch_and_later_rows_of_a_sleeper_are_merged(bucket: Bucket) -> None:
    create_store(bucket)
    sleeper = BatchClaims(bucket, "sleeper")
    journal = sleeper.begin_batch()
    journal.add([row("k1")])
    bucket.remove(["alive/sleeper"])  # its lid is shut
    index = StoreIndex(bucket)
    assert index.merge_ended_batches() == 1
    journal.add([row("k2")])
    with journal:
        pass
    assert index.merge_ended_batches() == 1
    assert index.finished_keys() == {"k1", "k2"}
    assert index.merge_ended_batches() == 0


def test_an_object_of_a_put_with_a_lost_answer_is_not_overwritten(bucket: Bucket) -> None:
    create_store(bucket)
    journal = BatchClaims(bucket, "night").begin_batch()
    with journal:
        bucket.write("journal/night-000000.jsonl", b"")
        journal.add([row("k1")])
    assert StoreIndex(bucket).finished_keys() == {"k1"}


@pytest.mark.parametrize("doing", [StoreIndex.merge_ended_batches, StoreIndex.finished_keys])
def test_a_part_merged_by_another_batch_while_read_counts_once(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch, doing: Callable[[StoreIndex], object]
) -> None:
    create_store(bucket)
    with BatchClaims(bucket, "night").begin_batch() as journal:
        journal.add([row("k1")])
    read = Bucket.read

    def late(self: Bucket, name: str) -> bytes | None:
        if name.startswith("journal/"):
            monkeypatch.setattr(Bucket, "read", read)
            assert StoreIndex(bucket).merge_ended_batches() == 1
        return read(self, name)

    monkeypatch.setattr(Bucket, "read", late)
    assert doing(StoreIndex(bucket)) in (1, {"k1"})
    assert StoreIndex(bucket).query("SELECT key FROM all_rows") == [("k1",)]
    assert not list(bucket.list_files("journal"))


def test_a_job_repeated_by_a_waking_batch_has_one_version(
    bucket: Bucket, recorded: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two batches solve one recording at once, each thinking the other dead."""
    spool = tmp_path / "spool"
    spool.mkdir()
    shutil.copy(recorded[0], spool / "a.mcap")
    with monkeypatch.context() as patched, ThreadPoolExecutor(2) as processes:
        take_all_for_dead(patched)
        reported = [
            item.result() for item in [processes.submit(night, spool, bucket) for _ in range(2)]
        ]
    assert sum(item.sessions_by_status["ok"] for item in reported) >= 1
    assert len(CalibrationStore(bucket).versions(BOARD)) == 1
    assert verify(bucket).versions == 1


def test_a_brief_outage_loses_nothing(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    for number in range(12):
        (spool / f"{number}.mcap").write_bytes(b"%d" % number)
    calls = 0
    put_new = Bucket.write_new

    def sometimes(self: Bucket, name: str, data: bytes) -> bool:
        nonlocal calls
        calls += 1
        if calls % 3 == 0:
            raise MachineError("the bucket does not answer", "wait")
        return put_new(self, name, data)

    create_store(bucket)
    with monkeypatch.context() as patched:
        patched.setattr(Bucket, "write_new", sometimes)
        first = night(spool, bucket)
    assert sum(first.sessions_by_status.values()) + first.deferred == 12
    assert first.is_partial
    last = night(spool, bucket)
    assert last.done_before + last.finished == 12
    assert last.deferred == 0
    assert StoreIndex(bucket).query("SELECT count(*), count(DISTINCT key) FROM rows") == [(12, 12)]
    assert verify(bucket).faults == ()


def test_a_recording_that_the_bucket_does_not_deliver_is_deferred(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool, store = (Bucket("memory", f"{bucket.prefix}/{name}") for name in ("spool", "store"))
    for name in ("a.mcap", "b.mcap"):
        spool.write(name, name.encode())
    local = Bucket.local_copy

    def given(self: Bucket, name: str) -> object:
        if name == "a.mcap":
            raise MachineError("the bucket does not answer", "wait")
        return local(self, name)

    monkeypatch.setattr(Bucket, "local_copy", given)
    first = night(spool, store)
    assert (first.sessions_by_status, first.deferred, first.not_started) == (
        Counter(rejected=1),
        1,
        0,
    )
    assert "does not answer" in first.deferral_reason
    monkeypatch.setattr(Bucket, "local_copy", local)
    assert night(spool, store).sessions_by_status == Counter(rejected=1)
    assert StoreIndex(store).query("SELECT count(*) FROM rows") == [(2,)]


def test_a_newer_or_foreign_store_is_refused_in_one_line(bucket: Bucket) -> None:
    bucket.write("thesis.tex", b"x")
    with pytest.raises(UsageError, match=r"contains thesis\.tex"):
        create_store(bucket)
    bucket.write(STORE_FILE, b'schema: "gyrorig/store/9"\n')
    with pytest.raises(InputError, match="gyrorig/store/9"):
        create_store(bucket)
    with pytest.raises(UsageError, match="not a calibration store"):
        verify(Folder(Path("/nonexistent")))
