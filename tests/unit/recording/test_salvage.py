"""Cut anywhere, damaged anywhere: what is sound is salvaged, and mcap's own reader agrees."""

import random
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.disk_file import Disk, DiskFile
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.salvage import RECOVERED, is_finished, read_strictly, salvage


class _Unsynced(Disk):
    """A disk that does not wait: a thousand files are made here, and none is kept."""

    def create(self, path: Path) -> DiskFile:
        file = super().create(path)
        file.sync = lambda: None  # type: ignore[method-assign]
        return file


QUICK = _Unsynced()
ABOUT = {"original": "a.mcap.part", "original_sha256": "00"}


def contents(recording: Recording) -> dict[str, list[Any]]:
    found = {topic: recording.messages(topic) for topic in recording.topics}
    return {topic: messages for topic, messages in found.items() if messages}


def salvaged(source: Path, target: Path) -> Recording | None:
    """The recovered recording, seen by both readers; None where nothing could be."""
    target.unlink(missing_ok=True)
    try:
        told = salvage(source, target, ABOUT, QUICK)
    except InputError:
        assert not target.exists()
        return None
    assert read_strictly(target) == dict(told.messages)
    assert is_finished(target)
    recording = read_recording(target)
    assert recording.complete, recording.losses
    assert recording.metadata[RECOVERED]["lost_bytes"] == str(told.lost_bytes)
    return recording


def check(source: Path, target: Path) -> int:
    """Salvage one file, compare with our reader's view of it; how many messages."""
    try:
        before = read_recording(source)
    except InputError:
        assert salvaged(source, target) is None
        return 0
    recording = salvaged(source, target)
    if recording is None:
        assert contents(before) == {}
        return 0
    assert contents(recording) == contents(before)
    assert {k: v for k, v in recording.metadata.items() if k != RECOVERED} == before.metadata
    assert [a.data for a in recording.attachments] == [a.data for a in before.attachments]
    return sum(map(len, contents(recording).values()))


def cut(folder: Path, script: Any, step: int) -> int:
    """Salvage a small recording cut at every `step`th byte; how many files that were."""
    whole = script.write(folder / "a.mcap").read_bytes()
    source, target, last = folder / "b.mcap.part", folder / "b.mcap", 0
    lengths = range(0, len(whole), step)
    for length in lengths:
        source.write_bytes(whole[:length])
        found = check(source, target)
        assert found >= last  # a longer file never tells less
        last = found
    assert last > 0
    return len(lengths)


def test_cut_at_many_bytes(tmp_path: Path, scripted: Any) -> None:
    cut(tmp_path, scripted(4, flush_every=5), 23)  # no length in it divides by that


@pytest.mark.bench
@pytest.mark.timeout(1800)
def test_cut_at_every_byte(tmp_path: Path, scripted: Any) -> None:
    cuts = cut(tmp_path, scripted(4, flush_every=5), 1)
    sys.stdout.write(f"salvaged and read strictly: {cuts} cuts\n")


def test_damage_anywhere(tmp_path: Path, scripted: Any) -> None:
    whole = scripted(6, flush_every=4).write(tmp_path / "a.mcap").read_bytes()
    source, target = tmp_path / "b.mcap.part", tmp_path / "b.mcap"
    chance = random.Random(3)
    for _ in range(120):
        damaged = bytearray(whole[: chance.randrange(len(whole) // 2, len(whole))])
        for _ in range(chance.randrange(1, 4)):
            at = chance.randrange(len(damaged))
            damaged[at : at + chance.randrange(1, 300)] = chance.randbytes(chance.randrange(1, 9))
        source.write_bytes(damaged)
        check(source, target)


def test_a_finished_file_stays_what_it_is(tmp_path: Path, scripted: Any) -> None:
    path = scripted(6, flush_every=4).write(tmp_path / "a.mcap")
    assert is_finished(path)
    assert check(path, tmp_path / "b.mcap") == len(scripted(6).entries)


def test_the_summary_alone_finishes_nothing(tmp_path: Path, scripted: Any) -> None:
    """A power cut may leave the end on the disk, and any page before it not."""
    path = scripted(6, flush_every=10).write(tmp_path / "a.mcap")
    whole = path.read_bytes()
    finished = 0
    for at in range(0, len(whole), 64):
        path.write_bytes(whole[:at] + bytes(64) + whole[at + 64 :])
        if is_finished(path):
            assert read_recording(path).complete, at
            finished += 1
    assert finished <= 3  # pages of what the summary itself repeats


def test_nothing_to_salvage(tmp_path: Path, scripted: Any) -> None:
    path = scripted(2).write(tmp_path / "a.mcap")
    target = tmp_path / "b.mcap"
    for content in (b"", b"\x89MCAP0\r\n", b"no recording", path.read_bytes()[:400]):
        source = tmp_path / "c.mcap.part"
        source.write_bytes(content)
        with pytest.raises(InputError):
            salvage(source, target, ABOUT)
        assert not target.exists()
    shutil.copy(path, target)
    with pytest.raises(Exception, match="exists"):
        salvage(path, target, ABOUT)
    assert target.read_bytes() == path.read_bytes()
