"""Context of the main loop: the objects that outlive an opened rig.

What to use when: `service_process` creates one `ServiceContext` per process, and the loop gets it
with each rig that is opened. In simulated time the same loop gets other clocks.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.links.pump import StopFlag
from gyrorig_daemon.live import NO_VIEW, LiveView
from gyrorig_daemon.service.housekeeping import Housekeeping
from gyrorig_daemon.service.job_queue import JobQueue
from gyrorig_daemon.service.persistent_state import PersistentState
from gyrorig_daemon.service.recording_policy import RecorderTotals
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_daemon.service.state_folder import StateFolder
from gyrorig_daemon.service.systemd_notifier import SystemdNotifier


@dataclass(slots=True)
class ServiceCounts:
    """Cumulative counters; docs/service.md explains each one."""

    sessions_done: int = 0
    sessions_failed: int = 0
    sessions_stopped: int = 0
    sessions_put_off: int = 0
    experiments_done: int = 0
    experiments_failed: int = 0
    motion_faults: int = 0
    unit_lost: int = 0
    unit_reopened: int = 0
    reloads: int = 0
    reloads_refused: int = 0
    acquisition_restarts: int = 0
    emulator_restarts: int = 0
    clock_steps: int = 0
    late_turns: int = 0
    log_lines_lost: int = 0
    state_write_failures: int = 0
    clients: int = 0
    clients_slow: int = 0
    clients_refused: int = 0
    requests: int = 0
    requests_refused: int = 0


@dataclass(slots=True)
class OperatorRequests:
    """Pending requests, set by the socket's thread and by signals, handled by the pump's thread."""

    stop: StopFlag = field(default_factory=StopFlag)
    terminate: threading.Event = field(default_factory=threading.Event)  # of the process
    reload: threading.Event = field(default_factory=threading.Event)
    clear: threading.Event = field(default_factory=threading.Event)

    def request_termination(self, reason: str) -> None:
        """Request a halt, the end of the recording and of the process: SIGTERM, SIGINT."""
        self.terminate.set()
        self.stop.request(reason)

    def request_halt(self, requester: str) -> None:
        """Request a halt and a motion lock; the service continues.

        A release that is requested later applies to this lock, an earlier one does not.
        """
        self.clear.clear()
        self.stop.request(f"an operator's halt ({requester})")

    def acknowledge_stop(self) -> bool:
        """Reset a stop that was carried out; return whether the process must end."""
        self.stop.reason = None
        if self.terminate.is_set():  # after the line above: a signal can come between any two
            self.stop.request("the end of the process")
            return True
        return False


@dataclass(frozen=True, slots=True)
class ServiceClocks:
    """The clocks that the loop reads, in addition to the pump's."""

    anchor: Callable[[], CaptureClock]  # for a new session
    read_host: Callable[[], HostClocks]
    monotonic_s: Callable[[], float]
    utc_s: Callable[[], float]


@dataclass(slots=True)
class ServiceContext:
    """The objects that outlive a rig."""

    state_folder: StateFolder
    queue: JobQueue
    schedule: Schedule
    persistent: PersistentState
    requests: OperatorRequests
    counts: ServiceCounts
    notifier: SystemdNotifier
    clocks: ServiceClocks
    host: str
    config_text: bytes
    read_program: Callable[[str], bytes]  # for the schedule: a path as in the rig's document
    reload_config: Callable[[], str]  # returns why it is invalid, "" if it is valid
    publish: Callable[[dict[str, Any]], None]
    stalled_loops: Callable[[], list[str]]  # outside the pump
    dropped_bytes: Callable[[], int]
    log: Callable[[str], None]
    housekeeping: Housekeeping
    reopen_reason: Callable[[], str] = lambda: ""  # why the rig must be opened again
    recorder_totals: RecorderTotals = field(default_factory=RecorderTotals)
    threaded_writer: bool = True
    view: LiveView = NO_VIEW
    seed: int = 0
