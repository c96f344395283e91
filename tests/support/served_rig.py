"""A service on emulated devices in real time: a process, its log, its children, its unit.

The devices are served by the test, so that their own log tells what the unit was told.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import PtuSettings, RigSettings
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.service.jobs import enqueue_job
from gyrorig_daemon.service.service_client import send_command
from gyrorig_protocol.errors import GyrorigError

GYRORIGD = (sys.executable, "-m", "gyrorig_daemon")
FAR = b"name: far\nsteps:\n  - move: {pan_deg: 150.0, speed_deg_s: 4.0}\n"
REST_FAR = FAR.replace(b"steps:\n", b"steps:\n  - rest: {seconds: 2.5}\n")
SHORT = b"name: short\nsteps:\n  - move: {pan_deg: 5.0, speed_deg_s: 40.0}\n  - home: {}\n"


def wait_for(condition: Callable[[], Any], patience_s: float = 90.0) -> None:
    end_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end_s, "it did not come true"
        time.sleep(0.02)


class Devices:
    """An emulated rig on ptys, served in a thread."""

    def __init__(self) -> None:
        unit = PtuSettings(baud=115200, command_time_ms=2.0)
        self.rig = EmulatedRig(RigSettings(seed=1, ptu=unit), raw_now_ns())
        self.server = PtyServer(self.rig)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self.server.run, args=(self._ended.is_set,))
        self._thread.start()

    def turning(self) -> bool:
        return self.rig.stage.pan.is_moving((raw_now_ns() - self.rig.origin_ns) * 1e-9)

    def halts(self) -> int:
        return [order[0] for order in self.rig.stage.pan.commands].count("halt")

    def halt_after_s(self, since_ns: int, patience_s: float) -> float:
        """How long after a raw monotonic time the unit was told to halt; at most the patience."""
        since_s = (since_ns - self.rig.origin_ns) * 1e-9
        end_ns = since_ns + int(patience_s * 1e9)
        while raw_now_ns() < end_ns:
            for order, at_s, *_ in list(self.rig.stage.pan.commands):
                if order == "halt" and at_s >= since_s:
                    return float(at_s - since_s)
            time.sleep(0.005)
        return patience_s

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self.server.close()


class Service:
    """One `gyrorigd run`, and what systemd would hear and ask."""

    def __init__(self, folder: Path, devices: Devices, name: str = "") -> None:
        self.folder = folder
        self.more: list[str] = []  # options of `gyrorigd run`
        self.environment: dict[str, str] = {}
        self.config = folder / "rig.yaml"
        self.state = folder / f"state{name}"
        self.socket = folder / f"sock{name}"
        self.sane = (
            "rig: system\n"
            f"ptu: {{port: {devices.server.paths['ptu']}, baud: 115200}}\n"
            f"boards: [{{id: B-1, port: {devices.server.paths['board:GY80-1']}, baud: 460800}}]\n"
            "service: {reserve_mb: 10, board_patience_s: 0.0}\n"
        )
        self.config.write_text(self.sane)
        self.notifications: list[str] = []
        self._notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notify.bind(str(folder / f"notify{name}"))
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        self.process: subprocess.Popen[str] | None = None

    def start(self, stderr: int = subprocess.PIPE) -> subprocess.Popen[str]:
        environment = os.environ | {
            "NOTIFY_SOCKET": str(self._notify.getsockname()),
            "WATCHDOG_USEC": "10000000",
            **self.environment,
        }
        command: list[str | Path] = [*GYRORIGD, "run", "--config", self.config]
        command += ["--state", self.state, "--socket", self.socket, *self.more]
        self.process = subprocess.Popen(
            command, env=environment, stderr=stderr, text=True, start_new_session=True
        )
        return self.process

    def start_ready(self, stderr: int = subprocess.PIPE) -> subprocess.Popen[str]:
        before = self.notifications.count("READY=1")
        process = self.start(stderr)
        wait_for(lambda: self.notifications.count("READY=1") > before)
        return process

    def add_board(self, board_id: str, port: str) -> None:
        """Add a board to the rig file, before the start."""
        self.sane = self.sane.replace(
            "}]\nservice", f"}}, {{id: {board_id}, port: {port}, baud: 460800}}]\nservice"
        )
        self.config.write_text(self.sane)

    def status(self) -> dict[str, Any]:
        try:
            answer = send_command(self.socket, "status")["status"]
        except GyrorigError:
            return {"state": "silent"}
        assert isinstance(answer, dict)
        return answer

    def counted(self, where: str, name: str) -> int:
        """A count of the status, 0 where nobody answers."""
        return int(self.status().get(where, {}).get(name, 0))

    def enqueue(self, program: bytes, **more: Any) -> None:
        enqueue_job(self.state / "queue", program, "program.yaml", **more)

    def results(self, folder: str) -> list[dict[str, Any]]:
        paths = sorted((self.state / "queue" / folder).glob("*.result.json"))
        return [json.loads(path.read_text()) for path in paths]

    def recordings(self) -> list[Path]:
        return sorted((self.state / "recordings").glob("*.mcap"))

    def children(self) -> list[int]:
        assert self.process is not None
        path = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        return [int(pid) for pid in path.read_text().split()]

    def end(self, number: signal.Signals = signal.SIGTERM) -> tuple[int, str]:
        assert self.process is not None
        if self.process.poll() is None:
            self.process.send_signal(number)
        _, errors = self.process.communicate(timeout=60)
        return self.process.returncode, errors

    def close(self) -> None:
        if self.process is not None and self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.communicate()
        self._notify.close()

    def _listen(self) -> None:
        while True:
            try:
                self.notifications.append(self._notify.recv(4096).decode())
            except OSError:
                return
