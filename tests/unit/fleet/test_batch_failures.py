"""What may lie in a spool or befall a store: the batch goes on, says so, loses nothing."""

import errno
import os
import shutil
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import zstandard
from tests.unit.recording.test_damage import chunk, file_of

from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration import STORE_FILE, create_store
from gyrorig_solver.cli import run
from gyrorig_solver.estimate import Convergence, motion_fit
from gyrorig_solver.estimate.trust_region import NotConvergedError
from gyrorig_solver.fleet.jobs import BatchSummary, SolveSettings, run_batch, session_job
from gyrorig_solver.fleet.jobs.workers import WorkerPool
from gyrorig_solver.fleet.store import StoreIndex, verify

BOARD = BoardId("GY80-1")


def night(folder: Path, workers: int = 2) -> BatchSummary:
    pools = [WorkerPool(lambda: ThreadPoolExecutor(1)) for _ in range(workers)]
    return run_batch(
        folder / "spool", folder / "store", SolveSettings(solver_version="0.1.0", extend=()), pools
    )


def reasons_by_name(folder: Path) -> dict[str, str]:
    rows = StoreIndex(folder / "store").query("SELECT names[1], status || ': ' || reason FROM rows")
    return {str(name): str(output) for name, output in rows}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "spool").mkdir()
    return tmp_path


@pytest.mark.long
def test_hostile_recordings_are_rejected_and_the_good_one_is_solved(
    folder: Path, recorded: list[Path]
) -> None:
    spool = folder / "spool"
    good = recorded[0].read_bytes()
    packer = zstandard.ZstdCompressor().compressobj()
    bomb = b"".join(packer.compress(bytes(1 << 20)) for _ in range(80)) + packer.flush()
    (spool / "bomb.mcap").write_bytes(file_of(chunk(bomb, b"zstd", 1000)))
    (spool / "foreign.mcap").write_bytes(b"PK\x03\x04" + bytes(range(256)) * 9)
    (spool / "outside.mcap").write_bytes(good.replace(b"GY80-1", b"../a/b"))
    (spool / "half.mcap").write_bytes(good[: len(good) // 40])
    with (spool / "huge.mcap").open("wb") as file:
        file.write(good[:8])
        file.truncate(64 << 20)
    shutil.copy(recorded[1], spool / "good.mcap")
    summary = night(folder)
    output = reasons_by_name(folder)
    assert summary.deferred == 0
    assert set(output) == {path.name for path in spool.iterdir()}
    assert output.pop("good.mcap").startswith("ok")
    assert all(item.startswith("rejected: ") for item in output.values()), output
    assert not list(folder.glob("**/b"))
    assert verify(folder / "store").faults == ()


def test_a_fit_that_does_not_converge_is_a_row_with_its_reason(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        convergence = Convergence(False, 40, 7.0, "time_offset", 2.0)
        raise NotConvergedError(convergence, "run `gyrorig explain`")

    monkeypatch.setattr(motion_fit, "reduced_chi2", refuse)
    shutil.copy(recorded[0], folder / "spool" / "good.mcap")
    summary = night(folder, workers=1)
    assert summary.deferred == 0
    (reason,) = reasons_by_name(folder).values()
    assert "the fit did not converge" in reason
    assert "time_offset still moves" in reason
    assert not list(folder.glob("store/**/v0001.yaml"))


def test_two_boards_with_one_name_in_parallel_do_not_share_a_chain(
    folder: Path, recorded: list[Path]
) -> None:
    """Both begin while the store has no such board: the second to end is refused."""
    for number, path in enumerate(recorded):
        uid = read_recording(path).metadata[f"gyrorig.board.{BOARD}"]["uid"].encode()
        other = uid[:-1] + (b"0" if uid[-1:] != b"0" else b"1")
        data = path.read_bytes()
        (folder / "spool" / f"{number}.mcap").write_bytes(
            data.replace(uid, other) if number else data
        )
    summary = night(folder)
    assert summary.sessions_by_status == Counter(ok=1, rejected=1)
    assert any("two boards have the same name" in item for item in reasons_by_name(folder).values())
    assert len(create_store(folder / "store").versions(BOARD)) == 1
    assert verify(folder / "store").faults == ()


def test_a_temporarily_full_disk_loses_no_job(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, path in enumerate(recorded):
        shutil.copy(path, folder / "spool" / f"{number}.mcap")
    create_store(folder / "store")
    link, full = os.link, True

    def refused(*arguments: object) -> None:
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        link(*arguments)  # type: ignore[arg-type] # as it was called

    monkeypatch.setattr(os, "link", refused)
    first = night(folder)
    assert (first.finished, first.deferred) == (0, 2)
    assert "No space left on device" in first.deferral_reason
    assert first.is_partial
    full = False
    second = night(folder)
    assert (second.sessions_by_status, second.deferred) == (Counter(ok=2), 0)
    assert len(create_store(folder / "store").versions(BOARD)) == 2
    assert verify(folder / "store").faults == ()


def test_a_brief_refusal_is_retried_in_the_same_batch(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(recorded[0], folder / "spool")
    create_store(folder / "store")
    link, left = os.link, 1

    def refused(*arguments: object) -> None:
        nonlocal left
        if left:
            left -= 1
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        link(*arguments)  # type: ignore[arg-type] # as it was called

    monkeypatch.setattr(os, "link", refused)
    summary = night(folder)
    assert (summary.sessions_by_status, summary.deferred, summary.is_partial) == (
        Counter(ok=1),
        0,
        False,
    )


def test_a_job_without_enough_memory_fails_and_others_continue(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(*_arguments: object, **_more: object) -> None:
        raise MemoryError

    shutil.copy(recorded[0], folder / "spool" / "a.mcap")
    (folder / "spool" / "foreign.mcap").write_bytes(b"x")
    monkeypatch.setattr(session_job, "solve_and_store", greedy)
    assert night(folder).sessions_by_status == Counter(failed=1, rejected=1)
    assert reasons_by_name(folder)["a.mcap"] == (
        "failed: the session needs more than 4096 MB of memory. "
        "Repeat it with --retry failed and a larger --memory."
    )


def test_a_version_of_a_newer_program_does_not_stop_other_boards(
    folder: Path, recorded: list[Path]
) -> None:
    shutil.copy(recorded[0], folder / "spool" / "a.mcap")
    night(folder)
    (version,) = create_store(folder / "store").versions(BOARD)
    text = version.path.read_text(encoding="utf-8")
    schema = text.split('schema: "')[1].split('"')[0]
    version.path.write_text(text.replace(schema, f"{schema}9"), encoding="utf-8")
    shutil.copy(recorded[1], folder / "spool" / "b.mcap")
    (folder / "spool" / "foreign.mcap").write_bytes(b"x")
    summary = night(folder)
    assert summary.sessions_by_status == Counter(rejected=2)
    assert f"{schema}9" in reasons_by_name(folder)["b.mcap"]


@pytest.mark.parametrize(
    "words", [["ls"], ["show", "B"], ["diff", "B"], ["verify"], ["rebuild-index"]]
)
def test_a_newer_store_is_refused_by_every_command_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    (tmp_path / STORE_FILE).write_text('schema: "gyrorig/store/9"\n', encoding="utf-8")
    assert run(["store", words[0], str(tmp_path), *words[1:]]) == 3
    output = capsys.readouterr().err.strip()
    assert len(output.splitlines()) == 1
    assert "gyrorig/store/9" in output


def test_a_link_without_its_file_is_rejected_once(folder: Path, recorded: list[Path]) -> None:
    """Before, the batch ignored it and said nothing."""
    (folder / "spool" / "gone.mcap").symlink_to(folder / "nowhere.mcap")
    shutil.copy(recorded[0], folder / "spool" / "good.mcap")
    summary = night(folder, workers=1)
    assert summary.sessions_by_status == Counter(ok=1, rejected=1)
    (row,) = summary.unsuccessful_rows
    assert row.names == ["gone.mcap"]
    assert "it is a link to a file that does not exist" in row.reason
    second = night(folder, workers=1)
    assert (second.done_before, second.finished) == (2, 0)
    assert set(reasons_by_name(folder)) == {"gone.mcap", "good.mcap"}
