"""Findings of the doctor from the status of a running service."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.doctor.daemon_check import check_daemon
from gyrorig_daemon.doctor.finding import Level
from gyrorig_daemon.service.service_protocol import encode


def status(**changes: Any) -> dict[str, Any]:
    """A daemon at peace, with changes."""
    board = {
        "id": "B-1",
        "state": "known",
        "rate_hz": 100.0,
        "counts": {"samples": 9},
        "faults": {},
    }
    return {
        "state": "ready",
        "reason": "",
        "uptime_s": 7200.0,
        "pid": 4711,
        "unit": {"state": "stands", "text": "it stands", "port": "/dev/x", "steps_are_sure": True},
        "boards": [board | changes.pop("board", {})],
        "recorder": {"degraded": ""},
        "last_session": None,
    } | changes


@contextmanager
def answering(folder: Path, document: dict[str, Any]) -> Iterator[Path]:
    """A daemon that says one thing, once."""
    path = folder / "sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen(1)

        def serve() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(encode({"ok": True, "status": document}))

        thread = threading.Thread(target=serve)
        thread.start()
        yield path
        thread.join()


def test_a_daemon_at_peace(tmp_path: Path) -> None:
    with answering(tmp_path, status()) as path:
        findings, running = check_daemon(path)
    assert [finding.code for finding in findings] == ["running", "seen", "seen"]
    assert running is not None
    assert (running.samples_hz, running.motion_is_locked, running.steps_are_sure) == (
        100.0,
        False,
        True,
    )


@pytest.mark.parametrize(
    ("changes", "code", "level"),
    [
        ({"state": "fault", "reason": "the pan axis met its limit"}, "held", Level.FAULT),
        ({"state": "waiting", "reason": "no word from B-1"}, "waiting", Level.WARNING),
        (
            {"unit": {"state": "absent", "text": "its port is not there", "steps_are_sure": True}},
            "absent",
            Level.FAULT,
        ),
        (
            {"unit": {"state": "silent", "text": "it does not answer", "steps_are_sure": True}},
            "silent",
            Level.FAULT,
        ),
        (
            {
                "unit": {
                    "state": "stands", "text": "it stands", "port": "x", "steps_are_sure": False,
                }
            },
            "lost_steps",
            Level.WARNING,
        ),
        ({"board": {"state": "silent"}}, "not_heard", Level.FAULT),
        ({"board": {"counts": {"missing": 3}, "faults": {"crc": 2}}}, "losses", Level.NOTE),
        ({"recorder": {"degraded": "the disk is full"}}, "degraded", Level.FAULT),
        (
            {"last_session": {"session": "s", "result": "failed", "reason": "a limit"}},
            "last_session",
            Level.NOTE,
        ),
    ],
)  # fmt: skip
def test_a_daemon_with_a_worry(
    tmp_path: Path, changes: dict[str, Any], code: str, level: Level
) -> None:
    with answering(tmp_path, status(**changes)) as path:
        findings, _ = check_daemon(path)
    (finding,) = [finding for finding in findings if finding.level > Level.OK]
    assert (finding.code, finding.level) == (code, level)
    assert finding.remedy


def test_nobody_there(tmp_path: Path) -> None:
    assert check_daemon(tmp_path / "none") == ([], None)
    left = tmp_path / "left"
    with socket.socket(socket.AF_UNIX) as died:
        died.bind(str(left))
    (finding,), running = check_daemon(left)
    assert (finding.code, running) == ("no_answer", None)
