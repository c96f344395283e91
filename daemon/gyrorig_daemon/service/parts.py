"""What the daemon's loop is made of, apart from the rig itself.

What to use when: `start` makes one `Parts` for a process; the loop gets it with each rig
that is opened. Under simulated time the same loop gets clocks of its own.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from gyrorig_daemon.links.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.live import NO_VIEW, View
from gyrorig_daemon.service.counts import ServiceCounts
from gyrorig_daemon.service.jobs import JobQueue
from gyrorig_daemon.service.keeper import Keeper
from gyrorig_daemon.service.keeping import Account
from gyrorig_daemon.service.memory import Memory
from gyrorig_daemon.service.notify import Notifier
from gyrorig_daemon.service.orders import Orders
from gyrorig_daemon.service.schedule import Schedule
from gyrorig_daemon.service.state import StateFolder


@dataclass(frozen=True, slots=True)
class Clocks:
    """The clocks that the loop reads besides the pump's."""

    anchor: Callable[[], CaptureClock]  # a new session's
    read_host: Callable[[], HostClocks]
    monotonic_s: Callable[[], float]
    utc_s: Callable[[], float]


@dataclass(slots=True)
class Parts:
    """Everything that outlives a rig."""

    state: StateFolder
    queue: JobQueue
    schedule: Schedule
    memory: Memory
    orders: Orders
    counts: ServiceCounts
    notifier: Notifier
    clocks: Clocks
    host: str
    config_text: bytes
    read_program: Callable[[str], bytes]  # of the schedule: a path as in the rig's document
    reread: Callable[[], str]  # the configuration; returns why it cannot be used, "" if it can
    publish: Callable[[dict[str, Any]], None]
    hanging: Callable[[], list[str]]  # loops outside the pump that make no progress
    dropped_bytes: Callable[[], int]
    log: Callable[[str], None]
    keeper: Keeper
    lost_rig: Callable[[], str] = lambda: ""  # why the rig has to be opened anew, if it has to
    account: Account = field(default_factory=Account)
    threaded_writer: bool = True
    view: View = NO_VIEW
    seed: int = 0
