"""A store in a bucket: claims without locks, batches that died or slept, rows counted once."""

import shutil
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.store import STORE_FILE
from gyrorig_solver.fleet import bucket_ledger
from gyrorig_solver.fleet.batch import Summary, run_batch
from gyrorig_solver.fleet.bucket_index import BucketIndex
from gyrorig_solver.fleet.bucket_ledger import BucketClaims, BucketJournal
from gyrorig_solver.fleet.bucket_store import make_store, store_at
from gyrorig_solver.fleet.lanes import Lane
from gyrorig_solver.fleet.shelf import Chosen, newest, rebuild_index, versions_of
from gyrorig_solver.fleet.task import Settings
from gyrorig_solver.fleet.verifying import verify
from gyrorig_solver.places.bucket import Bucket
from gyrorig_solver.places.choose import place_at
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place

BOARD = BoardId("GY80-1")
SETTINGS = Settings(solver_version="0.1.0")


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    place = place_at(f"memory://{tmp_path.name}/fleet")
    assert isinstance(place, Bucket)
    return place


def night(spool: Place | Path, store: Place, **more: object) -> Summary:
    # In threads: the bucket of these tests is of this process.
    lanes = [Lane(lambda: ThreadPoolExecutor(1)) for _ in range(2)]
    return run_batch(spool, store, SETTINGS, lanes, **more)  # type: ignore[arg-type]


def test_a_night_from_a_bucket_into_a_bucket(bucket: Bucket, recorded: list[Path]) -> None:
    spool, store = (
        Bucket("memory", f"{bucket.prefix}/spool"),
        Bucket("memory", f"{bucket.prefix}/s"),
    )
    for number, path in enumerate(recorded):
        spool.put(f"day{number}/{path.name}", path.read_bytes())
    spool.put("foreign.mcap", b"hello")
    spool.put("day0/b.mcap.part", b"x")
    spool.put("unclean/b.mcap", b"x")
    first = night(spool, store)
    assert (first.ended, first.put_off_why) == (Counter(ok=2, rejected=1), "")
    assert first.spool.unfinished == 1
    assert len(store_at(store).versions(BOARD)) == 2
    found = verify(store)
    assert (found.faults, found.sealed) == ((), 4)
    # Two workers: which of the two nights got the second version is chance; the later is newest.
    starts = {one["version"]: one["start"] for one in versions_of(store, Chosen(), 10)}
    assert [one["version"] for one in newest(store, Chosen(), 10)] == [max(starts, key=starts.get)]  # type: ignore[arg-type]
    assert not list(store.entries("journal"))
    assert not list(store.entries("alive"))
    again = night(spool, store)
    assert (again.done_before, again.to_do) == (3, 0)
    assert rebuild_index(store) == 2
    assert verify(store).faults == ()
    assert night(spool, store).done_before == 3


def test_claims_outlive_nobody_but_a_living_batch(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_store(bucket)
    rival, mine = BucketClaims(bucket, "rival"), BucketClaims(bucket, "mine")
    with rival.begin(BucketIndex(bucket)), mine.begin(BucketIndex(bucket)):
        assert rival.take("aa1")
        assert rival.take("aa1")  # it is its own
        assert not mine.take("aa1")
        rival.done("aa1")
        rival.take("aa2")
        assert not mine.take("aa2")
        rival.give_back("aa2")
        rival.give_back("aa3")  # which it never had
        assert mine.take("aa2")
        rival.take("aa4")
    third = BucketClaims(bucket, "third")
    with third.begin(BucketIndex(bucket)):
        assert not list(bucket.entries("claims"))  # nobody ran when it began
    rival.take("aa4")
    monkeypatch.setattr(bucket_ledger, "DEAD_AFTER_S", -1.0)  # everyone is taken for dead
    assert third.take("aa4")
    assert [one.name for one in bucket.entries("claims")] == [
        "claims/aa/aa4.0000",
        "claims/aa/aa4.0001",
    ]


def test_a_batch_that_begins_beside_another_keeps_its_sign_of_life(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_store(bucket)
    living, late = bucket_ledger.living, BucketClaims(bucket, "late")
    journals: list[BucketJournal] = []

    def asked(place: Place, probe: str) -> set[str]:
        found = living(place, probe)
        monkeypatch.setattr(bucket_ledger, "living", living)
        journals.append(late.begin(BucketIndex(bucket)))
        assert late.take("aa1")
        return found

    monkeypatch.setattr(bucket_ledger, "living", asked)
    early = BucketClaims(bucket, "early")
    with early.begin(BucketIndex(bucket)), journals[0]:
        assert living(bucket, "early") == {"early", "late"}
        assert not early.take("aa1")


def test_a_dead_batchs_rows_are_folded_and_a_sleepers_later_ones_too(bucket: Bucket) -> None:
    make_store(bucket)
    sleeper = BucketClaims(bucket, "sleeper")
    journal = sleeper.begin(BucketIndex(bucket))
    journal.add([row("k1")])
    bucket.remove(["alive/sleeper"])  # its lid is shut
    index = BucketIndex(bucket)
    assert index.fold_left_behind() == 1
    journal.add([row("k2")])
    with journal:
        pass
    assert index.fold_left_behind() == 1
    assert index.done() == {"k1", "k2"}
    assert index.fold_left_behind() == 0


def test_a_piece_that_a_lost_answer_left_behind_is_not_overwritten(bucket: Bucket) -> None:
    make_store(bucket)
    journal = BucketClaims(bucket, "night").begin(BucketIndex(bucket))
    with journal:
        bucket.put("journal/night-0000/000000.jsonl", b"")
        journal.add([row("k1")])
    assert BucketIndex(bucket).done() == {"k1"}


@pytest.mark.parametrize("doing", [BucketIndex.fold_left_behind, BucketIndex.done])
def test_a_part_that_another_folds_while_it_is_read_is_in_the_index_once(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch, doing: Callable[[BucketIndex], object]
) -> None:
    make_store(bucket)
    with BucketClaims(bucket, "night").begin(BucketIndex(bucket)) as journal:
        journal.add([row("k1")])
    read = Bucket.read

    def late(self: Bucket, name: str) -> bytes | None:
        if name.startswith("journal/"):
            monkeypatch.setattr(Bucket, "read", read)
            assert BucketIndex(bucket).fold_left_behind() == 1
        return read(self, name)

    monkeypatch.setattr(Bucket, "read", late)
    assert doing(BucketIndex(bucket)) in (1, {"k1"})
    assert BucketIndex(bucket).ask("SELECT key FROM all_rows") == [("k1",)]
    assert not list(bucket.entries("journal"))


def test_work_that_a_waking_batch_did_too_has_one_version(
    bucket: Bucket, recorded: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two batches solve one recording at once, each thinking the other dead."""
    spool = tmp_path / "spool"
    spool.mkdir()
    shutil.copy(recorded[0], spool / "a.mcap")
    with monkeypatch.context() as patched, ThreadPoolExecutor(2) as both:
        patched.setattr(bucket_ledger, "DEAD_AFTER_S", -1.0)
        told = [one.result() for one in [both.submit(night, spool, bucket) for _ in range(2)]]
    assert sum(one.ended["ok"] for one in told) >= 1
    assert len(store_at(bucket).versions(BOARD)) == 1
    assert verify(bucket).versions == 1


def test_an_outage_of_a_moment_costs_nothing(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    for number in range(12):
        (spool / f"{number}.mcap").write_bytes(b"%d" % number)
    calls = 0
    put_new = Bucket.put_new

    def sometimes(self: Bucket, name: str, data: bytes) -> bool:
        nonlocal calls
        calls += 1
        if calls % 3 == 0:
            raise MachineError("the bucket does not answer", "wait")
        return put_new(self, name, data)

    make_store(bucket)
    with monkeypatch.context() as patched:
        patched.setattr(Bucket, "put_new", sometimes)
        first = night(spool, bucket)
    assert sum(first.ended.values()) + first.put_off == 12
    assert first.in_part
    last = night(spool, bucket)
    assert last.done_before + last.finished == 12
    assert last.put_off == 0
    assert BucketIndex(bucket).ask("SELECT count(*), count(DISTINCT key) FROM rows") == [(12, 12)]
    assert verify(bucket).faults == ()


def test_a_recording_that_the_bucket_does_not_give_is_put_off(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool, store = (Bucket("memory", f"{bucket.prefix}/{name}") for name in ("spool", "store"))
    for name in ("a.mcap", "b.mcap"):
        spool.put(name, name.encode())
    local = Bucket.local

    def given(self: Bucket, name: str) -> object:
        if name == "a.mcap":
            raise MachineError("the bucket does not answer", "wait")
        return local(self, name)

    monkeypatch.setattr(Bucket, "local", given)
    first = night(spool, store)
    assert (first.ended, first.put_off, first.not_begun) == (Counter(rejected=1), 1, 0)
    assert "does not answer" in first.put_off_why
    monkeypatch.setattr(Bucket, "local", local)
    assert night(spool, store).ended == Counter(rejected=1)
    assert BucketIndex(store).ask("SELECT count(*) FROM rows") == [(2,)]


def test_a_newer_or_foreign_store_is_refused_in_one_line(bucket: Bucket) -> None:
    bucket.put("thesis.tex", b"x")
    with pytest.raises(UsageError, match=r"holds thesis\.tex"):
        make_store(bucket)
    bucket.put(STORE_FILE, b'schema: "gyrorig/store/9"\n')
    with pytest.raises(InputError, match="gyrorig/store/9"):
        make_store(bucket)
    with pytest.raises(UsageError, match="no store of a fleet"):
        verify(Folder(Path("/nonexistent")))
