"""A service in simulated time whose rig is powered up for a window now and then.

What to use when: `Life` is one process of `gyrorigd run` on a state folder; `Life.serve` runs its
main loop on a rig that has just been powered up. `SimulatedTime` outlives every process: it is the
time of the computer. The code of the daemon is the real one: main loop, sessions, recorder, queue,
schedule, recovery, retention and metrics. Between two windows the rig has no power, so that 90 days
take minutes: the time in between passes at once.
"""

import errno
import gc
import heapq
import itertools
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.config import parse_rig
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.service import session_runner
from gyrorig_daemon.service.housekeeping import Housekeeping
from gyrorig_daemon.service.job_queue import JobQueue
from gyrorig_daemon.service.jobs import enqueue_job
from gyrorig_daemon.service.metrics import MetricsWriter
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
from gyrorig_daemon.session.session import Session
from gyrorig_protocol.recording.mcap.disk_file import Disk, DiskFile

# UTC of the first day. It is in the past, because files that are written while the simulation runs
# get the time of the real clock, until the simulation changes it.
POWER_UP_S = 1_740_000_000.0
SLICE_NS = 50_000_000
LONGEST_WINDOW_S = 900.0
PATIENCE_S = 120.0  # of real time, for the recovery in its own process

RIG = """
schema: gyrorig/rig/1
rig: years
ptu: {port: emulated, baud: 115200, poll: {rate_hz: 10}}
boards:
  - {id: B-1, port: emulated, baud: 460800}
  - {id: B-2, port: emulated, baud: 460800}
emulator: {command_time_ms: 5.0}
schedule:
  - {name: nightly, program: nightly.yaml, at_utc: "02:00"}
  - {name: often, program: often.yaml, every_h: 12.0}
service: {board_patience_s: 5.0, part_s: 10.0, reserve_mb: 10, keep_days: 10, keep_mb: 12}
"""

OFTEN = b"""
name: often
steps:
  - rest: {seconds: 1.0, phase: static}
  - move: {pan_deg: 20.0, speed_deg_s: 40.0}
  - home: {}
"""


@dataclass(slots=True)
class SimulatedTime:
    """The clocks of the computer. The monotonic clock stands still while it is suspended."""

    monotonic_s: float = 5.0
    offset_s: float = POWER_UP_S  # of UTC to the monotonic clock
    true_offset_s: float = POWER_UP_S  # the same, without steps of the clock

    @property
    def true_utc_s(self) -> float:
        return self.monotonic_s + self.true_offset_s

    def pass_to(self, true_utc_s: float) -> None:
        """Let time pass, unless it has passed already."""
        self.monotonic_s = max(self.monotonic_s, true_utc_s - self.true_offset_s)

    def suspend(self, seconds: float) -> None:
        """Suspend the computer."""
        self.offset_s += seconds
        self.true_offset_s += seconds

    def is_right(self) -> bool:
        """Whether the system time is right."""
        return abs(self.offset_s - self.true_offset_s) < 1.0


class FillableDisk(Disk):
    """Takes nothing while `is_full` is set."""

    def __init__(self) -> None:
        self.is_full = False

    def create(self, path: Path) -> DiskFile:
        self._check()
        file = super().create(path)
        write, sync = file.write, file.sync

        def checked_write(data: bytes) -> int:
            self._check()
            return write(data)

        def checked_sync() -> None:
            self._check()
            sync()

        file.write, file.sync = checked_write, checked_sync  # type: ignore[method-assign]
        return file

    def _check(self) -> None:
        if self.is_full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class _QuietNotifier(SystemdNotifier):
    def __init__(self) -> None:
        super().__init__(None, 10.0)

    def _send(self, text: str) -> None:
        pass


@dataclass(slots=True)
class Window:
    """One time for which the rig has power: its hub, and what is planned for it."""

    hub: VirtualHub
    life: "Life"
    until_ns: int
    due_ns: int
    awaited_job: str = ""  # in whose session `in_session` acts; "": in any
    _plans: list[tuple[int, int, Callable[[], Any]]] = field(default_factory=list)
    _when_running: list[tuple[float, Callable[[], Any]]] = field(default_factory=list)
    _number: "itertools.count[int]" = field(default_factory=itertools.count)

    def at(self, seconds: float, action: Callable[[], Any]) -> None:
        """Do something so long from now."""
        due_ns = self.hub.now_ns() + int(seconds * 1e9)
        heapq.heappush(self._plans, (due_ns, next(self._number), action))

    def in_session(self, seconds: float, action: Callable[[], Any]) -> None:
        """Do something so long after the next session has begun to move."""
        self._when_running.append((seconds, action))

    def unplug(self, port: str, seconds: float) -> None:
        """Disconnect a device for a while."""
        now_ns = self.hub.now_ns()
        self.hub.unplug(port, now_ns, now_ns + int(seconds * 1e9))

    def fire(self, now_ns: int) -> None:
        """Carry out what is due; called by the pump of the daemon."""
        self.due_ns = now_ns + SLICE_NS
        self.life.time.monotonic_s = now_ns * 1e-9
        session = self.life.loop.state.session if self.life.loop else None
        if self._when_running and session is not None and self._is_awaited(session):
            for seconds, action in self._when_running:
                self.at(seconds, action)
            self._when_running.clear()
        while self._plans and self._plans[0][0] <= now_ns:
            heapq.heappop(self._plans)[2]()

    def _is_awaited(self, session: Session) -> bool:
        summary = self.life.loop.state.summary.session if self.life.loop else None
        is_named = not self.awaited_job or (summary or {}).get("job") == self.awaited_job
        return is_named and session.planned_s > 0.0

    def is_over(self) -> bool:
        """Whether nothing is left to be done; called between sessions only."""
        if self._plans or self.hub.now_ns() < self.until_ns:
            return False
        context = self.life.context
        now = self.life.time.monotonic_s, self.life.utc_s()
        waits = context.queue.waiting_jobs() or context.schedule.due_entry(*now) is not None
        is_blocked = self.life.loop is not None and bool(self.life.loop.state.summary.reason)
        late_ns = self.until_ns + int(LONGEST_WINDOW_S * 1e9)
        return not waits or is_blocked or self.hub.now_ns() > late_ns


class Life:
    """One process of the service."""

    def __init__(
        self, folder: Path, time_of: SimulatedTime, nightly: bytes, log: Callable[[str], None]
    ) -> None:
        self.time = time_of
        self.disk = FillableDisk()
        self.loop: ServiceLoop | None = None
        self._window: Window | None = None
        self._config = parse_rig(RIG, "rig.yaml")
        self._programs = {"nightly.yaml": nightly, "often.yaml": OFTEN}
        self.requests = OperatorRequests()
        self.state = StateFolder(folder).__enter__()
        self.metrics = MetricsWriter(self.state.metrics)
        self.housekeeping = Housekeeping(
            self.state, lambda: self._config.service, self._valid_utc_s, log
        )
        session_runner.Recorder = partial(Recorder, disk=self.disk)  # type: ignore[assignment,attr-defined]
        self.context = ServiceContext(
            state_folder=self.state,
            queue=JobQueue(self.state.queue),
            schedule=Schedule(self._config.schedule, self.state.schedule, self.time.monotonic_s),
            persistent=PersistentState(self.state.persistent_state, self.utc_s()),
            requests=self.requests,
            counts=ServiceCounts(),
            notifier=_QuietNotifier(),
            clocks=ServiceClocks(self._anchor, self._read_host, self._monotonic_s, self.utc_s),
            host="host",
            config_text=RIG.encode(),
            read_program=self._programs.__getitem__,
            reload_config=str,
            publish=self.metrics.publish,
            stalled_loops=list,
            dropped_bytes=lambda: 0,
            reopen_reason=self._reopen_reason,
            log=log,
            housekeeping=self.housekeeping,
            threaded_writer=False,
        )

    def recover(self) -> None:
        """Let the housekeeping recover what a crash has left, as at the start of the service."""
        parts = len(list(self.state.recordings.glob("*.mcap.part")))
        self.housekeeping.start()
        counts, end_s = self.housekeeping.counts, time.monotonic() + PATIENCE_S
        while counts.recovered + counts.not_recovered < parts and time.monotonic() < end_s:
            time.sleep(0.02)

    def serve(
        self, seconds: float, seed: int, plan: Callable[[Window], None], awaited_job: str = ""
    ) -> LoopExit:
        """Power the rig up, and run the main loop at least so long and until nothing is due."""
        origin_ns = int(self.time.monotonic_s * 1e9)
        hub = VirtualHub(EmulatedRig(emulated_rig_settings(self._config, seed), origin_ns))
        window = Window(hub, self, origin_ns + int(seconds * 1e9), origin_ns, awaited_job)
        capture = CaptureClock(int(self.utc_s() * 1e9), hub.now_ns())
        rig = Rig(hub, self._config, capture, stop=self.requests.stop, seed=seed)
        self._window, self.loop = window, ServiceLoop(rig, self.context)
        rig.pump.add_timer(window)
        plan(window)
        try:
            return self.loop.run()
        finally:
            self.time.monotonic_s = hub.now_ns() * 1e-9
            self._window = self.loop = None

    def put_job(self, home: bool = False) -> None:
        """Add a job to the queue, as an operator does."""
        enqueue_job(self.state.queue, OFTEN, "often.yaml", home=home)

    def end(self) -> None:
        """End the process."""
        self.housekeeping.close()
        self.metrics.close()
        self.context.queue.close()
        self.state.__exit__(None, None, None)
        self.loop = None
        gc.collect()

    def utc_s(self) -> float:
        return self._monotonic_s() + self.time.offset_s

    def _valid_utc_s(self) -> float | None:
        return self.utc_s() if self.time.is_right() else None

    def _monotonic_s(self) -> float:
        hub = None if self._window is None else self._window.hub
        return self.time.monotonic_s if hub is None else hub.now_ns() * 1e-9

    def _anchor(self) -> CaptureClock:
        return CaptureClock(int(self.utc_s() * 1e9), int(self._monotonic_s() * 1e9))

    def _read_host(self) -> HostClocks:
        now_ns = int(self._monotonic_s() * 1e9)
        return HostClocks(now_ns, now_ns, int(self.utc_s() * 1e9), 0.0, 0.0, 0)

    def _reopen_reason(self) -> str:
        is_over = self._window is not None and self._window.is_over()
        return "the rig has no power" if is_over else ""
