"""A service on an emulated rig, with simulated monotonic and system times."""

import heapq
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardFaults, RigSettings
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.service.housekeeping import Housekeeping
from gyrorig_daemon.service.job_queue import JobQueue
from gyrorig_daemon.service.jobs import enqueue_job
from gyrorig_daemon.service.persistent_state import PersistentState
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_daemon.service.service_context import (
    OperatorRequests,
    ServiceClocks,
    ServiceContext,
    ServiceCounts,
)
from gyrorig_daemon.service.service_loop import LoopExit, ServiceLoop
from gyrorig_daemon.service.state_folder import StateFolder
from gyrorig_daemon.service.systemd_notifier import SystemdNotifier
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.emulator_process import emulated_rig_settings

ORIGIN_NS = 5_000_000_000
UTC_S = 1_790_000_000.0

RIG = """
rig: test
ptu: {port: emulated, baud: 115200, poll: {rate_hz: 10}}
boards: [{id: B-1, port: emulated, baud: 460800}]
emulator: {command_time_ms: 5.0}
service: {board_patience_s: 5.0}
"""

SHORT = """
name: short
steps:
  - rest: {seconds: 1.0, phase: static}
  - move: {pan_deg: 20.0, speed_deg_s: 40.0}
  - home: {}
"""


class RecordingNotifier(SystemdNotifier):
    """Remembers what systemd would be told."""

    def __init__(self) -> None:
        super().__init__(None, 10.0)
        self.words: list[str] = []

    def _send(self, text: str) -> None:
        self.words.append(text)


class Bench:
    """One rig in service. `at` plans what happens; `serve` lets it."""

    def __init__(
        self,
        folder: Path,
        rig_text: str = RIG,
        change: Callable[[RigSettings], RigSettings] | None = None,
    ) -> None:
        config = parse_rig(rig_text, "rig.yaml")
        settings = emulated_rig_settings(config, 3)
        self.rig = EmulatedRig(change(settings) if change else settings, ORIGIN_NS)
        self.hub = VirtualHub(self.rig)
        self.orders = OperatorRequests()
        self.notifier = RecordingNotifier()
        self.log: list[str] = []
        self.statuses: list[dict[str, Any]] = []
        self.stepped_s = 0.0  # how far the wall clock was set
        self.refusal = ""  # why a new configuration cannot be used
        # After the next status, simulated time stands still while the solver runs.
        self.waits_for_solver = False
        self._enough: Callable[[], bool] | None = None
        self._plans: list[tuple[int, int, Callable[[], None]]] = []
        self.due_ns = ORIGIN_NS
        self.state = StateFolder(folder / "state").__enter__()
        self.parts = ServiceContext(
            state_folder=self.state,
            queue=JobQueue(self.state.queue),
            schedule=Schedule(config.schedule, self.state.schedule, self.now_s()),
            persistent=PersistentState(self.state.persistent_state, self.utc_s()),
            requests=self.orders,
            counts=ServiceCounts(),
            notifier=self.notifier,
            clocks=ServiceClocks(
                lambda: CaptureClock(int(self.utc_s() * 1e9), self.hub.now_ns()),
                self.read_host,
                self.now_s,
                self.utc_s,
            ),
            host="host",
            config_text=rig_text.encode(),
            read_program=lambda name: SHORT.encode(),
            reload_config=lambda: self.refusal,
            publish=self.statuses.append,
            stalled_loops=list,
            dropped_bytes=lambda: 0,
            log=self.log.append,
            housekeeping=Housekeeping(
                self.state, lambda: config.service, self.utc_s, self.log.append
            ),
            threaded_writer=False,
        )
        capture = CaptureClock(int(self.utc_s() * 1e9), self.hub.now_ns())
        self.opened = Rig(self.hub, config, capture, stop=self.orders.stop, seed=1)
        self.daemon = ServiceLoop(self.opened, self.parts)
        self.opened.pump.add_timer(self)

    def now_s(self) -> float:
        return self.hub.now_ns() * 1e-9

    def utc_s(self) -> float:
        return UTC_S + (self.hub.now_ns() - ORIGIN_NS) * 1e-9 + self.stepped_s

    def read_host(self) -> HostClocks:
        now_ns = self.hub.now_ns()
        return HostClocks(now_ns, now_ns, int(self.utc_s() * 1e9), 0.0, 0.0, 0)

    def at(self, seconds: float, plan: Callable[[], Any]) -> None:
        heapq.heappush(
            self._plans, (ORIGIN_NS + int(seconds * 1e9), len(self._plans), lambda: plan() and None)
        )

    def solver(self) -> Any:
        """The process of the solver, None if it does not run."""
        progress = self.daemon._experiment._progress
        child = None if progress is None else progress.process
        return None if child is None else child._process

    def fire(self, now_ns: int) -> None:
        self.due_ns = now_ns + 50_000_000
        is_published = bool(self.statuses) and self.statuses[-1]["state"] == "explaining"
        if self.waits_for_solver and is_published and (child := self.solver()) is not None:
            child.wait()
        if self._enough is not None and self._enough():
            self.orders.request_termination("enough")
        while self._plans and self._plans[0][0] <= now_ns:
            heapq.heappop(self._plans)[2]()

    def serve(self, until_s: float, enough: Callable[[], bool] | None = None) -> LoopExit:
        """Let time pass until then, or until `enough`."""
        self._enough = enough
        self.at(until_s, lambda: self.orders.request_termination("SIGTERM"))
        return self.daemon.run()

    def put(self, program: str = SHORT, **more: Any) -> Path:
        return enqueue_job(self.state.queue, program.encode(), "program.yaml", **more)

    def recordings(self) -> list[Path]:
        return sorted(self.state.recordings.rglob("*.mcap"))

    def ended(self, folder: str, count: int) -> Callable[[], bool]:
        """Whether so many jobs are put aside."""
        return lambda: len(self.results(folder)) >= count

    def results(self, folder: str) -> list[Path]:
        return sorted((self.state.queue / folder).glob("*.result.json"))

    def state_at(self, seconds: float) -> dict[str, Any]:
        """What the status said last at a time."""
        index = max(0, min(len(self.statuses) - 1, round(seconds) - 1))
        earlier = [s for s in self.statuses if s["uptime_s"] <= seconds]
        return earlier[-1] if earlier else self.statuses[index]

    def is_still(self) -> bool:
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return not np.any(self.rig.stage.body_rates_rad_s(now_s, 0.01, 100))

    def pan_deg(self) -> float:
        now_s = (self.hub.now_ns() - ORIGIN_NS) * 1e-9
        return float(np.degrees(self.rig.stage.pan.angles_rad(now_s, 0.1, 1)[0]))


def board_with(**faults: Any) -> Callable[[RigSettings], RigSettings]:
    def change(settings: RigSettings) -> RigSettings:
        first, *others = settings.boards
        return replace(settings, boards=(replace(first, faults=BoardFaults(**faults)), *others))

    return change
