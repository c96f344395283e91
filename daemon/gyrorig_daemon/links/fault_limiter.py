"""Fault limiter: a device that repeats a fault cannot fill the recording with it.

What to use when: in the link to a board or a bus, for each fault that its data can cause.
"""

from collections import Counter
from collections.abc import Callable

FAULT_REPEAT_NS = 60_000_000_000  # the same fault is recorded again after a minute


class FaultLimiter:
    """Records the faults of one device, but each cause at most once per minute."""

    def __init__(self, record: Callable[[str], None]) -> None:
        self._record = record
        self._last_ns: dict[str, int] = {}  # by cause
        self._omitted_counts: Counter[str] = Counter()  # since the last record, by cause

    def report(self, cause: str, now_ns: int, text: str) -> None:
        """Record a fault, with the number of those of its cause that were not recorded."""
        last_ns = self._last_ns.get(cause)
        if last_ns is not None and now_ns - last_ns <= FAULT_REPEAT_NS:
            self._omitted_counts[cause] += 1
            return
        self._last_ns[cause] = now_ns
        omitted_count = self._omitted_counts.pop(cause, 0)
        if omitted_count:
            text += f" ({omitted_count} more since the last report of this fault)"
        self._record(text)
