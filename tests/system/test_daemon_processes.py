"""The daemon as users run it: real processes, pseudo-terminals, signals, exit status."""

import json
import os
import pty
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from tests.support.commands_in_process import run_command

from gyrorig_daemon.cli import run as run_in_process
from gyrorig_daemon.links.ports.acquisition_hub import AcquisitionHub, PortSettings
from gyrorig_daemon.links.pump import Pump
from gyrorig_daemon.motion.directed_perception.ptu_client import PtuClient
from gyrorig_protocol.errors import GyrorigError
from gyrorig_protocol.ptu import Axis, Quantity, query_quantity, require_integer
from gyrorig_protocol.recording.reader import read_recording

GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")
BAUD = 115200

RIG = """
rig: system
ptu: {{port: {ptu}, baud: 115200}}
boards: [{{id: B-1, port: {board}, baud: 460800}}]
emulator: {{command_time_ms: 2.0}}
"""
QUICK = """
name: quick
steps:
  - rest: {seconds: 1.0, phase: static}
  - move: {pan_deg: 30.0, tilt_deg: 10.0, speed_deg_s: 45.0}
  - rest: {seconds: 0.5}
  - move: {pan_deg: -10.0, speed_deg_s: 45.0}
  - home: {}
"""
LONG = "name: long\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 4.0}\n"  # 37.5 s
PATIENCE_S = 60.0
TARGET_STEPS = 2917  # 150 deg


def write_inputs(folder: Path, ports: dict[str, str], program: str) -> list[str]:
    text = RIG.format(ptu=ports["ptu"], board=ports["board:B-1"])
    (folder / "rig.yaml").write_text(text)
    (folder / "program.yaml").write_text(program)
    files = [str(folder / name) for name in ("rig.yaml", "program.yaml", "out")]
    return ["record", "--config", files[0], "--program", files[1], "--out", files[2]]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*GYRORIGD, *arguments], capture_output=True, text=True, check=False, timeout=90
    )


@contextmanager
def emulator(folder: Path) -> Iterator[dict[str, str]]:
    (folder / "emulated.yaml").write_text(RIG.format(ptu="emulated", board="emulated"))
    process = subprocess.Popen(
        [*GYRORIGD, "emulate", "--config", folder / "emulated.yaml", "--json", "--until-eof"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    if process.stdin is None or process.stdout is None:
        raise AssertionError
    with process.stdout, process.stdin:
        yield json.loads(process.stdout.readline())["ports"]
    assert process.wait(PATIENCE_S) == 0


def pan_steps(path: str) -> int:
    """Ask the unit itself; wait while a dying process still holds the port."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            hub = AcquisitionHub({"ptu": PortSettings(path, BAUD)})
            break
        except GyrorigError:
            assert time.monotonic() < deadline
            time.sleep(0.02)
    with hub:
        client = PtuClient(Pump(hub), "ptu", location=path, baud=BAUD, on_exchange=lambda _: None)
        client.send_spaces(1)
        client.drain(0.05)
        command = query_quantity(Axis.PAN, Quantity.POSITION)
        return require_integer(command, client.ask(command))


def wait_for_motion(folder: Path) -> Path:
    """Wait until the growing file says that pan is on its way."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        with suppress(GyrorigError, ValueError, KeyError):
            for path in folder.glob("*.mcap.part"):
                recording = read_recording(path)
                if recording.array("/ptu/position")["pan_steps"].max() > 100:
                    return path
        time.sleep(0.1)
    raise AssertionError("it never moved")


def test_a_complete_recording_on_pseudo_terminals(tmp_path: Path, contract_judge: Path) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "emulated", "board:B-1": "emulated"}, QUICK)
    truth = tmp_path / "truth.json"
    ended = run(*arguments, "--truth", str(truth), "--json", "--seed", "5")
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    path = Path(json.loads(ended.stdout)["recording"])
    judged = subprocess.run([sys.executable, contract_judge, path], check=False)
    assert judged.returncode == 0
    recording = read_recording(path)
    assert recording.is_complete
    sequence = recording.array("/board/B-1/imu_raw")["sequence"].astype(np.int64)
    assert np.all(np.diff(sequence) % 65536 == 1)
    positions = recording.array("/ptu/position")
    assert (positions["pan_steps"].max(), positions["pan_steps"][-1]) == (583, 0)
    assert len(recording.messages("/host/clock")) >= 4
    document = json.loads(truth.read_text())
    assert document["seed"] == 5
    assert "mean_bias_rad_s" in document["boards"]["B-1"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_in_motion_halts_and_keeps(tmp_path: Path, number: signal.Signals) -> None:
    with emulator(tmp_path) as ports:
        arguments = write_inputs(tmp_path, ports, LONG)
        daemon = subprocess.Popen([*GYRORIGD, *arguments], stderr=subprocess.PIPE, text=True)
        wait_for_motion(tmp_path / "out")
        daemon.send_signal(number)
        _, errors = daemon.communicate(timeout=PATIENCE_S)
        assert daemon.returncode == (130 if number is signal.SIGINT else 1)
        assert errors.startswith(f"gyrorigd: stopped by {number.name}. The unit is halted")
        assert errors.count("\n") == 1
        stopped_at = pan_steps(ports["ptu"])
        assert 100 < stopped_at < TARGET_STEPS
        assert pan_steps(ports["ptu"]) == stopped_at
    (path,) = (tmp_path / "out").iterdir()
    recording = read_recording(path)
    assert path.suffix == ".mcap"
    assert recording.is_complete


def test_killed_in_motion_the_acquisition_halts_the_unit(tmp_path: Path) -> None:
    with emulator(tmp_path) as ports:
        daemon = subprocess.Popen([*GYRORIGD, *write_inputs(tmp_path, ports, LONG)])
        part = wait_for_motion(tmp_path / "out")
        known = len(read_recording(part).array("/ptu/position"))  # in the file before
        daemon.kill()
        daemon.wait()
        stopped_at = pan_steps(ports["ptu"])
        assert 100 < stopped_at < TARGET_STEPS
        assert pan_steps(ports["ptu"]) == stopped_at
    recording = read_recording(part)
    assert not recording.is_complete
    assert len(recording.array("/ptu/position")) >= known


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "/dev/none", "board:B-1": "/dev/none2"}, QUICK)
    ended = run(*arguments)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith("gyrorigd: the port /dev/none (ptu) does not exist")
    assert ended.stderr.count("\n") == 1


def test_a_port_that_is_busy(tmp_path: Path) -> None:
    with emulator(tmp_path) as ports:
        with AcquisitionHub({"ptu": PortSettings(ports["ptu"], BAUD)}):
            ended = run(*write_inputs(tmp_path, ports, QUICK))
        assert ended.returncode == 75
        assert "is busy" in ended.stderr


def test_devices_on_the_wrong_ports(tmp_path: Path) -> None:
    with emulator(tmp_path) as ports:
        swapped = {"ptu": ports["board:B-1"], "board:B-1": ports["ptu"]}
        ended = run(*write_inputs(tmp_path, swapped, QUICK))
        assert ended.returncode == 1
        assert "is not a pan-tilt unit" in ended.stderr
        board = {"ptu": ports["board:B-1"], "board:B-1": ports["board:B-1"]}
        assert run(*write_inputs(tmp_path, board, QUICK)).returncode == 2  # one port named twice
        assert pan_steps(ports["ptu"]) == 0


def test_a_silent_unit(tmp_path: Path) -> None:
    with emulator(tmp_path) as ports:
        master, slave = pty.openpty()
        ended = run(*write_inputs(tmp_path, ports | {"ptu": os.ttyname(slave)}, QUICK))
        os.close(master)
        os.close(slave)
        assert ended.returncode == 1
        assert "no pan-tilt unit answers" in ended.stderr


@pytest.mark.parametrize(
    ("rig", "program", "words"),
    [
        ("rig: x\nptus: {}\n", QUICK, "rig.yaml"),
        (RIG.format(ptu="emulated", board="emulated"), "name: x\nsteps: [{jump: {}}]\n", "jump"),
        (
            RIG.format(ptu="emulated", board="emulated"),
            "name: x\nsteps: 3\n",
            "steps is 3. Give a list",
        ),
        ("a: *b\n", QUICK, "rig.yaml"),
    ],
)
def test_documents_that_are_wrong(tmp_path: Path, rig: str, program: str, words: str) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "emulated", "board:B-1": "emulated"}, program)
    (tmp_path / "rig.yaml").write_text(rig)
    ended = run_command(run_in_process, *arguments)
    assert ended.returncode == 2
    assert words in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["frob"], "No such command 'frob'"),
        (["record"], "Missing option '--config'"),
        (["record", "--config", ".", "--program", "x"], "is a directory"),
        (["emulate", "--config", "x", "--seed", "-1"], "--seed"),
        (["emulate", "--config", "none.yaml"], "none.yaml cannot be read"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], words: str) -> None:
    ended = run_command(run_in_process, *arguments)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert words in ended.stderr
    assert ended.stderr.startswith("gyrorigd: ")
    assert ended.stderr.count("\n") == 1


@pytest.mark.parametrize("name", ["../../x", "", "a\nb", "x" * 300])
def test_a_session_name_must_be_valid_in_a_file_name(tmp_path: Path, name: str) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "emulated", "board:B-1": "emulated"}, QUICK)
    ended = run_command(run_in_process, *arguments, "--simulated-time", "--session", name)
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    assert "the session name" in ended.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("time", [["--simulated-time"], []])
def test_a_truth_file_that_cannot_be_written_is_an_error_at_the_start(
    tmp_path: Path, time: list[str]
) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "emulated", "board:B-1": "emulated"}, QUICK)
    ended = run(*arguments, *time, "--truth", str(tmp_path / "none" / "truth.yaml"), "--json")
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert "cannot be written" in ended.stderr
    assert json.loads(ended.stdout)["exit_code"] == 1
    assert not (tmp_path / "out").exists()


def test_documents_can_come_through_pipes(tmp_path: Path) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "emulated", "board:B-1": "emulated"}, QUICK)
    reading, writing = os.pipe()
    os.write(writing, (tmp_path / "rig.yaml").read_bytes())
    os.close(writing)
    arguments[arguments.index("--config") + 1] = f"/dev/fd/{reading}"
    ended = subprocess.run(
        [*GYRORIGD, *arguments, "--simulated-time"], pass_fds=[reading], check=False
    )
    os.close(reading)
    assert ended.returncode == 0


def test_standard_output_can_be_closed(tmp_path: Path) -> None:
    arguments = write_inputs(tmp_path, {"ptu": "emulated", "board:B-1": "emulated"}, QUICK)
    command = shlex.join([*GYRORIGD, *arguments, "--simulated-time"])
    for unheard in (f"{command} >&-", f"{command} | true"):
        ended = subprocess.run(["bash", "-c", unheard], capture_output=True, text=True, check=False)
        assert (ended.returncode, ended.stderr) == (0, "")


def test_an_interrupt_at_the_start_leaves_no_traceback(tmp_path: Path) -> None:
    script = "import os, signal, sys; sys.argv = ['gyrorigd', '--version'];"
    # a Ctrl-C in the middle of the imports, at the same place each time
    script += (
        "from importlib.abc import MetaPathFinder\n"
        "class Finder(MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'gyrorig_daemon.commands.command_group':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from gyrorig_daemon.cli import main; main()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, "", "")


def test_an_internal_error_is_one_line() -> None:
    script = (
        "import sys; sys.argv = ['gyrorigd', 'emulate', '--config', 'x'];"
        "import gyrorig_daemon.commands.emulate_command as c; c.load_rig = lambda _: 1 / 0;"
        "from gyrorig_daemon.cli import main; main()"
    )
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1)
    assert "ZeroDivisionError" in ended.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["record", "--help"], ["emulate", "--help"]])
def test_help_has_an_example(arguments: list[str]) -> None:
    ended = run_command(run_in_process, *arguments)
    assert ended.returncode == 0
    assert "Example: gyrorigd" in " ".join(ended.stdout.split())


def test_the_version_is_printed() -> None:
    assert run("--version").stdout.startswith("gyrorig ")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_emulate_ends_on_a_signal(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "rig.yaml").write_text(RIG.format(ptu="emulated", board="emulated"))
    process = subprocess.Popen(
        [*GYRORIGD, "emulate", "--config", tmp_path / "rig.yaml", "--until-eof"],
        stdin=subprocess.PIPE,  # still open: its end is not what ends it
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    if process.stdout is None:
        raise AssertionError
    names = {process.stdout.readline().split("\t")[0] for _ in range(2)}
    process.send_signal(number)
    assert process.wait(PATIENCE_S) == 0
    _, errors = process.communicate()
    assert (names, errors) == ({"ptu", "board:B-1"}, "")
