"""`gyrorigd record` with a person, through pseudo-terminals and in simulated time."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.commands_in_process import run_command

from gyrorig_daemon.cli import run as run_daemon
from gyrorig_protocol.recording.messages import EventKind
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.cli import run as run_solver

ROOT = Path(__file__).resolve().parents[2]
RIG = ROOT / "config" / "manual" / "rig.yaml"
SHORT = """
schema: gyrorig/program/1
name: short
steps:
- {rest: {seconds: 2.0, phase: static}}
- {turn: {axis: [0.0, 0.0, 1.0], angle_deg: 180.0, seconds: 4.0}}
- {rest: {seconds: 2.0, phase: static}}
"""


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *words], capture_output=True, text=True, check=False
    )


def test_the_shipped_program_is_guided_and_solved(tmp_path: Path) -> None:
    program = ROOT / "config" / "manual" / "turns.yaml"
    recorded = run_command(
        run_daemon, "record", "--config", str(RIG), "--program", str(program),
        "--out", str(tmp_path), "--simulated-time", "--truth", str(tmp_path / "truth.yaml"),
    )  # fmt: skip
    assert recorded.returncode == 0, recorded.stderr
    assert recorded.stderr.count("go\n") == 6
    path = recorded.stdout.strip()
    solved = run_command(run_solver, "solve", path, "--out", str(tmp_path / "cal"))
    assert solved.returncode in (0, 4), solved.stderr
    compared = run_command(
        run_solver, "compare", str(tmp_path / "cal/GY80-1/v0001.yaml"),
        str(tmp_path / "truth.yaml"),
    )  # fmt: skip
    assert "12 of 12 by at most 3.5 u" in compared.stdout


@pytest.mark.timeout(120)
def test_a_person_is_guided_in_real_time(tmp_path: Path) -> None:
    program = tmp_path / "short.yaml"
    program.write_text(SHORT)
    recorded = run(
        "gyrorig_daemon", "record", "--config", str(RIG), "--program", str(program),
        "--out", str(tmp_path / "out"),
    )  # fmt: skip
    assert recorded.returncode == 0, recorded.stderr
    lines = recorded.stderr.splitlines()
    assert lines[-1] == "The program is finished."
    assert "Turn the board by +180 deg about +z within 4 s." in lines
    recording = read_recording(Path(recorded.stdout.strip()))
    ends = [
        (e.phase, e.text)
        for e in recording.events()
        if e.kind == EventKind.PHASE_END and e.phase == "turn"
    ]
    assert ("turn", "") in ends
