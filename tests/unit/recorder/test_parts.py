"""A recording in parts: each is self-contained, and no message is missing."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan
from gyrorig_daemon.recorder.part_files import part_path
from gyrorig_protocol.recording.messages import EventKind, ImuRaw, SessionEvent
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording_metadata import recording_order
from gyrorig_protocol.recording.writer import Attachment

BOARD = {"uid": "u", "sensor": "L3G4200D", "link": "serial", "gyro_scale_rad_s": "0.000153"}
METADATA = {
    "gyrorig": {
        "session": "s",
        "rig": "r",
        "anchor_utc_ns": "0",
        "anchor_monotonic_raw_ns": "0",
    },
    "gyrorig.board.B-1": BOARD,
}
TOPIC = "/board/B-1/imu_raw"
EVENTS = "/session/event"
SECOND = 1_000_000_000


def put(recorder: Recorder, k: int) -> None:
    at_ns = k * SECOND // 10
    recorder.put(TOPIC, ImuRaw(at_ns, k, k, 0, 0, (k, k, k)), at_ns)
    recorder.tick(at_ns)


def say(recorder: Recorder, k: int, kind: EventKind, phase: str, text: str = "") -> None:
    at_ns = k * SECOND // 10
    recorder.put(EVENTS, SessionEvent(at_ns, int(kind), phase, text), at_ns)


def opened(folder: Path, settings: RecorderSettings) -> Recorder:
    recorder = Recorder(False, settings)
    files = (Attachment("rig.yaml", "application/yaml", b"a: 1"),)
    recorder.open(RecordingPlan(folder / "a.mcap", METADATA, files))
    return recorder


def test_parts_follow_each_other_without_a_gap(tmp_path: Path, contract_judge: Path) -> None:
    recorder = opened(tmp_path, RecorderSettings(part_s=10.0))
    say(recorder, 0, EventKind.PHASE_BEGIN, "program", "p")
    say(recorder, 0, EventKind.PHASE_BEGIN, "static", "long")
    for k in range(450):
        put(recorder, k)
        if k == 250:
            say(recorder, k, EventKind.PHASE_END, "static")
            say(recorder, k, EventKind.PHASE_BEGIN, "turn", '{"axis": [0, 0, 1]}')
    last = recorder.close()
    parts = sorted(tmp_path.iterdir())
    assert [path.name for path in parts] == [
        "a.mcap",
        *(f"a_p{number:03d}.mcap" for number in range(1, 5)),
    ]
    assert last == parts[-1]
    assert recorder.paths == tuple(parts)
    assert recorder.counts.rotations == 4
    assert recorder.counts.parts_opened == recorder.counts.parts_closed == 5
    numbers_by_part, numbers = [], []
    for number, path in enumerate(parts):
        recording = read_recording(path)
        metadata = recording.metadata["gyrorig"]
        assert metadata["part"] == str(number)
        assert metadata["previous"] == ("" if number == 0 else parts[number - 1].name)
        assert recording.attachments[0].data == b"a: 1"
        numbers_by_part += recording.array(TOPIC)["sequence"].tolist()
        numbers += recording.array(TOPIC)["message_sequence"].tolist()
    assert numbers_by_part == numbers == list(range(450))
    command = [sys.executable, str(contract_judge), *map(str, parts)]
    judged = subprocess.run(command, capture_output=True, check=False)
    assert judged.returncode == 0, judged.stdout


def test_a_part_repeats_the_open_phases(tmp_path: Path) -> None:
    recorder = opened(tmp_path, RecorderSettings(part_s=10.0))
    say(recorder, 0, EventKind.PHASE_BEGIN, "program", "p")
    say(recorder, 0, EventKind.PHASE_BEGIN, "static", "long")
    for k in range(350):
        put(recorder, k)
        if k == 150:
            say(recorder, k, EventKind.PHASE_END, "static")
            say(recorder, k, EventKind.PHASE_BEGIN, "turn", "{}")
    recorder.close()
    first_events = []
    numbers = []
    for path in recorder.paths:
        recording = read_recording(path)
        stamped = recording.topics[EVENTS].timed_messages
        events = [stamped_event.message for stamped_event in stamped]
        first_events.append([(e.kind, e.phase) for e in events if isinstance(e, SessionEvent)])
        numbers.append([m.message_sequence for m in stamped])
    begin, end = int(EventKind.PHASE_BEGIN), int(EventKind.PHASE_END)
    assert first_events == [
        [(begin, "program"), (begin, "static")],
        [(begin, "program"), (begin, "static"), (end, "static"), (begin, "turn")],
        [(begin, "program")],  # half a turn by a known angle is none
        [(begin, "program")],
    ]
    assert numbers == [[0, 1], [0, 1, 2, 3], [3], [3]]  # no gap in any of them


def test_parts_by_size(tmp_path: Path) -> None:
    recorder = opened(tmp_path, RecorderSettings(part_bytes=6_000))
    for k in range(3_000):
        put(recorder, k)
    recorder.close()
    sizes = [path.stat().st_size for path in recorder.paths]
    assert len(sizes) > 5
    assert max(sizes) < 12_000  # a chunk and the summary more


def test_late_metadata_is_in_this_part_and_all_later_ones(tmp_path: Path) -> None:
    recorder = opened(tmp_path, RecorderSettings(part_s=10.0))
    late = {"gyrorig.board.B-2": {**BOARD, "uid": "late"}}
    for k in range(250):
        put(recorder, k)
        if k == 50:
            recorder.add_metadata(
                late, (Attachment("hello.B-2.0.json", "application/json", b"{}"),)
            )
    recorder.close()
    for path in recorder.paths:
        recording = read_recording(path)
        assert recording.is_complete, recording.losses
        assert recording.metadata["gyrorig.board.B-2"]["uid"] == "late"
        assert recording.metadata["gyrorig.board.B-1"]["uid"] == "u"
        names = [attachment.name for attachment in recording.attachments]
        assert names == ["rig.yaml", "hello.B-2.0.json"]


def test_a_taken_file_name_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "a_p001.mcap").write_bytes(b"precious")
    recorder = opened(tmp_path, RecorderSettings(part_s=10.0))
    for k in range(150):
        put(recorder, k)
    recorder.close()
    assert [path.name for path in recorder.paths] == ["a.mcap", "a_p002.mcap"]
    assert (tmp_path / "a_p001.mcap").read_bytes() == b"precious"
    assert read_recording(recorder.paths[1]).metadata["gyrorig"]["previous"] == "a.mcap"


def test_no_part_is_empty(tmp_path: Path) -> None:
    """A session that ends just behind a cut leaves no file without a message."""
    recorder = opened(tmp_path, RecorderSettings(part_s=10.0))
    for k in range(100):
        put(recorder, k)
    for late in range(100, 140):  # time goes on, and nothing comes
        recorder.tick(late * SECOND // 10)
    assert recorder.counts.parts_opened == 2
    last = recorder.close()
    assert last == tmp_path / "a.mcap"
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert recorder.paths == (last,)


def test_no_part_follows_one_that_does_not_exist(tmp_path: Path) -> None:
    """A part without messages is deleted, and the next one must not name it."""
    recorder = opened(tmp_path, RecorderSettings(part_s=10.0))
    for k in range(100):
        put(recorder, k)
    for late in range(100, 350):  # time goes on for longer than a part, and nothing comes
        recorder.tick(late * SECOND // 10)
    for k in range(350, 500):
        put(recorder, k)
    recorder.close()
    assert list(recorder.paths) == sorted(tmp_path.iterdir())
    names = ["", *(path.name for path in recorder.paths[:-1])]
    parts = [read_recording(path).metadata["gyrorig"] for path in recorder.paths]
    assert [part["previous"] for part in parts] == names
    assert len(parts) == 3


def test_a_part_that_was_opened_after_a_discarded_one_is_not_used(
    tmp_path: Path, failing_disk: Any
) -> None:
    """The open part fails before its first message is saved, while the next one is opened."""
    settings = RecorderSettings(part_s=10.0, survives_faults=True)
    disk = failing_disk()
    recorder = Recorder(False, settings, disk=disk)
    recorder.open(RecordingPlan(tmp_path / "a.mcap", METADATA, ()))
    for k in range(120):
        put(recorder, k)
    parts = recorder._part_writer
    assert parts is not None
    assert parts._writer is not None
    assert [path.name for path in parts.paths] == ["a.mcap", "a_p001.mcap"]
    parts._next_part.open(2, "a_p001.mcap", 0)
    parts._discard_empty_part(parts._writer)
    parts._enter_degraded_state("the test says so")
    for k in range(120, 300):
        put(recorder, k)
    recorder.close()
    names = ["", *(path.name for path in recorder.paths[:-1])]
    metadata = [read_recording(path).metadata["gyrorig"] for path in recorder.paths]
    assert [part.get("previous", "") for part in metadata] == names


def test_parts_are_sorted_by_number() -> None:
    first = Path("folder/a.mcap")
    parts = [part_path(first, number) for number in (0, 1, 101, 999, 1000, 1001, 10_000)]
    paths = [*parts, Path("folder/b.mcap")]
    assert sorted(paths, key=recording_order) == paths
    unfinished = [path.with_name(f"{path.name}.part") for path in paths]
    assert sorted(unfinished, key=recording_order) == unfinished
