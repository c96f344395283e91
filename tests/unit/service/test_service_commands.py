"""The commands of the service, on the command line."""

import json
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.cli import run
from gyrorig_daemon.service.service_context import ServiceCounts
from gyrorig_daemon.service.state_folder import StateFolder
from gyrorig_daemon.service.status_server import StatusServer

Make = Callable[..., Any]
Capture = pytest.CaptureFixture[str]

RIG = (
    "rig: r\nptu: {port: emulated, baud: 115200}\n"
    "boards: [{id: B-1, port: emulated, baud: 460800}]\n"
)
PROGRAM = "name: p\nsteps:\n  - rest: {seconds: 1.0}\n"


@pytest.fixture
def served() -> Iterator[StatusServer]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        with StatusServer(path, lambda command, _: f"{command} heard", ServiceCounts()) as server:
            yield server


def test_check(tmp_path: Path, capsys: Capture) -> None:
    config = tmp_path / "rig.yaml"
    config.write_text(RIG)
    assert run(["run", "--check", "--config", str(config)]) == 0
    assert "the configuration is valid (rig r, 1 boards)" in capsys.readouterr().out
    config.write_text(RIG + "schedule: [{name: a, program: p.yaml, every_h: 1.0}]\n")
    assert run(["run", "--check", "--config", str(config)]) == 2  # no such program
    (tmp_path / "p.yaml").write_text(PROGRAM)
    assert run(["run", "--check", "--config", str(config)]) == 0
    config.write_text("rig: [")
    assert run(["run", "--config", str(config), "--state", str(tmp_path / "state")]) == 2
    assert capsys.readouterr().err.count("\n") == 2
    assert not (tmp_path / "state").exists()  # nothing was begun


def test_enqueue(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "p.yaml"
    program.write_text(PROGRAM)
    arguments = ["enqueue", "--program", str(program), "--session", "s-1", "--json"]
    assert run([*arguments, "--state", str(tmp_path)]) == 1
    refusal = capsys.readouterr().err
    assert "the job cannot be written to" in refusal
    assert f", and no daemon is running with the state folder {tmp_path}. Give" in refusal
    (tmp_path / "queue").mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/else")
    assert run(arguments) == 0
    output = capsys.readouterr()
    job = json.loads(output.out)
    assert Path(job["file"]).parent == tmp_path / "queue"
    assert "session: 's-1'" in Path(job["file"]).read_text().replace('"', "'")
    assert output.err.startswith(
        f"No daemon is running with the state folder {tmp_path}. The job starts"
    )
    with StateFolder(tmp_path):
        assert run(arguments) == 0
    assert capsys.readouterr().err == ""


def test_status(make_bench: Make, served: StatusServer, capsys: Capture) -> None:
    bench = make_bench()
    bench.serve(3.0)
    served.publish(bench.statuses[-1])
    assert run(["status", "--socket", str(served.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["schema"] == "gyrorig/status/1"
    assert run(["status", "--socket", str(served.path)]) == 0
    assert capsys.readouterr().out.startswith("rig test: ready\n")


@pytest.mark.parametrize(
    ("command", "heard"), [("clear", "clear"), ("stop-motion", "halt"), ("reload", "reload")]
)
def test_orders(served: StatusServer, capsys: Capture, command: str, heard: str) -> None:
    assert run([command, "--socket", str(served.path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"said": f"{heard} heard"}


def test_nobody_there(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    for command in ("status", "clear", "stop-motion", "reload"):
        assert run([command]) == 1
        error = capsys.readouterr().err
        assert f"no daemon is running at the socket {tmp_path}/gyrorigd.sock" in error
        assert error.count("\n") == 1
