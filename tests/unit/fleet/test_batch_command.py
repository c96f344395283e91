"""`gyrorig batch` to its reader: shards, the bar while it runs, the table at its end."""

import io
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from tests.unit.fleet.conftest import row

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.cli import run
from gyrorig_solver.commands.batch_command import _parse_shard, _ProgressBar, _summary_text
from gyrorig_solver.commands.terminal import Terminal
from gyrorig_solver.fleet.jobs import BatchSummary
from gyrorig_solver.fleet.jobs.batch_run import Shard
from gyrorig_solver.fleet.jobs.spool_scanner import scan_spool


@pytest.fixture
def summary(tmp_path: Path) -> BatchSummary:
    """A batch that began 1000 s ago and has done half of it."""
    (tmp_path / "spool").mkdir()
    for number in range(3):
        (tmp_path / "spool" / f"{number}.mcap").write_bytes(b"%d" % number)
    (tmp_path / "spool" / "now.mcap.part").write_bytes(b"")
    return BatchSummary(
        scan_spool(tmp_path / "spool"),
        sessions=10_100,
        done_before=100,
        to_do=10_000,
        started_s=time.monotonic() - 1000.0,
        sessions_by_status=Counter(ok=4_000, rejected=1_000),
    )


@pytest.mark.parametrize(
    ("text", "shard"),
    [(None, Shard(1, 1)), ("1/1", Shard(1, 1)), ("3/16", Shard(3, 16)), ("16/16", Shard(16, 16))],
)
def test_a_shard_is_read(text: str | None, shard: Shard) -> None:
    assert _parse_shard(text) == shard


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0/3", "because 3 shards have no shard 0"),
        ("4/3", "because 3 shards have no shard 4"),
        ("1/1000001", "because 1000001 shards have no shard 1"),
        ("x", "'x' of --shard does not have the form K/N. Write the shard as K/N"),
        ("", "'' of --shard does not have the form K/N"),
        ("3", "'3' of --shard does not have the form K/N"),
        ("3/", "'3/' of --shard does not have the form K/N"),
        ("-1/3", "'-1/3' of --shard does not have the form K/N"),
        ("1/2/3", "'1/2/3' of --shard does not have the form K/N"),
        ("\u0661/\u0663", "does not have the form K/N"),  # digits of another script
    ],
)
def test_an_invalid_shard_is_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        _parse_shard(text)


@pytest.mark.parametrize("text", ["0/3", "4/3", "x"])
def test_the_command_refuses_an_invalid_shard_before_it_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    words = ["batch", "--spool", str(tmp_path), "--store", str(tmp_path / "s"), "--shard", text]
    assert run(words) == 2
    output = capsys.readouterr().err.strip()
    assert len(output.splitlines()) == 1
    assert text in output
    assert "3/16" in output  # how to write it
    assert not (tmp_path / "s").exists()


def test_certificates_without_a_scheduler_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ca.pem").touch()
    words = ["batch", "--spool", str(tmp_path), "--store", str(tmp_path / "s")]
    assert run([*words, "--tls-ca", str(tmp_path / "ca.pem")]) == 2
    assert (
        "--tls-key work only with the option --scheduler. Add --scheduler"
        in capsys.readouterr().err
    )
    assert not (tmp_path / "s").exists()


class Screen(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


def test_the_progress_bar_shows_count_rate_and_remaining_time(
    summary: BatchSummary, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "140")
    bar = _ProgressBar(Terminal())
    bar.show(summary)
    output = screen.getvalue()
    assert output.startswith("\r[" + "#" * 20 + "." * 20 + "]")
    assert "5000 of 10000 sessions, 5.0 per second, 17 min left, 1000 not ok" in output
    assert summary.remaining_s == pytest.approx(1000.0, rel=0.02)
    assert "not ok, 0 s elapsed" in output
    bar.end()
    assert screen.getvalue().endswith("\r\x1b[K")


def test_the_remaining_time_is_unknown_before_the_first_session(
    summary: BatchSummary, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    summary.sessions_by_status.clear()
    _ProgressBar(Terminal()).show(summary)
    assert summary.remaining_s is None
    assert "0 of 10000 sessions" in screen.getvalue()
    assert "left" not in screen.getvalue()


def test_there_is_no_progress_bar_without_a_terminal(
    summary: BatchSummary, capsys: pytest.CaptureFixture[str]
) -> None:
    bar = _ProgressBar(Terminal())
    bar.show(summary)
    bar.end()
    assert capsys.readouterr().err == ""


def test_the_summary_counts_statuses_and_lists_common_reasons(summary: BatchSummary) -> None:
    summary.boards_by_status.update(ok=8_000, rejected=1_000)
    summary.deferred_keys = {"k1", "k2"}
    summary.deferral_reason = "the disk is full. Free some space."
    for number in range(12):
        reported = row(f"k{number}", status="rejected", reason=f"reason {number:02d}")
        summary.unsuccessful_rows += [reported] * (20 - number)
    lines = _summary_text(summary, "fleet").splitlines()
    assert lines[0] == "10100 sessions in 3 recordings: 100 done before, 5000 now"
    assert lines[1] == "  1 recording is still being written"
    table = [line.split() for line in lines[2:6]]
    assert table == [
        ["ok", "4000", "sessions", "8000", "boards"],
        ["rejected", "1000", "sessions", "1000", "boards"],
        ["deferred", "2", "sessions", "the", "disk", "is", "full.", "Free", "some", "space."],
        [
            "not",
            "started",
            "4998",
            "sessions",
            "the",
            "batch",
            "stopped",
            "early;",
            "run",
            "it",
            "again",
        ],
    ]
    assert lines[6].split() == ["20", "x", "rejected:", "reason", "00"]
    assert lines[-2] == "  and 2 more reasons: gyrorig store ls fleet --wrong"
    assert lines[-1].startswith("  17 min, 5.0 sessions per second; store: fleet")


def test_an_empty_spool_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "spool").mkdir()
    command = ["batch", "--spool", str(tmp_path / "spool"), "--store", str(tmp_path / "store")]
    assert run(command) == 0
    assert f"{tmp_path / 'spool'} contains no recordings (*.mcap)" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["ls", "show", "diff", "verify", "rebuild-index"])
def test_the_help_of_store_commands_has_an_example(
    capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert run(["store", command, "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "\\b" not in "".join(lines)
    example = lines[lines.index("  Example:") + 1]
    assert example.startswith(f"    gyrorig store {command} calibrations")
