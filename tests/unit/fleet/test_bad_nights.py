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
from gyrorig_solver.calibration.store import STORE_FILE, make_sharded
from gyrorig_solver.cli import run
from gyrorig_solver.fleet import task
from gyrorig_solver.fleet.batch import Summary, run_batch
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.lanes import Lane
from gyrorig_solver.fleet.task import Settings
from gyrorig_solver.fleet.verifying import verify

BOARD = BoardId("GY80-1")


def night(folder: Path, workers: int = 2) -> Summary:
    lanes = [Lane(lambda: ThreadPoolExecutor(1)) for _ in range(workers)]
    return run_batch(folder / "spool", folder / "store", Settings(solver_version="0.1.0"), lanes)


def why(folder: Path) -> dict[str, str]:
    rows = Index(folder / "store").ask("SELECT names[1], status || ': ' || reason FROM rows")
    return {str(name): str(said) for name, said in rows}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "spool").mkdir()
    return tmp_path


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
    said = why(folder)
    assert summary.put_off == 0
    assert set(said) == {path.name for path in spool.iterdir()}
    assert said.pop("good.mcap").startswith("ok")
    assert all(one.startswith("rejected: ") for one in said.values()), said
    assert not list(folder.glob("**/b"))
    assert verify(folder / "store").faults == ()


def test_two_boards_of_one_name_solved_at_once_do_not_share_a_chain(
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
    assert summary.ended == Counter(ok=1, rejected=1)
    assert any("two boards have one name" in one for one in why(folder).values())
    assert len(make_sharded(folder / "store").versions(BOARD)) == 1
    assert verify(folder / "store").faults == ()


def test_a_disk_that_is_full_for_a_while_costs_no_work(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, path in enumerate(recorded):
        shutil.copy(path, folder / "spool" / f"{number}.mcap")
    make_sharded(folder / "store")
    link, full = os.link, True

    def refused(*arguments: object) -> None:
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        link(*arguments)  # type: ignore[arg-type] # as it was called

    monkeypatch.setattr(os, "link", refused)
    first = night(folder)
    assert (first.finished, first.put_off) == (0, 2)
    assert "No space left on device" in first.put_off_why
    assert first.in_part
    full = False
    second = night(folder)
    assert (second.ended, second.put_off) == (Counter(ok=2), 0)
    assert len(make_sharded(folder / "store").versions(BOARD)) == 2
    assert verify(folder / "store").faults == ()


def test_what_was_refused_for_a_moment_is_done_in_the_same_night(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(recorded[0], folder / "spool")
    make_sharded(folder / "store")
    link, left = os.link, 1

    def refused(*arguments: object) -> None:
        nonlocal left
        if left:
            left -= 1
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        link(*arguments)  # type: ignore[arg-type] # as it was called

    monkeypatch.setattr(os, "link", refused)
    summary = night(folder)
    assert (summary.ended, summary.put_off, summary.in_part) == (Counter(ok=1), 0, False)


def test_work_that_needs_too_much_memory_fails_and_the_others_go_on(
    folder: Path, recorded: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(*_arguments: object, **_more: object) -> None:
        raise MemoryError

    shutil.copy(recorded[0], folder / "spool" / "a.mcap")
    (folder / "spool" / "foreign.mcap").write_bytes(b"x")
    monkeypatch.setattr(task, "solve_into", greedy)
    assert night(folder).ended == Counter(failed=1, rejected=1)
    assert why(folder)["a.mcap"] == (
        "failed: it needs more than 4096 MB of memory: --retry failed, and more with --memory"
    )


def test_a_board_whose_newest_version_is_of_a_newer_program_keeps_no_other(
    folder: Path, recorded: list[Path]
) -> None:
    shutil.copy(recorded[0], folder / "spool" / "a.mcap")
    night(folder)
    (version,) = make_sharded(folder / "store").versions(BOARD)
    text = version.path.read_text(encoding="utf-8")
    schema = text.split('schema: "')[1].split('"')[0]
    version.path.write_text(text.replace(schema, f"{schema}9"), encoding="utf-8")
    shutil.copy(recorded[1], folder / "spool" / "b.mcap")
    (folder / "spool" / "foreign.mcap").write_bytes(b"x")
    summary = night(folder)
    assert summary.ended == Counter(rejected=2)
    assert f"{schema}9" in why(folder)["b.mcap"]


@pytest.mark.parametrize(
    "words", [["ls"], ["show", "B"], ["diff", "B"], ["verify"], ["rebuild-index"]]
)
def test_a_newer_store_is_refused_by_every_command_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    (tmp_path / STORE_FILE).write_text('schema: "gyrorig/store/9"\n', encoding="utf-8")
    assert run(["store", words[0], str(tmp_path), *words[1:]]) == 3
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert "gyrorig/store/9" in said
