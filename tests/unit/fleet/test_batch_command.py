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
from gyrorig_solver.commands.batch import _Bar, _shard, _told
from gyrorig_solver.fleet.batch import Shard, Summary
from gyrorig_solver.fleet.spool import look


@pytest.fixture
def summary(tmp_path: Path) -> Summary:
    """A batch that began 1000 s ago and has done half of it."""
    (tmp_path / "spool").mkdir()
    for number in range(3):
        (tmp_path / "spool" / f"{number}.mcap").write_bytes(b"%d" % number)
    (tmp_path / "spool" / "now.mcap.part").write_bytes(b"")
    return Summary(
        look(tmp_path / "spool"),
        sessions=10_100,
        done_before=100,
        to_do=10_000,
        begun_s=time.monotonic() - 1000.0,
        ended=Counter(ok=4_000, rejected=1_000),
    )


@pytest.mark.parametrize(
    ("text", "shard"),
    [(None, Shard(1, 1)), ("1/1", Shard(1, 1)), ("3/16", Shard(3, 16)), ("16/16", Shard(16, 16))],
)
def test_a_shard_is_read(text: str | None, shard: Shard) -> None:
    assert _shard(text) == shard


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0/3", "there is no part 0 of 3"),
        ("4/3", "there is no part 4 of 3"),
        ("1/1000001", "there is no part 1 of 1000001"),
        ("x", "'x' is no part of the work: write it as K/N"),
        ("", "'' is no part"),
        ("3", "'3' is no part"),
        ("3/", "'3/' is no part"),
        ("-1/3", "'-1/3' is no part"),
        ("1/2/3", "'1/2/3' is no part"),
        ("\u0661/\u0663", "is no part of the work"),  # digits, of another script
    ],
)
def test_what_is_no_shard_is_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        _shard(text)


@pytest.mark.parametrize("text", ["0/3", "4/3", "x"])
def test_the_command_refuses_it_in_one_line_before_it_writes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str
) -> None:
    words = ["batch", "--spool", str(tmp_path), "--store", str(tmp_path / "s"), "--shard", text]
    assert run(words) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert text in said
    assert "3/16" in said  # how to write it
    assert not (tmp_path / "s").exists()


def test_certificates_without_a_scheduler_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ca.pem").touch()
    words = ["batch", "--spool", str(tmp_path), "--store", str(tmp_path / "s")]
    assert run([*words, "--tls-ca", str(tmp_path / "ca.pem")]) == 2
    assert "are of a scheduler, and none is named: give --scheduler" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


class Screen(io.StringIO):
    """Standard error of a terminal."""

    def isatty(self) -> bool:
        return True


def test_the_bar_says_how_far_how_fast_and_how_long_yet(
    summary: Summary, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "100")
    bar = _Bar()
    bar.show(summary)
    said = screen.getvalue()
    assert said.startswith("\r[" + "#" * 20 + "." * 20 + "]")
    assert "5000 of 10000 sessions, 5.0 a second, 17 min left, 1000 not ok" in said
    assert summary.left_s == pytest.approx(1000.0, rel=0.02)
    bar.end()
    assert screen.getvalue().endswith("\n")


def test_before_the_first_session_nobody_knows_how_long(
    summary: Summary, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    summary.ended.clear()
    _Bar().show(summary)
    assert summary.left_s is None
    assert "0 of 10000 sessions" in screen.getvalue()
    assert "left" not in screen.getvalue()


def test_without_a_terminal_there_is_no_bar(
    summary: Summary, capsys: pytest.CaptureFixture[str]
) -> None:
    bar = _Bar()
    bar.show(summary)
    bar.end()
    assert capsys.readouterr().err == ""


def test_the_table_counts_every_end_and_names_the_commonest_reasons(summary: Summary) -> None:
    summary.boards.update(ok=8_000, rejected=1_000)
    summary.later = {"k1", "k2"}
    summary.put_off_why = "the disk is full: make room"
    for number in range(12):
        told = row(f"k{number}", status="rejected", reason=f"reason {number:02d}")
        summary.wrong += [told] * (20 - number)
    lines = _told(summary, "fleet").splitlines()
    assert lines[0] == "10100 sessions in 3 recordings: 100 done before, 5000 now"
    assert lines[1] == "  1 recordings are still being written"
    table = [line.split() for line in lines[2:6]]
    assert table == [
        ["ok", "4000", "sessions", "8000", "boards"],
        ["rejected", "1000", "sessions", "1000", "boards"],
        ["put", "off", "2", "sessions", "the", "disk", "is", "full:", "make", "room"],
        ["not", "begun", "4998", "sessions", "given", "up;", "start", "again"],
    ]
    assert lines[6].split() == ["20", "x", "rejected:", "reason", "00"]
    assert lines[-2] == "  and 2 reasons more: gyrorig store ls fleet --wrong"
    assert lines[-1].startswith("  17 min, 5.0 sessions a second; the store: fleet")
