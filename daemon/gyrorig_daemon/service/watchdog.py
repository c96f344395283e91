"""The watchdog is fed only when every loop made progress.

What to use when: each loop has a `Pulse` and beats it at every turn; `WatchdogTimer` runs in
the pump, so that the pump's own turn is shown by its being fired at all. A loop that hangs
stops the feeding, and systemd ends and restarts the daemon, whose start halts the unit.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from gyrorig_daemon.service.notify import Notifier

FEEDS_PER_LIMIT = 4  # sd_watchdog_enabled(3) advises two; a stall of a second must not matter
WITHOUT_WATCHDOG_S = 1.0


@dataclass(slots=True)
class Pulse:
    """One loop's signs of life, on CLOCK_MONOTONIC in ns."""

    name: str
    limit_s: float  # so long may one turn take
    clock_ns: Callable[[], int] = time.monotonic_ns
    beat_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Begin alive."""
        self.beat()

    def beat(self) -> None:
        """Say that a turn is over."""
        self.beat_ns = self.clock_ns()

    @property
    def age_s(self) -> float:
        """How long the present turn has lasted."""
        return (self.clock_ns() - self.beat_ns) * 1e-9

    @property
    def hangs(self) -> bool:
        """True when the turn lasts longer than it may."""
        return self.age_s > self.limit_s


class WatchdogTimer:
    """Feeds systemd's watchdog from the pump while no loop hangs."""

    def __init__(
        self,
        notifier: Notifier,
        hanging: Callable[[], list[str]],
        now_ns: int,
        tell: Callable[[str], None],
    ) -> None:
        """Begin to feed.

        Args:
            notifier: where the watchdog is fed.
            hanging: the names of the loops that make no progress.
            now_ns: the pump's time.
            tell: told once when feeding stops, and why.
        """
        self._notifier = notifier
        self._hanging = hanging
        self._tell = tell
        limit_s = notifier.watchdog_s or WITHOUT_WATCHDOG_S * FEEDS_PER_LIMIT
        self._period_ns = int(limit_s / FEEDS_PER_LIMIT * 1e9)
        self._starves = False
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Feed, unless something hangs."""
        self.due_ns = now_ns + self._period_ns
        hanging = self._hanging()
        if not hanging:
            self._notifier.alive()
        elif not self._starves:
            self._tell(f"no progress in {', '.join(hanging)}: the watchdog is not fed")
        self._starves = bool(hanging)
