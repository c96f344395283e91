"""Watchdog: it is fed only while every loop makes progress.

What to use when: each loop has a `Heartbeat` and beats it in every cycle. `WatchdogTimer` runs
in the pump, so that its own calls show the pump's progress. If a loop hangs, the watchdog is not
fed, and systemd ends and restarts the service, whose start halts the unit.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from gyrorig_daemon.service.systemd_notifier import SystemdNotifier

FEEDS_PER_LIMIT = 4  # sd_watchdog_enabled(3) recommends two; a stall of one second must not matter
PERIOD_WITHOUT_WATCHDOG_S = 1.0


@dataclass(slots=True)
class Heartbeat:
    """Heartbeat of one loop, on CLOCK_MONOTONIC in ns."""

    name: str
    stall_limit_s: float  # longest permitted cycle
    clock_ns: Callable[[], int] = time.monotonic_ns
    last_beat_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Start with a beat."""
        self.beat()

    def beat(self) -> None:
        """Record the end of a cycle."""
        self.last_beat_ns = self.clock_ns()

    @property
    def age_s(self) -> float:
        """Duration of the present cycle."""
        return (self.clock_ns() - self.last_beat_ns) * 1e-9

    @property
    def is_stalled(self) -> bool:
        """True if the present cycle exceeds the limit."""
        return self.age_s > self.stall_limit_s


class WatchdogTimer:
    """Feeds systemd's watchdog from the pump while no loop is stalled."""

    def __init__(
        self,
        notifier: SystemdNotifier,
        stalled_loops: Callable[[], list[str]],
        now_ns: int,
        log: Callable[[str], None],
    ) -> None:
        """Start to feed.

        Args:
            notifier: receives the watchdog messages.
            stalled_loops: returns the names of the loops that make no progress.
            now_ns: the pump's time.
            log: called once, with the reason, when feeding stops.
        """
        self._notifier = notifier
        self._stalled_loops = stalled_loops
        self._log = log
        limit_s = notifier.watchdog_s or PERIOD_WITHOUT_WATCHDOG_S * FEEDS_PER_LIMIT
        self._period_ns = int(limit_s / FEEDS_PER_LIMIT * 1e9)
        self._is_withheld = False
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Feed, unless a loop is stalled."""
        self.due_ns = now_ns + self._period_ns
        stalled = self._stalled_loops()
        if not stalled:
            self._notifier.feed_watchdog()
        elif not self._is_withheld:
            self._log(
                f"The daemon makes no progress in {', '.join(stalled)}, so it sends no "
                "keep-alive message to systemd."
            )
        self._is_withheld = bool(stalled)
