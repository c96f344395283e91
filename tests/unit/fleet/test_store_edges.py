"""Edges of the store: names of files, calibrations without recordings, and partial failures."""

import json
import os
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration import create_store, parse_calibration
from gyrorig_solver.calibration.calibration_document import calibration_as_yaml
from gyrorig_solver.cli import run
from gyrorig_solver.fleet.jobs import SolveSettings, session_job
from gyrorig_solver.fleet.jobs.session_job import Job, run_job
from gyrorig_solver.fleet.store import IndexRow, StoreIndex
from gyrorig_solver.fleet.store.index_rows import WorkStatus
from gyrorig_solver.storage import Folder

GOLDEN = Path(__file__).parents[1] / "output" / "golden" / "good.yaml"
Captured = pytest.CaptureFixture[str]


def chamber_table(path: Path, seed: int) -> Path:
    """Write a table of biases and scale factors by temperature."""
    rng = np.random.default_rng(seed)
    degc = np.linspace(0.0, 50.0, 21)
    values = np.column_stack([degc, np.outer(degc, [0.016, -0.008, 0.002]), np.ones((21, 3))])
    values[:, 1:] += rng.normal(0.0, 1e-4, (21, 6))
    head = "temperature_degc,bias_x,bias_y,bias_z,scale_x,scale_y,scale_z"
    np.savetxt(path, values, fmt="%.6f", delimiter=",", header=head, comments="")
    return path


def listed(store: Path, capsys: Captured, *words: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert run(["store", "ls", str(store), *words, "--json"]) == 0
    rows: list[dict[str, Any]] = json.loads(capsys.readouterr().out)["rows"]
    return rows


def test_a_file_name_that_is_not_utf_8_costs_one_recording(
    tmp_path: Path, capsys: Captured
) -> None:
    spool, store = tmp_path / "spool", tmp_path / "store"
    spool.mkdir()
    Path(os.fsdecode(os.fsencode(spool) + b"/caf\xe9.mcap")).write_bytes(b"hello")
    (spool / "other.mcap").write_bytes(b"other")
    words = ["batch", "--spool", str(spool), "--store", str(store), "--workers", "1"]
    assert run(words) == 5
    reasons = {row["reason"] for row in listed(store, capsys, "--wrong")}
    assert len(reasons) == 2
    assert any("is not a text in UTF-8. Rename the file." in reason for reason in reasons)
    assert run(words) == 0  # both are known
    assert run(["solve", os.fsdecode(os.fsencode(spool) + b"/caf\xe9.mcap")]) == 3


def test_calibrations_from_tables_are_found_after_a_rebuild(
    tmp_path: Path, capsys: Captured
) -> None:
    """They have no recording, so that all have the same inputs."""
    store = tmp_path / "store"
    create_store(store)
    for number in (1, 2):
        table = chamber_table(tmp_path / f"t{number}.csv", number)
        assert run(["-q", "temperature", str(table), "--board", "B", "--out", str(store)]) == 0
    assert run(["store", "rebuild-index", str(store)]) == 0
    assert [row["version"] for row in listed(store, capsys, "--all")] == [1, 2]
    assert [row["version"] for row in listed(store, capsys)] == [2]
    for words in (["show", str(store), "B"], ["diff", str(store), "B", "1", "2"]):
        assert run(["store", *words]) == 0
    assert run(["store", "verify", str(store)]) == 0


def test_unsuccessful_work_obeys_the_filters(tmp_path: Path, capsys: Captured) -> None:
    spool, store = tmp_path / "spool", tmp_path / "store"
    spool.mkdir()
    (spool / "a.mcap").write_bytes(b"hello")
    words = ["batch", "--spool", str(spool), "--store", str(store), "--workers", "1"]
    assert run([*words, "--deadline", "inf"]) == 2
    assert run(words) == 5
    assert len(listed(store, capsys, "--wrong")) == 1
    assert listed(store, capsys, "--wrong", "--board", "OTHER") == []
    assert run(["store", "ls", str(store), "--wrong", "--limit", "1"]) == 0
    assert "Only the first" not in capsys.readouterr().out


def row_of(key: str, status: WorkStatus, created: str, *digests: str) -> IndexRow:
    names = [f"{digest}.mcap" for digest in digests]
    return IndexRow(key, status, created, "night", list(digests), names, reason=key)


def test_only_the_newest_job_of_the_same_recordings_is_listed(
    tmp_path: Path, capsys: Captured
) -> None:
    """A recording that a later version of the solver solved is not wrong any more."""
    folder = Folder(tmp_path)
    create_store(folder)
    rows = [
        row_of("solved-later", "failed", "2026-01-01T00:00:00Z", "a", "b"),
        row_of("solved", "ok", "2026-01-02T00:00:00Z", "b", "a"),
        row_of("fails-again", "failed", "2026-01-01T00:00:00Z", "c"),
        row_of("rejected-now", "rejected", "2026-01-02T00:00:00Z", "c"),
        row_of("z", "failed", "2026-01-02T00:00:00Z", "d"),
    ]
    for order in (rows, rows[::-1]):
        StoreIndex(folder).rebuild(iter(order), "rebuilt")
        wrong = listed(tmp_path, capsys, "--wrong")
        assert [row["reason"] for row in wrong] == ["rejected-now", "z"]


def test_a_board_that_is_stored_keeps_its_row_if_a_later_board_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Folder(tmp_path)
    create_store(folder)
    golden = msgspec.structs.replace(
        parse_calibration(GOLDEN.read_bytes(), "golden"), findings=None
    )
    recording = SimpleNamespace(
        board_ids=(BoardId("A"), BoardId("B")),
        metadata={},
        message_count=1,
        sha256="d",
        path=Path("a.mcap"),
    )

    def solve(store: Any, _recordings: Sequence[Any], board: BoardId, **_more: Any) -> Any:
        if board == "B":
            raise MemoryError
        stored = store.add_version(
            board,
            lambda number, before: calibration_as_yaml(
                msgspec.structs.replace(
                    golden,
                    version=number,
                    previous=before,
                    board=msgspec.structs.replace(golden.board, id="A"),
                )
            ),
        )
        return SimpleNamespace(calibration=parse_calibration(stored.data(), "a"), stored=stored)

    monkeypatch.setattr(session_job, "_read_recordings", lambda _job: [recording])
    monkeypatch.setattr(session_job, "fit_together", lambda *_words, **_more: {})
    monkeypatch.setattr(session_job, "solve_and_store", solve)
    names = (PurePosixPath("a.mcap"),)
    job = Job("k" * 64, "b", folder, folder, names, ("d",), SolveSettings("1"))
    rows = run_job(job).rows
    assert [(row.status, row.board) for row in rows] == [("ok", "A"), ("failed", "B")]
