"""After a power cut at any moment: what was synced is there, and nothing is damaged.

Row 14 of the fault table in docs/faults.md.
"""

import shutil
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from tests.support.power_cut_disk import PowerCut, PowerCutDisk, State, power_cuts

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile
from gyrorig_protocol.recording.messages import ImuRaw
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.salvage import read_strictly

METADATA = {"gyrorig": {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}}
TOPIC = "/board/B-1/imu_raw"
SECOND = 1_000_000_000
PER_SECOND = 20
SYNC_S = 1.0

Sequences = Callable[[Path], list[int]]


class UnsyncedDisk(Disk):
    """A disk that does not wait: thousands of files are made here, and none is kept."""

    def create(self, path: Path) -> DiskFile:
        file = super().create(path)
        file.sync = lambda: None  # type: ignore[method-assign]
        return file

    def sync_directory(self, folder: Path) -> None:
        pass


def record(folder: Path, seconds: int, sync_s: float = SYNC_S) -> tuple[PowerCutDisk, list[int]]:
    """Record in parts of 3 s; the log, and how many samples were given at each operation."""
    disk = PowerCutDisk(folder)
    settings = RecorderSettings(part_s=3.0, sync_s=sync_s, survives_faults=True)
    recorder = Recorder(False, settings, disk=disk)
    recorder.open(RecordingPlan(folder / "a.mcap", METADATA, ()))
    given: list[int] = []
    for k in range(seconds * PER_SECOND):
        at_ns = k * SECOND // PER_SECOND
        given += [k] * (len(disk.log) - len(given))
        recorder.put(TOPIC, ImuRaw(at_ns, k, k, 0, 0, (k * k, -k, 7 * k)), at_ns)
        if k % 5 == 4:
            recorder.tick(at_ns)
    given += [seconds * PER_SECOND] * (len(disk.log) - len(given))
    recorder.close()
    given += [seconds * PER_SECOND] * (len(disk.log) + 1 - len(given))
    return disk, given


@cache
def samples_in(content: bytes, folder: str) -> frozenset[int]:
    """The samples in the whole chunks of a file's content."""
    path = Path(folder) / "synced.mcap.part"
    path.write_bytes(content)
    try:
        recording = read_recording(path)
    except InputError:
        return frozenset()
    if TOPIC not in recording.topics:
        return frozenset()
    return frozenset(int(k) for k in recording.array(TOPIC)["message_sequence"])


def materialise(state: State, folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in state.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)


def check(cut: PowerCut, folder: Path, sequences_in: Sequences) -> set[int]:
    """Recover from one power cut; the samples that are in finished files."""
    materialise(cut.state, folder)
    for path in folder.glob("*.mcap"):
        read_strictly(path)  # nothing unfinished ever has a final name
    reports = recover_folder(folder, disk=UnsyncedDisk())
    assert all(report.outcome is not RecoveryOutcome.FAILED for report in reports), reports
    assert not list(folder.glob("*.part"))
    for path in folder.glob("*.mcap"):
        read_strictly(path)
    numbers = sequences_in(folder)
    assert numbers == sorted(set(numbers))  # in order, across the parts, none twice
    scratch = str(folder.parent)
    certain = set().union(*(samples_in(content, scratch) for content in cut.synced.values()))
    assert certain <= set(numbers)
    assert recover_folder(folder, disk=UnsyncedDisk()) == []
    return set(numbers)


def run(
    folder: Path, seconds: int, sequences_in: Sequences, sync_s: float = SYNC_S, page: int = 512
) -> tuple[int, float]:
    """Try every state that a power cut could leave; how many, and the largest loss in seconds."""
    (folder / "live").mkdir()
    disk, given = record(folder / "live", seconds, sync_s)
    tried, worst_s = 0, 0.0
    for cut in power_cuts(disk.log, page_bytes=page):
        numbers = check(cut, folder / "cut", sequences_in)
        known = given[cut.operations]
        lost = known - len(numbers & set(range(known)))
        worst_s = max(worst_s, lost / PER_SECOND)
        tried += 1
    return tried, worst_s


def test_every_state_of_a_power_cut(tmp_path: Path, sequences_in: Sequences) -> None:
    tried, worst_s = run(tmp_path, 4, sequences_in)
    assert tried > 150
    assert worst_s <= SYNC_S + 1.0  # what is not yet in a chunk, and what is not yet synced


@pytest.mark.bench
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("sync_s", "page"), [(1.0, 64), (4.0, 128)])
def test_more_states_of_a_power_cut(
    tmp_path: Path, sequences_in: Sequences, sync_s: float, page: int
) -> None:
    tried, worst_s = run(tmp_path, 12, sequences_in, sync_s, page)
    assert worst_s <= sync_s + 1.0
    sys.stdout.write(
        f"{tried} states after a power cut, synced every {sync_s:.0f} s: "
        f"largest loss {worst_s:.2f} s\n"
    )


def unclean(folder: Path, seconds: int = 2) -> State:
    """A folder after a crash: a file that was not finished."""
    folder.mkdir()
    disk, _ = record(folder, seconds)
    cut = [cut for cut in power_cuts(disk.log) if "a.mcap.part" in cut.state][-1]
    return cut.state


def test_a_power_cut_while_recovering(tmp_path: Path, sequences_in: Sequences) -> None:
    """Recovery may be cut off as well, and begins again at the next start."""
    before = unclean(tmp_path / "live")
    work = tmp_path / "work"
    materialise(before, work)
    disk = PowerCutDisk(work)
    assert [r.outcome for r in recover_folder(work, disk=disk)] == [RecoveryOutcome.RECOVERED]
    wanted = sequences_in(work)
    assert wanted
    states = list(power_cuts(disk.log, before))
    assert len(states) > 5
    for cut in states:
        folder = tmp_path / "cut"
        materialise(cut.state, folder)
        recover_folder(folder, disk=UnsyncedDisk())
        assert sequences_in(folder) == wanted
        # The original is kept, wherever it is now.
        originals = [path.read_bytes() for path in folder.rglob("*.part")]
        assert originals == [before["a.mcap.part"]]
        assert not list(folder.glob("*.recovering"))


def test_both_files_are_linked_by_digest(tmp_path: Path) -> None:
    before = unclean(tmp_path / "live")
    work = tmp_path / "work"
    materialise(before, work)
    (report,) = recover_folder(work)
    assert report.recording == work / "a.mcap"
    recording = read_recording(report.recording)
    original = read_recording(report.original).sha256
    assert recording.metadata["gyrorig.recovered"]["original_sha256"] == original
    note = report.original.with_name("a.mcap.part.json").read_text()
    assert original in note
    assert recording.sha256 in note
