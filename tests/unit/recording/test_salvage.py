"""Cut anywhere, damaged anywhere: what is sound is salvaged, and mcap's own reader agrees."""

import random
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_protocol.recording.salvage import RECOVERED_RECORD, is_finished, read_strictly, salvage


class _UnsyncedDisk(Disk):
    """A disk that does not wait: a thousand files are made here, and none is kept."""

    def create(self, path: Path) -> DiskFile:
        file = super().create(path)
        file.sync = lambda: None  # type: ignore[method-assign]
        return file


QUICK = _UnsyncedDisk()
ABOUT = {"original": "a.mcap.part", "original_sha256": "00"}


def contents(recording: Recording) -> dict[str, list[Any]]:
    actual = {topic: recording.messages(topic) for topic in recording.topics}
    return {topic: messages for topic, messages in actual.items() if messages}


def salvaged(source: Path, target: Path) -> Recording | None:
    """The recovered recording, seen by both readers; None where nothing could be."""
    target.unlink(missing_ok=True)
    try:
        reports = salvage(source, target, ABOUT, QUICK)
    except InputError:
        assert not target.exists()
        return None
    assert read_strictly(target) == dict(reports.messages)
    assert is_finished(target)
    recording = read_recording(target)
    assert recording.is_complete, recording.losses
    assert recording.metadata[RECOVERED_RECORD]["lost_bytes"] == str(reports.lost_bytes)
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
    assert {k: v for k, v in recording.metadata.items() if k != RECOVERED_RECORD} == before.metadata
    assert [a.data for a in recording.attachments] == [a.data for a in before.attachments]
    return sum(map(len, contents(recording).values()))


def cut(folder: Path, script: Any, step: int) -> int:
    """Salvage a small recording cut at every `step`th byte; how many files that were."""
    complete = script.write(folder / "a.mcap").read_bytes()
    source, target, last = folder / "b.mcap.part", folder / "b.mcap", 0
    lengths = range(0, len(complete), step)
    for length in lengths:
        source.write_bytes(complete[:length])
        actual = check(source, target)
        assert actual >= last  # a longer file never gives less
        last = actual
    assert last > 0
    return len(lengths)


def test_cut_at_many_bytes(tmp_path: Path, scripted: Any) -> None:
    cut(tmp_path, scripted(4, flush_every=5), 23)  # no length in it divides by that


@pytest.mark.bench
@pytest.mark.timeout(1800)
def test_cut_at_every_byte(tmp_path: Path, scripted: Any) -> None:
    cuts = cut(tmp_path, scripted(4, flush_every=5), 1)
    sys.stdout.write(f"salvaged and read strictly: {cuts} cuts\n")


def test_salvage_after_damage_anywhere(tmp_path: Path, scripted: Any) -> None:
    complete = scripted(6, flush_every=4).write(tmp_path / "a.mcap").read_bytes()
    source, target = tmp_path / "b.mcap.part", tmp_path / "b.mcap"
    chance = random.Random(3)
    for _ in range(120):
        damaged = bytearray(complete[: chance.randrange(len(complete) // 2, len(complete))])
        for _ in range(chance.randrange(1, 4)):
            index = chance.randrange(len(damaged))
            damaged[index : index + chance.randrange(1, 300)] = chance.randbytes(
                chance.randrange(1, 9)
            )
        source.write_bytes(damaged)
        check(source, target)


def test_a_finished_file_is_recognised(tmp_path: Path, scripted: Any) -> None:
    path = scripted(6, flush_every=4).write(tmp_path / "a.mcap")
    assert is_finished(path)
    assert check(path, tmp_path / "b.mcap") == len(scripted(6).entries)


def test_a_summary_alone_is_not_a_finished_file(tmp_path: Path, scripted: Any) -> None:
    """A power cut may leave the end on the disk, and any page before it not."""
    path = scripted(6, flush_every=10).write(tmp_path / "a.mcap")
    complete = path.read_bytes()
    finished = 0
    for index in range(0, len(complete), 64):
        path.write_bytes(complete[:index] + bytes(64) + complete[index + 64 :])
        if is_finished(path):
            assert read_recording(path).is_complete, index
            finished += 1
    assert finished <= 3  # pages of what the summary itself repeats


def test_files_without_a_message_are_rejected(tmp_path: Path, scripted: Any) -> None:
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
