"""Mistyped commands get a suggestion; commands of the daemon are passed on."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from gyrorig_solver import cli
from gyrorig_solver.commands import terminal
from gyrorig_solver.commands.terminal import Terminal, colour_verdict
from gyrorig_solver.data.text_table import format_table

Captured = pytest.CaptureFixture[str]


@pytest.mark.parametrize(
    ("typed", "suggested"),
    [("slove", "solve"), ("stroe", "store"), ("compair", "compare"), ("stauts", "status")],
)
def test_a_mistyped_command_gets_a_suggestion(typed: str, suggested: str, capsys: Captured) -> None:
    assert cli.run([typed]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"gyrorig: '{typed}' is not a command. Did you mean ")
    assert suggested in error


@pytest.mark.parametrize(
    ("arguments", "answer"),
    [
        ("export x.yaml --format ross", "Invalid value for '--format': 'ross' is not a possible "
         "value. Did you mean ros? See `gyrorig export --help`."),
        ("batch --spool a --store b --retry xyz", "Use rejected, failed, quarantined. "),
        ("plan --rig r.yaml --criterion wrost", "Did you mean worst? "),
        ("import brod x.npz -o y.mcap", "the format 'brod' is unknown. Did you mean broad?"),
    ],
)  # fmt: skip
def test_a_mistyped_value_gets_a_suggestion(arguments: str, answer: str, capsys: Captured) -> None:
    assert cli.run(arguments.split()) == 2
    assert answer in capsys.readouterr().err


def test_a_word_that_resembles_nothing_points_to_the_help(capsys: Captured) -> None:
    assert cli.run(["xyzzy"]) == 2
    assert "`gyrorig --help` lists the commands" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["doctor", "run", "status", "enqueue", "halt", "recover"])
def test_commands_of_the_daemon_are_passed_on(command: str) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "gyrorig_solver", command, "--help"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert process.stdout.startswith(f"Usage: gyrorigd {command} ")


def test_a_folder_is_checked_recording_by_recording(tmp_path: Path, capsys: Captured) -> None:
    assert cli.run(["check", str(tmp_path)]) == 3
    assert "contains no recording" in capsys.readouterr().err
    (tmp_path / "a.mcap").write_bytes(b"not a recording")
    (tmp_path / "b.mcap").write_bytes(b"neither")
    assert cli.run(["check", str(tmp_path)]) == 3
    error = capsys.readouterr().err
    assert "a.mcap" in error
    assert "b.mcap" in error


def test_progress_is_for_a_terminal_or_on_request(capsys: Captured) -> None:
    Terminal().print_progress("solving GY80-1")
    assert capsys.readouterr().err == ""
    Terminal(verbose=True).print_progress("solving GY80-1")
    assert capsys.readouterr().err == "solving GY80-1\n"
    Terminal(verbose=True, quiet=True).print_progress("solving GY80-1")
    assert capsys.readouterr().err == ""


def test_a_long_command_shows_its_elapsed_time(
    monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.setattr(terminal, "PROGRESS_AFTER_S", 0.0)
    for shown in (Terminal(), Terminal(verbose=True, quiet=True)):
        with shown.show_elapsed_time():
            pass
    assert capsys.readouterr().err == ""
    with Terminal(verbose=True).show_elapsed_time():
        pass
    assert capsys.readouterr().err == "  0 s elapsed\n"
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with Terminal().show_elapsed_time():
        deadline_s = time.monotonic() + 5.0
        while not (output := capsys.readouterr().err) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        assert output == "\r  0 s elapsed\x1b[K"
    assert capsys.readouterr().err == "\r\x1b[K  0 s elapsed\n"


def test_a_verdict_has_colour_on_a_terminal_only(monkeypatch: pytest.MonkeyPatch) -> None:
    assert colour_verdict("good", "good") == "good"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert "\x1b[" in colour_verdict("good", "good")
    monkeypatch.setenv("NO_COLOR", "1")
    assert colour_verdict("good", "good") == "good"


def test_a_table_is_aligned() -> None:
    assert format_table([("a", "10"), ("bcd", "2")], right=(1,)) == ["a    10", "bcd   2"]


def test_ctrl_c_is_130(monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.cli, "main", interrupt)
    assert cli.run(["check", "x.mcap"]) == 130
    assert capsys.readouterr().err == "gyrorig: stopped by Ctrl-C\n"
