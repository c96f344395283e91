"""SIGKILL at random moments of recordings in real time, also during rotation.

Here only the recorder runs; `make kill` does the same to whole sessions, 200 times.
"""

import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns

TOPIC = "/board/B-1/imu_raw"
KILLS, AT_ONCE = 8, 4
# Of what was handed over: a chunk a second, and the turns of a loaded machine.
LIMIT_S = 1.0 + 1.0

CHILD = """
import sys, time
from pathlib import Path
from gyrorig_daemon.recorder import Recorder, RecorderSettings, RecordingPlan
from gyrorig_protocol.recording.messages import ImuRaw
own = {"session": "s", "anchor_utc_ns": "0", "anchor_monotonic_raw_ns": "0"}
recorder = Recorder(True, RecorderSettings(part_s=0.7, survives_faults=True))
recorder.open(RecordingPlan(Path(sys.argv[1]) / "a.mcap", {"gyrorig": own}, ()))
k = 0
while True:
    for _ in range(8):
        now_ns = time.monotonic_ns()
        recorder.put("/board/B-1/imu_raw", ImuRaw(now_ns, k, k, 0, 0, (k, k, k)), now_ns)
        k += 1
    print(k, now_ns, flush=True)
    time.sleep(0.01)
"""


@dataclass
class Victim:
    folder: Path
    process: subprocess.Popen[str]
    after_s: float

    def kill(self) -> tuple[int, int]:
        """Kill it at its moment; the last sample it had handed over, and when."""
        out = self.process.stdout
        assert out is not None
        line = out.readline()
        deadline = time.monotonic() + self.after_s
        while time.monotonic() < deadline:
            line = out.readline()
        os.kill(self.process.pid, signal.SIGKILL)
        rest = out.read().splitlines(keepends=True)
        whole = [text for text in [line, *rest] if text.endswith("\n")]
        self.process.wait()
        out.close()
        k, now_ns = whole[-1].split()
        return int(k), int(now_ns)


def check(folder: Path, handed: int, handed_ns: int) -> tuple[float, int]:
    """Recover; seconds lost at the end, and how many files there are."""
    reports = recover_folder(folder)
    assert all(report.outcome is not RecoveryOutcome.FAILED for report in reports), reports
    numbers: list[int] = []
    last_ns = 0
    files = sorted(folder.glob("*.mcap"))
    for path in files:
        recording = read_recording(path)
        assert recording.is_complete, recording.losses
        samples = recording.array(TOPIC)
        assert (samples["sequence"] == samples["message_sequence"]).all()
        numbers += samples["sequence"].tolist()
        last_ns = int(times_ns(samples["host_time"][-1:])[0])
    assert numbers == list(range(len(numbers)))  # nothing before the end is missing or twice
    first_ns = handed_ns if not numbers else last_ns
    return max(handed_ns - first_ns, 0) * 1e-9, len(files)


def test_kills_at_random_moments(tmp_path: Path) -> None:
    chance = random.Random(5)
    files = 0
    for batch in range(KILLS // AT_ONCE):
        victims = []
        for number in range(AT_ONCE):
            folder = tmp_path / f"{batch}-{number}"
            folder.mkdir()
            process = subprocess.Popen(
                [sys.executable, "-c", CHILD, str(folder)], stdout=subprocess.PIPE, text=True
            )
            victims.append(Victim(folder, process, chance.uniform(0.0, 2.5)))
        for victim in sorted(victims, key=lambda kill: kill.after_s):
            lost_s, count = check(victim.folder, *victim.kill())
            assert lost_s <= LIMIT_S
            files += count
    assert files > KILLS  # parts were closed and opened meanwhile
