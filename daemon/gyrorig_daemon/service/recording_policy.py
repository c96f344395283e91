"""Recorder settings and retention rules from the rig's document, and totals over recorders.

What to use when: `recorder_settings` for the recorder of a session, `retention_rules` for what
can be deleted. `RecorderTotals` sums the counters of all recorders of a process.
"""

from collections import Counter
from dataclasses import replace

from gyrorig_daemon.config.service_settings import ServiceSettings
from gyrorig_daemon.recorder import SERVICE, RecorderSettings
from gyrorig_daemon.recorder.retention import RetentionRules

MB = 1_000_000
HIGH_WATER_MARK = "high_water"  # counters with this in their name are maxima, not sums
GAUGES = ("memory_messages", "memory_bytes", "disk_busy_ms", "sync_last_ms", "free_bytes")


def recorder_settings(settings: ServiceSettings) -> RecorderSettings:
    """Return the recorder settings for the sessions of the service."""
    return replace(
        SERVICE,
        part_s=settings.part_s,
        part_bytes=settings.part_mb * MB,
        reserve_bytes=settings.reserve_mb * MB,
    )


def retention_rules(settings: ServiceSettings) -> RetentionRules:
    """Return the rules by which recordings can be deleted."""
    return RetentionRules(
        max_days=settings.keep_days,
        max_bytes=None if settings.keep_mb is None else settings.keep_mb * MB,
        room_bytes=recorder_settings(settings).resume_bytes or None
        if settings.delete_when_full
        else None,
    )


def is_cumulative(name: str) -> bool:
    """Return whether a recorder's counter is cumulative over all recordings of a process."""
    return HIGH_WATER_MARK not in name and "_max_" not in name and name not in GAUGES


class RecorderTotals:
    """Counters of all recorders of a process, the closed ones and the open one."""

    def __init__(self) -> None:
        self._closed: Counter[str] = Counter()

    def add_closed(self, values: dict[str, int]) -> None:
        """Add the final counters of a recorder."""
        self._closed = Counter(self.total(values))

    def total(self, values: dict[str, int] | None) -> dict[str, int]:
        """Return the counters of all recorders.

        Args:
            values: counters of the open recorder, None if there is none.
        """
        if values is None:
            return {name: n for name, n in self._closed.items() if name not in GAUGES}
        totals = {}
        for name, value in values.items():
            earlier = self._closed[name]
            if is_cumulative(name):
                totals[name] = earlier + value
            else:
                totals[name] = value if name in GAUGES else max(earlier, value)
        return totals
