"""The firmware's own bytes through a pty into `gyrorigd record`, and what the recording holds."""

import json
import os
import pty
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np

from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns
from gyrorig_protocol.recording.standard_messages import Diagnostics

GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")
REST_S = 3.0
PERIOD_S = 0.005  # of host_board.c
QUEUE_LIMIT = 65_536  # docs/recordings.md
RIG = """
rig: firmware
ptu: {{port: emulated, baud: 115200}}
boards: [{{id: B-1, port: {board}, baud: 115200}}]
"""
PROGRAM = f"name: still\nsteps:\n  - rest: {{seconds: {REST_S}, phase: static}}\n"


def test_a_recording_of_the_firmware_has_no_gap(tmp_path: Path, gapless_board: Path) -> None:
    device, received = pty.openpty()
    os.set_blocking(device, False)
    (tmp_path / "rig.yaml").write_text(RIG.format(board=os.ttyname(received)))
    (tmp_path / "program.yaml").write_text(PROGRAM)
    board = subprocess.Popen([gapless_board, str(device), "1"], pass_fds=[device])
    os.close(device)
    try:
        ended = subprocess.run(
            [*GYRORIGD, "record", "--config", "rig.yaml", "--program", "program.yaml",
             "--out", "out", "--json"],
            cwd=tmp_path, capture_output=True, text=True, check=False,
        )  # fmt: skip
    finally:
        board.terminate()
        board.wait(10)
        with suppress(OSError):
            os.close(received)
    assert ended.returncode == 0, ended.stderr
    recording = read_recording(tmp_path / json.loads(ended.stdout)["recording"])
    assert recording.is_complete
    assert recording.metadata["gyrorig.board.B-1"]["uid"] == "00112233aabbccdd"
    samples = recording.array("/board/B-1/imu_raw")
    numbers = samples["sequence"].astype(np.int64)
    assert np.all(np.diff(numbers) == 1)
    assert np.all(np.diff(samples["message_sequence"].astype(np.int64)) == 1)
    span_s = float(times_ns(samples["host_time"][[0, -1]]) @ [-1, 1]) * 1e-9
    assert span_s > REST_S - 0.1
    # each value follows from its sample's number, so none is another's
    counts = np.stack([numbers, -numbers, 3 * numbers], axis=1).astype(np.int16)
    assert np.array_equal(samples["gyro"], counts)
    *_, last = (m for m in recording.messages("/diagnostics") if isinstance(m, Diagnostics))
    values = {status.name: status.values for status in last.status}
    assert values["board/B-1"]["missing"] == "0"
    assert 1 <= int(values["recorder"]["queue_high_water"]) < QUEUE_LIMIT
    assert values["recorder"]["messages_dropped"] == "0"
