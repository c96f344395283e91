"""No text of a device or of a file controls the terminal of the person who reads it."""

import json
from pathlib import Path

import pytest

from gyrorig_daemon import cli
from gyrorig_daemon.commands.terminal import Terminal
from gyrorig_daemon.doctor import doctor_command
from gyrorig_daemon.doctor.finding import warning
from gyrorig_protocol.errors import DeviceError

HOSTILE = "\x1b]0;title\x07\x1b[2J\u2028\x9b2J"


def is_plain(text: str) -> bool:
    return all(line.isprintable() for line in text.split("\n"))


@pytest.mark.parametrize(
    "error",
    [DeviceError(f"the unit answers {HOSTILE}"), OSError(2, "missing", HOSTILE), KeyError(HOSTILE)],
    ids=lambda error: type(error).__name__,
)
def test_an_error_with_a_reply_of_a_unit(
    error: Exception, capsys: pytest.CaptureFixture[str]
) -> None:
    cli._report_error(error, as_json=True)
    printed = capsys.readouterr()
    assert printed.err.startswith("gyrorigd: ")
    assert is_plain(printed.err)
    assert "title" in json.loads(printed.out)["error"]


@pytest.mark.parametrize("words", [["--traceback"], []])
def test_an_error_with_its_traceback(
    words: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("GYRORIG_TRACEBACK", "1")
    assert cli.run([*words, "status", "--socket", str(tmp_path / "a\x1b[2J")]) == 1
    text = capsys.readouterr().err
    assert "Traceback (most recent call last):\n" in text
    assert is_plain(text)


def test_a_finding_of_the_doctor(capsys: pytest.CaptureFixture[str]) -> None:
    doctor_command._print(warning("unit", "foreign", f"it answers {HOSTILE}", f"read {HOSTILE}"))
    assert is_plain(capsys.readouterr().out)


def test_a_note(capsys: pytest.CaptureFixture[str]) -> None:
    Terminal().note(f"board {HOSTILE}")
    assert is_plain(capsys.readouterr().err)


def test_the_name_of_an_unfinished_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a\x1b[2J.mcap.part").write_bytes(b"no recording")
    cli.run(["recover", str(tmp_path)])
    printed = capsys.readouterr()
    assert "[2J" in printed.out
    assert is_plain(printed.out + printed.err)
