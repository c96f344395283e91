"""A hostile file costs its own work only: it is read or refused, within bounds by its size."""

import contextlib
import struct
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath

import pytest
from mcap.writer import Writer
from tests.support.hostile_files import (
    IMPORT_FAMILIES,
    IMPORT_MAP,
    MAGIC,
    RECORDING_FAMILIES,
    far_stamp,
    many_events,
    nested_landmarks,
    sparse_samples,
)
from tests.unit.fleet.test_batch import make_job

from gyrorig_daemon import cli as daemon_cli
from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording import topic_collector
from gyrorig_protocol.recording.mcap import record_scan
from gyrorig_protocol.recording.mcap.mcap_summary import read_summary
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver import cli
from gyrorig_solver.commands import board_selection
from gyrorig_solver.data.samples import load_samples
from gyrorig_solver.estimate.series import build_series
from gyrorig_solver.fleet.jobs import run_batch, session_job, spool_scanner
from gyrorig_solver.fleet.jobs.session_job import Job, SolveSettings, run_job
from gyrorig_solver.fleet.jobs.spool_scanner import SpooledRecording
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.store import IndexRow
from gyrorig_solver.storage import (
    Folder,
    fit_memory_bound_bytes,
    input_limits,
    limit_fit_memory,
    limit_input,
    limit_memory_by_size,
)

SIZE = 30_000
CONFIG = Path(__file__).resolve().parents[3] / "config"
MARGIN = 1.5  # of the limit to the memory that an honest recording needs
DONE_OR_REFUSED = (0, 3, 4)


@pytest.mark.parametrize("family", RECORDING_FAMILIES)
@pytest.mark.parametrize("command", ["check", "solve"])
def test_hostile_recordings_are_read_or_refused(
    family: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = RECORDING_FAMILIES[family](tmp_path / "x.mcap", SIZE)
    more = [] if command == "check" else ["--extend", "none", "--out", str(tmp_path / "out")]
    assert cli.run([command, str(file), *more]) in DONE_OR_REFUSED
    assert "Warning" not in capsys.readouterr().err


@pytest.mark.parametrize("family", IMPORT_FAMILIES)
def test_hostile_tables_are_read_or_refused(family: str, tmp_path: Path) -> None:
    make, suffix = IMPORT_FAMILIES[family]
    file = make(tmp_path / f"x{suffix}", SIZE)
    (tmp_path / "map.yaml").write_text(IMPORT_MAP)
    words = [] if suffix == ".json" else ["--map", str(tmp_path / "map.yaml")]
    kind = [] if suffix == ".json" else [suffix[1:]]
    out = ["-o", str(tmp_path / "out.mcap")]
    assert cli.run(["import", *kind, str(file), *words, *out]) in DONE_OR_REFUSED


def test_a_far_stamp_takes_no_memory(tmp_path: Path) -> None:
    recording = read_recording(far_stamp(tmp_path / "x.mcap", SIZE))
    with limit_memory_by_size("x.mcap", SIZE):
        samples = load_samples(recording, BoardId("B-1"))
    assert samples.number.size > 100


def test_sparse_samples_make_no_long_grid(tmp_path: Path) -> None:
    recording = read_recording(sparse_samples(tmp_path / "x.mcap", 20 * SIZE))
    try:
        samples = load_samples(recording, BoardId("B-1"))
        series, _ = build_series(samples)
    except InputError:
        return
    assert sum(part.time_s.size for part in series) <= max(1_000_000, 4 * samples.number.size)


def test_a_search_for_landmarks_reads_a_file_twice_at_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = memoryview(nested_landmarks(tmp_path / "x.mcap", 4_000_000).read_bytes())
    monkeypatch.setattr(record_scan, "_MIN_SEARCHED_BYTES", 1 << 20)
    started_s = time.process_time()
    scan = record_scan.scan_records(data, read_summary(data))
    assert scan.searched_bytes <= len(data)
    assert time.process_time() - started_s < 3.0  # 30 s without the limit


def test_chunks_together_unpack_to_20_times_the_file_at_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = RECORDING_FAMILIES["chunk_bomb"](tmp_path / "x.mcap", 200_000)
    monkeypatch.setattr(topic_collector, "MIN_UNPACKED_LIMIT_BYTES", 1 << 20)
    with pytest.raises(InputError, match="more than 20 times its size"):
        read_recording(file)


def test_events_are_limited_by_the_size_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = many_events(tmp_path / "x.mcap", 100_000)
    count = len(list(read_recording(file).events()))
    monkeypatch.setattr(topic_collector, "MIN_TEXT_MESSAGE_LIMIT", 100)
    recording = read_recording(file)
    limit = 100 + file.stat().st_size // 30
    assert len(list(recording.events())) == limit < count
    assert [loss.messages for loss in recording.losses] == [count - limit]
    assert "commands and events" in recording.losses[0].text


def test_schemas_of_other_types_are_not_interpreted(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    nested = "B[160] x\n" + "=" * 80 + "\nMSG: a/B\nC[100] y\n"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="x")
        writer.add_metadata("gyrorig", {"format": "1", "session": "s", "started": "x"})
        for number in range(20_000):
            text = f"{nested}# {number}\n".encode()
            schema = writer.register_schema(f"a/T{number}", "ros2msg", text)
            channel = writer.register_channel(f"/t{number}", "cdr", schema, {})
            writer.add_message(channel, 1, b"\0\1\0\0" + bytes(8), 1)
        writer.finish()  # type: ignore[no-untyped-call]
    started_s = time.process_time()
    recording = read_recording(path)
    assert time.process_time() - started_s < 5.0
    assert len(recording.notes) == topic_collector.MAX_UNREAD_NOTES + 1
    assert not recording.topics


def _use_memory() -> None:
    blocks = [bytearray(50_000_000) for _ in range(40)]
    for block in blocks:
        block[::4096] = b"x" * len(block[::4096])


def _use_time() -> None:
    while True:
        pass


def _use_time_twice(end_s: float) -> None:
    with contextlib.suppress(InputError):
        _use_time()
    while time.process_time() < end_s:
        pass


def test_a_file_that_needs_too_much_memory_is_refused() -> None:
    refusal = pytest.raises(InputError, match="needs more than 402 MB of memory")
    with refusal, limit_input("x", 10**5):
        _use_memory()
    bytearray(500_000_000)  # the limit ends with the block


def test_a_fit_that_needs_too_much_memory_is_refused() -> None:
    refusal = pytest.raises(InputError, match="needs more than 432 MB of memory")
    with refusal, limit_fit_memory("x", 10**5, 1000):
        _use_memory()


def test_a_fit_may_use_more_memory_than_the_reading_of_its_file() -> None:
    with limit_fit_memory("x", 10**6, 20_000), limit_input("x", 1):
        pass
    with limit_fit_memory("x", 10**6, 20_000):
        assert bytearray(700_000_000)


@pytest.mark.long
@pytest.mark.parametrize("program", ["quick", "survey-130"])
def test_an_honest_recording_is_solved_far_within_the_limit(
    program: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["--config", str(CONFIG / "rig.yaml"), "--out", str(tmp_path), "--simulated-time"]
    program_path = str(CONFIG / "programs" / f"{program}.yaml")
    assert daemon_cli.run(["record", *words, "--program", program_path]) == 0
    (file,) = tmp_path.glob("*.mcap")
    count = read_recording(file).message_count
    allowed_bytes = fit_memory_bound_bytes(file.stat().st_size, count)
    monkeypatch.setenv("GYRORIG_MEMORY_MB", str(int(allowed_bytes / MARGIN / 1e6)))
    assert cli.run(["solve", str(file), "--out", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize("words", [["explain"], ["twin"], ["twin-check"]])
def test_other_commands_read_within_the_same_limits(
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def exhaust(_path: Path) -> None:
        raise MemoryError

    monkeypatch.setattr(board_selection, "read_recording", exhaust)
    path = tmp_path / "a.mcap"
    path.write_bytes(b"x")
    folder = [str(tmp_path)] if words == ["twin-check"] else []
    assert cli.run([*words, str(path), *folder]) == 3
    assert "a.mcap needs more than 400 MB of memory" in capsys.readouterr().err


def test_a_person_can_allow_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GYRORIG_MEMORY_MB", "900")
    with limit_input("x", 1):
        assert bytearray(600_000_000)


def test_a_file_that_needs_too_much_time_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(input_limits, "BASE_TIME_S", 0.2)
    refusal = pytest.raises(InputError, match="of processor time")
    with refusal, limit_input("x.csv", 1):
        _use_time()


@pytest.mark.parametrize("more_s", [0.0, 60.0])
def test_code_that_catches_the_limit_does_not_end_it(
    monkeypatch: pytest.MonkeyPatch, more_s: float
) -> None:
    """Before, code that tried something else after an error continued without a limit."""
    monkeypatch.setattr(input_limits, "BASE_TIME_S", 0.2)
    begin_s = time.process_time()
    refusal = pytest.raises(InputError, match="of processor time")
    with refusal, limit_input("x.csv", 1):
        _use_time_twice(begin_s + more_s)
    assert time.process_time() - begin_s < 30.0


def test_a_job_that_exceeds_the_memory_of_its_file_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(
        _job: Job, _recordings: Sequence[Recording], _unfinished: list[str]
    ) -> Iterator[IndexRow]:
        raise MemoryError

    monkeypatch.setattr(session_job, "_read_recordings", lambda _job: [])
    monkeypatch.setattr(session_job, "_solve_recordings", greedy)
    job = make_job("k", tmp_path)
    settings = SolveSettings(solver_version="0.1.0")
    names = (PurePosixPath("x.mcap"),)
    job = Job(job.key, job.batch, job.store, job.spool, names, ("00",), settings, input_bytes=1000)
    (row,) = run_job(job).rows
    assert row.status == "rejected"
    assert "more than 400 MB of memory" in row.reason


def test_a_file_without_a_head_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool = tmp_path / "spool"
    spool.mkdir()
    (spool / "x.mcap").write_bytes(MAGIC + struct.pack("<BQ", 1, 10**9) + bytes(5000))
    settings = SolveSettings(solver_version="0.1.0", extend=())
    read: list[str] = []
    original = spool_scanner.read_spooled

    def counted(storage: Folder, entry: object) -> SpooledRecording:
        read.append("x")
        return original(storage, entry)  # type: ignore[arg-type]

    monkeypatch.setattr(spool_scanner, "read_spooled", counted)
    ends = []
    for _ in range(2):
        pools = [WorkerPool(lambda: ThreadPoolExecutor(1))]
        summary = run_batch(spool, tmp_path / "store", settings, pools)
        ends.append((dict(summary.sessions_by_status), summary.done_before))
    assert ends == [({"rejected": 1}, 0), ({}, 1)]
    assert read == ["x"]
