"""How recordings are cut and kept, as the rig's document says; what recorders counted.

What to use when: `recorder_settings` for a session's recorder, `retention_rules` for what may
be deleted; `Account` adds up what the recorders of a process counted.
"""

from collections import Counter
from dataclasses import replace

from gyrorig_daemon.config.service import ServiceSettings
from gyrorig_daemon.recorder import SERVICE, RecorderSettings
from gyrorig_daemon.recorder.retention import RetentionRules

MB = 1_000_000
HIGH_WATER = "high_water"  # counters whose name holds this are the largest so far, not a sum
MOMENTARY = ("memory_messages", "memory_bytes", "disk_busy_ms", "sync_last_ms", "free_bytes")


def recorder_settings(told: ServiceSettings) -> RecorderSettings:
    """Return how the sessions of a service are recorded."""
    return replace(
        SERVICE,
        part_s=told.part_s,
        part_bytes=told.part_mb * MB,
        reserve_bytes=told.reserve_mb * MB,
    )


def retention_rules(told: ServiceSettings) -> RetentionRules:
    """Return which recordings may be deleted."""
    return RetentionRules(
        max_days=told.keep_days,
        max_bytes=None if told.keep_mb is None else told.keep_mb * MB,
        room_bytes=recorder_settings(told).resume_bytes or None if told.delete_when_full else None,
    )


def is_sum(name: str) -> bool:
    """Return whether a recorder's counter only grows, over all recordings of a process."""
    return HIGH_WATER not in name and "_max_" not in name and name not in MOMENTARY


class Account:
    """What the recorders of a process have counted, the closed ones and the open one."""

    def __init__(self) -> None:
        self._closed: Counter[str] = Counter()

    def close(self, values: dict[str, int]) -> None:
        """Take over what a recorder counted, at its end."""
        self._closed = Counter(self.total(values))

    def total(self, values: dict[str, int] | None) -> dict[str, int]:
        """Return the counts of all recorders.

        Args:
            values: of the one that is open, None where none is.
        """
        if values is None:
            return {name: n for name, n in self._closed.items() if name not in MOMENTARY}
        found = {}
        for name, value in values.items():
            before = self._closed[name]
            if is_sum(name):
                found[name] = before + value
            else:
                found[name] = value if name in MOMENTARY else max(before, value)
        return found
