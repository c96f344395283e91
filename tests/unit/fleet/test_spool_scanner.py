"""What there is to do: sessions of parts, copies, damage, and what is remembered of them."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.messages import SESSION_EVENT_TOPIC, EventKind, SessionEvent
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver.fleet.jobs.recording_cache import RecordingCache
from gyrorig_solver.fleet.jobs.spool_scanner import (
    SpooledRecording,
    group_into_sessions,
    read_recordings,
    scan_spool,
)
from gyrorig_solver.storage import Folder, storage_at


def write(path: Path, session: str = "s", part: int = 0, events: int = 1, anchor: int = 1) -> Path:
    metadata = {
        "session": session,
        "rig": "r",
        "part": str(part),
        "anchor_utc_ns": str(anchor),
        "anchor_monotonic_raw_ns": "1",
    }
    with RecordingWriter(path, {"gyrorig": metadata}) as writer:
        for n in range(events):
            text = "note " * 1000 + str(n)
            event = SessionEvent(1_000_000_000 + n, int(EventKind.NOTE), "", text)
            writer.write(SESSION_EVENT_TOPIC, event)
    return path


def read(folder: Path) -> Iterator[SpooledRecording]:
    return read_recordings(Folder(folder), scan_spool(folder).recordings)


def names(folder: Path) -> list[list[str]]:
    listing = group_into_sessions(read(folder))
    return [[recording.path.name for recording in session.recordings] for session in listing]


def test_parts_of_a_session_are_one_job(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", "s", 0)
    write(tmp_path / "a_p001.mcap", "s", 1)
    write(tmp_path / "b.mcap", "t", 0)
    write(tmp_path / "c.mcap", "s", 0, anchor=2)  # another day's session of that name
    assert names(tmp_path) == [["a.mcap", "a_p001.mcap"], ["b.mcap"], ["c.mcap"]]


def test_the_same_bytes_count_once(tmp_path: Path) -> None:
    shutil.copy(write(tmp_path / "a.mcap"), tmp_path / "b.mcap")
    assert names(tmp_path) == [["a.mcap"]]


def test_a_shorter_copy_is_refused_and_not_joined(tmp_path: Path) -> None:
    whole = write(tmp_path / "b.mcap", events=3)
    (tmp_path / "a.mcap").write_bytes(whole.read_bytes()[:-100])
    listing = group_into_sessions(read(tmp_path))
    assert [s.rejection for s in listing] == ["a.mcap is a shorter copy of b.mcap", ""]


def test_unfinished_recordings_are_left_alone_and_counted(tmp_path: Path) -> None:
    (tmp_path / "a.mcap.part").write_bytes(b"x")
    (tmp_path / "notes.txt").write_bytes(b"x")
    (tmp_path / "unclean").mkdir()  # the daemon's originals of what it recovered
    (tmp_path / "unclean" / "b.mcap.part").write_bytes(b"x")
    listing = scan_spool(tmp_path)
    assert (listing.recordings, listing.unfinished, listing.abandoned) == ((), 1, 0)
    os.utime(tmp_path / "a.mcap.part", (1, 1))
    assert scan_spool(tmp_path).abandoned == 1


def test_finished_parts_wait_for_an_unfinished_part(tmp_path: Path) -> None:
    for name in ("a.mcap", "a_p001.mcap", "ab.mcap", "b_p001.mcap", "deep/a.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "a_p002.mcap.part").write_bytes(b"x")
    listing = scan_spool(tmp_path)
    assert [entry.name for entry in listing.recordings] == ["ab.mcap", "b_p001.mcap", "deep/a.mcap"]
    assert (listing.waiting_parts, listing.unfinished, listing.abandoned) == (2, 1, 0)
    os.utime(tmp_path / "a_p002.mcap.part", (1, 1))  # its writer is gone
    listing = scan_spool(tmp_path)
    assert len(listing.recordings) == 5
    assert (listing.waiting_parts, listing.unfinished, listing.abandoned) == (0, 1, 1)


def test_loops_of_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path)
    write(tmp_path / "a.mcap")
    assert len(scan_spool(tmp_path).recordings) == 1


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"does not exist\. Choose a folder"):
        scan_spool(tmp_path / "none")


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 99]
)
def test_an_invalid_recording_is_its_own_session(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    (session,) = group_into_sessions(read(tmp_path))
    assert session.recordings[0].session == ""


def test_a_recording_is_cached_until_it_changes(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    cache_file = tmp_path / "heads.sqlite"
    listing = scan_spool(tmp_path)
    (known,) = read(tmp_path)
    with RecordingCache(cache_file, "here") as cache:
        assert cache.split_known(listing) == ([], list(listing.recordings))
        assert list(cache.remember([known])) == [known]
    with RecordingCache(cache_file, "here") as cache:
        assert cache.split_known(listing) == ([known], [])
        os.utime(path, ns=(1, 1))
        changed = scan_spool(tmp_path)
        assert cache.split_known(changed) == ([], list(changed.recordings))
    with RecordingCache(cache_file, "elsewhere") as cache:
        assert cache.split_known(listing) == ([], list(listing.recordings))


def test_a_lost_or_invalid_cache_is_not_an_error(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    cache_file = tmp_path / "heads.sqlite"
    cache_file.write_bytes(b"no database at all, but long enough to be looked at" * 10)
    listing = scan_spool(tmp_path)
    (known,) = read(tmp_path)
    with RecordingCache(cache_file, "here") as cache:
        assert cache.split_known(listing) == ([], list(listing.recordings))
        assert list(cache.remember([known])) == [known]


def rejections(folder: Path) -> dict[str, str]:
    sessions = group_into_sessions(read(folder), Folder(folder))
    return {session.recordings[0].path.as_posix(): session.rejection for session in sessions}


def test_a_copy_is_the_beginning_of_the_whole(tmp_path: Path) -> None:
    whole = write(tmp_path / "b.mcap", events=3)
    (tmp_path / "a.mcap").write_bytes(whole.read_bytes()[:-100])
    assert rejections(tmp_path) == {"a.mcap": "a.mcap is a shorter copy of b.mcap", "b.mcap": ""}


def test_a_larger_forgery_in_the_same_folder_does_not_displace(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", events=2)
    write(tmp_path / "b.mcap", events=9)  # says that it is the same session
    for reason in rejections(tmp_path).values():
        assert reason == (
            "a.mcap and b.mcap differ, but both claim to be the same part of one session"
        )
    assert len(rejections(tmp_path)) == 2


def test_imports_of_the_same_name_are_different_sessions(tmp_path: Path) -> None:
    """Before, two imported logs of the same name rejected each other."""
    write(tmp_path / "monday.mcap", "log", events=2, anchor=0)
    write(tmp_path / "friday.mcap", "log", events=9, anchor=0)
    assert rejections(tmp_path) == {"friday.mcap": "", "monday.mcap": ""}


def test_a_forgery_in_another_folder_changes_nothing(tmp_path: Path) -> None:
    for lab in ("lab1", "lab2"):
        (tmp_path / lab).mkdir()
    write(tmp_path / "lab1" / "a.mcap", events=2)
    write(tmp_path / "lab1" / "a_p001.mcap", "s", 1)
    write(tmp_path / "lab2" / "a.mcap", events=9)
    assert rejections(tmp_path) == {"lab1/a.mcap": "", "lab2/a.mcap": ""}


def test_a_missing_bucket_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="does not exist"):
        scan_spool(storage_at(f"memory://{tmp_path.name}-nosuch/recordings"))
