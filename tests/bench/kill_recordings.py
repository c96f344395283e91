"""Kill real recordings with SIGKILL at random moments, recover them, and report the loss.

    .venv/bin/python tests/bench/kill_recordings.py --kills 200

Each kill ends a new `gyrorigd record` on emulated devices behind ptys. The moment of the kill is
between the creation of the file and a short time after the end of the program. The script forks
the recorders, because the imports take most of the start time. A monitor samples the daemon and
the emulated rig. For a loss above 0.8 s, the report states whether they ran, waited for a
processor or for the disk. After each kill, the script recovers the recording, and reads it with
the reader of the mcap library and with ours. It exits with status 1 if data before the end are
missing, repeated or damaged, or if a loss at the end is larger than `LIMIT_S`.
"""

import argparse
import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.standing import ProcessMonitor

from gyrorig_daemon import cli
from gyrorig_daemon.commands import command_group as _imported_once  # noqa: F401
from gyrorig_daemon.recorder.recovery import RecoveryOutcome, recover_folder
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import times_ns
from gyrorig_protocol.recording.salvage import read_strictly

GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")
EXPLAINED_LOSS_S = 0.8  # the report explains losses from this size
LIMIT_S = 1.0  # largest loss after "kill -9 or power cut at any moment"
RIG = """
rig: kill
ptu: {{port: {ptu}, baud: 115200}}
boards: [{{id: B-1, port: {board}, baud: 460800}}]
emulator: {{command_time_ms: 5.0, odr_hz: 400}}
"""
PROGRAM = """
name: kill
steps:
  - rest: {seconds: 0.6, phase: static}
  - move: {pan_deg: 20.0, tilt_deg: 10.0, speed_deg_s: 40.0}
  - move: {pan_deg: -20.0, tilt_deg: -5.0, speed_deg_s: 40.0}
  - home: {}
  - rest: {seconds: 0.6, phase: static}
"""
BUSY_STATUS = 75
IMU = "/board/B-1/imu_raw"


@dataclass(frozen=True, slots=True)
class Kill:
    """The result of one kill."""

    outcome: str
    loss_s: float | None  # from the last recovered sample to the kill
    samples: int
    fault: str = ""
    missing: int = 0  # samples that did not reach the daemon, by the counter of the board
    why: str = ""  # activity of the processes during the lost time


class ForkedRecorder:
    """A forked `gyrorigd`, which starts without imports."""

    def __init__(self, arguments: list[str]) -> None:
        self.code: int | None = None
        self.pid = os.fork()
        if self.pid == 0:
            os.setsid()
            null = os.open(os.devnull, os.O_RDWR)
            for handle in (0, 1, 2):
                os.dup2(null, handle)
            os._exit(cli.run(arguments))

    def wait(self, timeout_s: float) -> bool:
        """Return whether the process ends within a time."""
        deadline = time.monotonic() + timeout_s
        while self.code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > deadline:
                return False
            else:
                time.sleep(0.002)
        return True

    def kill(self) -> None:
        """Kill the process, as the kernel does without free memory."""
        if self.code is None:
            os.kill(self.pid, signal.SIGKILL)
            self.wait(60.0)


class Rig:
    """Emulated devices on ptys, which make one recording after the other."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        folder.mkdir()
        emulated = folder / "emulated.yaml"
        emulated.write_text(RIG.format(ptu="emulated", board="emulated"))
        self._process = subprocess.Popen(
            [*GYRORIGD, "emulate", "--config", emulated, "--json", "--until-eof"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        if self._process.stdout is None:
            raise AssertionError
        ports = json.loads(self._process.stdout.readline())["ports"]
        self._rig, self._program = folder / "rig.yaml", folder / "program.yaml"
        self._rig.write_text(RIG.format(ptu=ports["ptu"], board=ports["board:B-1"]))
        self._program.write_text(PROGRAM)
        self._rng = random.Random(seed)

    def close(self) -> None:
        """End the emulator."""
        self._process.communicate(timeout=30)

    def kill_one(self, number: int) -> Kill:
        """Start a recording, kill it, and recover it."""
        out = self._folder / f"out{number}"
        daemon = self._start_recording(out)
        # The file exists now; the longest wait ends after the end of the program.
        opened_ns = time.time_ns()
        monitor = ProcessMonitor({"daemon": daemon.pid, "emulated rig": self._process.pid})
        daemon.wait(self._rng.uniform(0.0, 5.0))
        killed_s, killed_ns = time.monotonic(), time.time_ns()
        daemon.kill()
        monitor.close()
        kill = self._check_recording(out, opened_ns, None if daemon.code == 0 else killed_ns)
        if kill.loss_s is None or kill.loss_s < EXPLAINED_LOSS_S:
            return kill
        return replace(kill, why=monitor.describe_activity(killed_s - kill.loss_s))

    def _start_recording(self, out: Path) -> "ForkedRecorder":
        files = ["--config", str(self._rig), "--program", str(self._program), "--out", str(out)]
        failures = 0
        while True:
            daemon = ForkedRecorder(["record", *files])
            deadline = time.monotonic() + 60.0
            while not self._list_files(out) and time.monotonic() < deadline:
                if daemon.wait(0.01):
                    break
            else:
                return daemon
            if daemon.code == 0:
                return daemon
            # The acquisition process of the previous recording may still halt the unit.
            failures += daemon.code != BUSY_STATUS
            if failures > 5:
                raise SystemExit(f"gyrorigd exited with status {daemon.code} before it made a file")
            time.sleep(0.2)

    @staticmethod
    def _list_files(out: Path) -> list[Path]:
        return [*out.glob("*.mcap"), *out.glob("*.part")] if out.is_dir() else []

    def _check_recording(self, out: Path, opened_ns: int, killed_ns: int | None) -> Kill:
        """Recover the recording, and check its samples."""
        reports = recover_folder(out)
        outcomes = [report.outcome for report in reports]
        finished = sorted(out.glob("*.mcap"))
        outcome = outcomes[0].value if outcomes else "closed"
        if RecoveryOutcome.FAILED in outcomes or (killed_ns is None and outcomes):
            return Kill(outcome, None, 0, reports[0].text)
        duration_s = 0.0 if killed_ns is None else (killed_ns - opened_ns) * 1e-9
        if not finished:
            return Kill("no whole chunk yet", duration_s, 0)
        (path,) = finished
        read_strictly(path)
        recording = read_recording(path)
        if not recording.is_complete:
            return Kill(outcome, None, 0, f"losses: {recording.losses}")
        if IMU not in recording.topics:  # the first chunk has only replies of the unit
            return Kill("no sample yet", duration_s, 0)
        samples = recording.array(IMU)
        numbers = samples["message_sequence"].tolist()
        if numbers != list(range(len(numbers))):
            return Kill(outcome, None, len(samples), "a gap in the message numbers of the daemon")
        # A gap in the counter of the board is a loss before the daemon, which is not a fault.
        sequence = samples["sequence"].astype(np.uint16)
        missing = int((sequence[1:] - sequence[:-1]).astype(np.int64).sum()) - len(sequence) + 1
        last_ns = int(times_ns(samples["host_time"][-1:])[0])
        loss_s = None if killed_ns is None or not outcomes else max(killed_ns - last_ns, 0) * 1e-9
        return Kill(outcome, loss_s, len(samples), missing=missing)


def main() -> int:
    """Kill recordings, and print the report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    kills_per_job = [len(range(job, options.kills, options.jobs)) for job in range(options.jobs)]
    with tempfile.TemporaryDirectory(prefix="kill-") as folder:
        jobs = [
            (Path(folder, str(job)), options.seed * 1000 + job, count)
            for job, count in enumerate(kills_per_job)
        ]
        with multiprocessing.Pool(options.jobs) as pool:
            kills = [
                kill for batch in pool.starmap(kill_recordings, jobs, chunksize=1) for kill in batch
            ]
    return report(kills)


def kill_recordings(folder: Path, seed: int, count: int) -> list[Kill]:
    """Kill several recordings on a separate rig."""
    rig = Rig(folder, seed)
    kills = []
    try:
        for number in range(count):
            kills.append(rig.kill_one(number))
            sys.stderr.write(f"{len(kills)} {kills[-1]}\n")
    finally:
        rig.close()
    return kills


def report(kills: list[Kill]) -> int:
    """Print the results of the kills; return 1 for a fault or for a loss above the limit."""
    outcomes = Counter(kill.outcome for kill in kills)
    losses = sorted(kill.loss_s for kill in kills if kill.loss_s is not None)
    too_large = [loss for loss in losses if loss > LIMIT_S]
    faults = [kill.fault for kill in kills if kill.fault]
    lines = [
        f"{len(kills)} kills: " + ", ".join(f"{n} {outcome}" for outcome, n in outcomes.items())
    ]
    if losses:
        median_s = losses[len(losses) // 2]
        lines.append(
            f"lost at the end: median {median_s:.2f} s, largest {losses[-1]:.2f} s "
            f"({len(too_large)} above {LIMIT_S:.0f} s)"
        )
    lines += [f"  {kill.loss_s:.2f} s, {kill.outcome}: {kill.why}" for kill in kills if kill.why]
    samples = sum(kill.samples for kill in kills)
    missing = sum(kill.missing for kill in kills)
    lines.append(
        f"samples recovered: {samples}; gaps, damage or refusals: {len(faults)}; "
        f"lost between board and daemon: {missing}"
    )
    sys.stdout.write("\n".join([*lines, *faults]) + "\n")
    return 1 if faults or too_large or len(kills) == 0 else 0


if __name__ == "__main__":
    sys.exit(main())
