"""Deleting: oldest first, only by a written rule, and never what is cited."""

import hashlib
import os
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import pytest

from gyrorig_daemon.recorder import retention
from gyrorig_daemon.recorder.retention import RetentionResult, RetentionRules
from gyrorig_daemon.recorder.retention_memory import RetentionMemory, write_memory
from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk, DiskFile

DAY = 86_400
NOW = 1_790_000_000


class Full(Disk):
    """1000 bytes are free when nothing is there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def free_bytes(self, folder: Path) -> int:
        return 1000 - sum(path.stat().st_size for path in self._folder.glob("*.mcap"))


@pytest.fixture
def spool(tmp_path: Path) -> Path:
    """Five recordings of 100 bytes, a day apart; r0 is the oldest."""
    folder = tmp_path / "spool"
    folder.mkdir()
    first_seen_s = {f"r{k}.mcap": float(NOW + k * DAY) for k in range(5)}
    for k, (name, time_s) in enumerate(first_seen_s.items()):
        path = folder / name
        path.write_bytes(bytes([k]) * 100)
        os.utime(path, (time_s, time_s))
    write_memory(tmp_path / "retention.json", RetentionMemory(first_seen_s, {}))
    return folder


def apply_retention(
    folder: Path,
    rules: RetentionRules,
    stores: Sequence[Path],
    keep: Collection[Path] = (),
    *,
    now_s: float | None = None,
    disk: Disk = DISK,
) -> RetentionResult:
    return retention.apply_retention(
        folder,
        rules,
        stores,
        keep,
        memory_path=folder.parent / "retention.json",
        now_s=now_s,
        disk=disk,
    )


def left(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def store_citing(folder: Path, *words: str) -> Path:
    store = folder / "store"
    (store / "B-1").mkdir(parents=True)
    (store / "B-1" / "v0001.yaml").write_text("inputs:\n" + "\n".join(words))
    return store


def test_nothing_is_deleted_without_a_rule(spool: Path) -> None:
    assert apply_retention(spool, RetentionRules(), []).deleted == ()
    assert len(left(spool)) == 5


@pytest.mark.parametrize(
    ("rules", "gone"),
    [
        (RetentionRules(max_days=2.5), 2),
        (RetentionRules(max_bytes=350), 2),
        (RetentionRules(max_bytes=500), 0),
        (RetentionRules(max_days=3.5, max_bytes=250), 3),
    ],
)
def test_the_oldest_are_deleted_first(spool: Path, rules: RetentionRules, gone: int) -> None:
    deletions = apply_retention(spool, rules, [], now_s=NOW + 5 * DAY)
    assert [path.name for path in deletions.deleted] == [f"r{k}.mcap" for k in range(gone)]
    assert deletions.deleted_bytes == 100 * gone
    assert left(spool) == [f"r{k}.mcap" for k in range(gone, 5)]


def test_deletes_until_there_is_space(spool: Path) -> None:
    apply_retention(spool, RetentionRules(room_bytes=650), [], disk=Full(spool))
    assert left(spool) == ["r2.mcap", "r3.mcap", "r4.mcap"]


def test_cited_recordings_are_kept(spool: Path, tmp_path: Path) -> None:
    digest = hashlib.sha256((spool / "r0.mcap").read_bytes()).hexdigest()
    store = store_citing(tmp_path, f"- {{name: 'other.mcap', sha256: '{digest}'}}", "- r1.mcap")
    deletions = apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert [path.name for path in deletions.cited] == ["r0.mcap", "r1.mcap"]
    assert left(spool) == ["r0.mcap", "r1.mcap"]


def test_a_broken_document_still_protects(spool: Path, tmp_path: Path) -> None:
    store = store_citing(tmp_path, "\x00 {{{ sha256:", hashlib.sha256(b"\x02" * 100).hexdigest())
    apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert left(spool) == ["r2.mcap"]


def test_a_missing_store_prevents_deletion(spool: Path, tmp_path: Path) -> None:
    with pytest.raises(MachineError, match="does not exist"):
        apply_retention(spool, RetentionRules(max_bytes=1), [tmp_path / "nowhere"])
    assert len(left(spool)) == 5


def test_a_store_that_is_not_mounted_prevents_deletion(spool: Path, tmp_path: Path) -> None:
    store = store_citing(tmp_path, "- r0.mcap")
    apply_retention(spool, RetentionRules(), [store])
    store.rename(tmp_path / "unmounted")
    store.mkdir()
    with pytest.raises(MachineError, match=r"had citations of recordings .* \(1\)") as error:
        apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert len(left(spool)) == 5
    assert "retention.json" in error.value.remedy
    store.rmdir()
    (tmp_path / "unmounted").rename(store)
    apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert left(spool) == ["r0.mcap"]


def test_a_store_that_is_not_mounted_at_the_first_check(spool: Path, tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    with pytest.raises(MachineError, match="may not be mounted"):
        apply_retention(spool, RetentionRules(max_bytes=1), [tmp_path / "store"])
    assert len(left(spool)) == 5
    (tmp_path / "store" / "new-store").touch()
    apply_retention(spool, RetentionRules(max_bytes=1), [tmp_path / "store"])
    assert left(spool) == []


def test_a_store_that_was_emptied_on_purpose(spool: Path, tmp_path: Path) -> None:
    store = store_citing(tmp_path, "- r0.mcap")
    apply_retention(spool, RetentionRules(), [store])
    (store / "B-1" / "v0001.yaml").unlink()
    (tmp_path / "retention.json").unlink()
    apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert left(spool) == []


def test_a_damaged_memory_prevents_deletion(spool: Path, tmp_path: Path) -> None:
    (tmp_path / "retention.json").write_text("{")
    with pytest.raises(MachineError, match="deletes no old recordings"):
        apply_retention(spool, RetentionRules(max_bytes=1), [])
    assert len(left(spool)) == 5


def test_an_unreadable_store_prevents_deletion(spool: Path, tmp_path: Path) -> None:
    store = store_citing(tmp_path)
    (store / "B-1" / "v0002.yaml").symlink_to(tmp_path / "nowhere")
    with pytest.raises(MachineError, match="deletes no old recordings"):
        apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert len(left(spool)) == 5


def test_citations_behind_links_count(spool: Path, tmp_path: Path) -> None:
    far = store_citing(tmp_path, "r0.mcap")
    store = tmp_path / "linked"
    store.mkdir()
    (store / "more").symlink_to(far)
    (far / "round").symlink_to(store)
    apply_retention(spool, RetentionRules(max_bytes=1), [store])
    assert left(spool) == ["r0.mcap"]


def test_the_running_session_and_open_files_are_kept(spool: Path) -> None:
    open_file = DiskFile(spool / "r5.mcap")
    open_file.write(b"x" * 100)
    os.utime(spool / "r5.mcap", (NOW - DAY, NOW - DAY))
    apply_retention(spool, RetentionRules(max_bytes=1), [], keep=[spool / "r3.mcap"])
    assert left(spool) == ["r3.mcap", "r5.mcap"]
    open_file.close()


def test_one_recording_of_the_future_deletes_no_other(spool: Path) -> None:
    """It was made while the clock was years ahead; the clock is right again."""
    os.utime(spool / "r4.mcap", (NOW * 2, NOW * 2))
    rules = RetentionRules(max_days=3.5)
    assert apply_retention(spool, rules, [], now_s=NOW + 3 * DAY).deleted == ()
    deletions = apply_retention(spool, rules, [], now_s=NOW + 4 * DAY)
    assert [path.name for path in deletions.deleted] == ["r0.mcap"]


def test_a_clock_jump_deletes_nothing(spool: Path) -> None:
    for k in range(5):  # all recorded in 1970, by a Pi without a clock
        os.utime(spool / f"r{k}.mcap", (k * DAY, k * DAY))
    assert apply_retention(spool, RetentionRules(max_days=100), [], now_s=NOW).deleted == ()
    os.utime(spool / "r4.mcap", (NOW * 2, NOW * 2))  # and one in a far future
    assert apply_retention(spool, RetentionRules(max_days=1), [], now_s=None).deleted == ()
    assert len(left(spool)) == 5


def test_a_recording_from_before_the_synchronisation_is_new(spool: Path) -> None:
    """A computer without a clock was off for 100 days, and starts with the time of its end."""
    path = spool / "before.mcap"
    path.write_bytes(b"x" * 100)
    os.utime(path, (NOW - 96 * DAY, NOW - 96 * DAY))
    rules = RetentionRules(max_days=90)
    assert apply_retention(spool, rules, [], now_s=None).deleted == ()
    assert apply_retention(spool, rules, [], now_s=NOW + 4 * DAY).deleted == ()
    assert apply_retention(spool, RetentionRules(max_bytes=500), []).deleted == (spool / "r0.mcap",)
    newest = spool / "newest.mcap"
    newest.write_bytes(b"y" * 100)
    os.utime(newest, (NOW + 95 * DAY, NOW + 95 * DAY))
    apply_retention(spool, rules, [], now_s=NOW + 95 * DAY)
    assert left(spool) == ["newest.mcap"]


def test_originals_are_deleted_with_their_notes(spool: Path) -> None:
    aside = spool / "unclean"
    aside.mkdir()
    for name in ("u.mcap.part", "u.mcap.part.json"):
        (aside / name).write_bytes(b"u")
        os.utime(aside / name, (NOW - DAY, NOW - DAY))
    apply_retention(spool, RetentionRules(max_bytes=500), [], now_s=NOW - DAY)
    assert left(aside) == []
    assert len(left(spool)) == 6


def test_links_and_other_files_are_ignored(spool: Path, tmp_path: Path) -> None:
    (tmp_path / "far.mcap").write_bytes(b"far")
    (spool / "link.mcap").symlink_to(tmp_path / "far.mcap")
    (spool / "notes.txt").write_text("mine")
    apply_retention(spool, RetentionRules(max_bytes=1), [])
    assert left(spool) == ["link.mcap", "notes.txt"]
    assert (tmp_path / "far.mcap").exists()


@pytest.mark.parametrize(
    "make", [lambda: RetentionRules(max_days=0), lambda: RetentionRules(max_bytes=-1)]
)
def test_rules_that_would_delete_all(make: Callable[[], RetentionRules]) -> None:
    with pytest.raises(UsageError, match="deleting old recordings"):
        make()
