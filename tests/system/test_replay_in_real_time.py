"""A replay in real time: the emulated rig runs in its own process."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from tests.unit.daemon.test_replay import PROGRAM, RIG, Motion, record

from gyrorig_protocol.recording.reader import read_recording


def test_a_replay_in_real_time_begins_at_its_time(tmp_path: Path) -> None:
    program = tmp_path / "program.yaml"
    program.write_text(PROGRAM)
    recorded = record(tmp_path / "first", "--program", str(program))
    command = [sys.executable, "-m", "gyrorig_daemon", "record", "--config", str(RIG), "--replay",
               str(recorded.path), "--out", str(tmp_path), "--json"]  # fmt: skip
    made = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert made.returncode == 0, made.stderr
    again = read_recording(Path(json.loads(made.stdout)["recording"]))
    first, second = Motion.of(recorded), Motion.of(again)
    assert np.array_equal(first.order_values, second.order_values)
    assert np.median(np.abs(first.order_s - second.order_s)) < 5e-3
