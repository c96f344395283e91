"""What there is to do: sessions of parts, copies, damage, and what is remembered of them."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.recording.messages import SESSION_EVENT_TOPIC, EventKind, SessionEvent
from gyrorig_protocol.recording.writer import RecordingWriter
from gyrorig_solver.fleet.heads import Heads
from gyrorig_solver.fleet.spool import Spooled, look, read_all, sessions
from gyrorig_solver.places.folder import Folder


def write(path: Path, session: str = "s", part: int = 0, events: int = 1, anchor: int = 1) -> Path:
    own = {
        "session": session,
        "rig": "r",
        "part": str(part),
        "anchor_utc_ns": str(anchor),
        "anchor_monotonic_raw_ns": "1",
    }
    with RecordingWriter(path, {"gyrorig": own}) as writer:
        for n in range(events):
            text = "note " * 1000 + str(n)
            event = SessionEvent(1_000_000_000 + n, int(EventKind.NOTE), "", text)
            writer.write(SESSION_EVENT_TOPIC, event)
    return path


def read(folder: Path) -> Iterator[Spooled]:
    return read_all(Folder(folder), look(folder).recordings)


def names(folder: Path) -> list[list[str]]:
    found = sessions(read(folder))
    return [[one.path.name for one in session.recordings] for session in found]


def test_parts_of_a_session_are_one_piece_of_work(tmp_path: Path) -> None:
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
    found = sessions(read(tmp_path))
    assert [s.refused for s in found] == ["a.mcap is a shorter copy of b.mcap", ""]


def test_unfinished_recordings_are_left_alone_and_counted(tmp_path: Path) -> None:
    (tmp_path / "a.mcap.part").write_bytes(b"x")
    (tmp_path / "notes.txt").write_bytes(b"x")
    (tmp_path / "unclean").mkdir()  # the daemon's originals of what it recovered
    (tmp_path / "unclean" / "b.mcap.part").write_bytes(b"x")
    found = look(tmp_path)
    assert (found.recordings, found.unfinished, found.left) == ((), 1, 0)
    os.utime(tmp_path / "a.mcap.part", (1, 1))
    assert look(tmp_path).left == 1


def test_whole_parts_wait_for_the_one_that_is_being_written(tmp_path: Path) -> None:
    for name in ("a.mcap", "a_p001.mcap", "ab.mcap", "b_p001.mcap", "deep/a.mcap"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "a_p002.mcap.part").write_bytes(b"x")
    found = look(tmp_path)
    assert [entry.name for entry in found.recordings] == ["ab.mcap", "b_p001.mcap", "deep/a.mcap"]
    assert (found.waiting, found.unfinished, found.left) == (2, 1, 0)
    os.utime(tmp_path / "a_p002.mcap.part", (1, 1))  # its writer is gone
    found = look(tmp_path)
    assert len(found.recordings) == 5
    assert (found.waiting, found.unfinished, found.left) == (0, 1, 1)


def test_loops_of_links_end(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path)
    write(tmp_path / "a.mcap")
    assert len(look(tmp_path).recordings) == 1


def test_there_must_be_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no folder"):
        look(tmp_path / "none")


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 99]
)
def test_what_is_no_recording_is_a_session_of_its_own(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    (session,) = sessions(read(tmp_path))
    assert session.recordings[0].session == ""


def test_what_was_read_once_is_remembered_until_it_changes(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    memory = tmp_path / "heads.sqlite"
    found = look(tmp_path)
    (known,) = read(tmp_path)
    with Heads(memory, "here") as heads:
        assert heads.split(found) == ([], list(found.recordings))
        assert list(heads.keep([known])) == [known]
    with Heads(memory, "here") as heads:
        assert heads.split(found) == ([known], [])
        os.utime(path, ns=(1, 1))
        changed = look(tmp_path)
        assert heads.split(changed) == ([], list(changed.recordings))
    with Heads(memory, "elsewhere") as heads:
        assert heads.split(found) == ([], list(found.recordings))


def test_a_lost_or_foreign_memory_is_no_fault(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap")
    memory = tmp_path / "heads.sqlite"
    memory.write_bytes(b"no database at all, but long enough to be looked at" * 10)
    found = look(tmp_path)
    (known,) = read(tmp_path)
    with Heads(memory, "here") as heads:
        assert heads.split(found) == ([], list(found.recordings))
        assert list(heads.keep([known])) == [known]
