"""Schedule of a part writer: when a sync, a check of the free space and the next part are due.

What to use when: under `part_writer`; `set_time` first in every turn. The methods `take_...` return
True once, when something is due, and count from then on.
"""

from gyrorig_daemon.recorder.recorder_settings import RecorderSettings

RETRY_NS = 5_000_000_000  # between attempts to open a part after a failure
SPACE_CHECK_NS = 1_000_000_000  # between checks of the free space


class PartSchedule:
    """Times of one session on any monotonic clock, all 0 before the first turn."""

    def __init__(self, settings: RecorderSettings) -> None:
        self._settings = settings
        self._now_ns = self._part_start_ns = self._last_sync_ns = self._last_space_check_ns = 0
        self._retry_ns = 0

    @property
    def may_open(self) -> bool:
        """True unless an attempt failed a short time ago."""
        return self._now_ns >= self._retry_ns

    def set_time(self, now_ns: int) -> None:
        """Set the present time."""
        if not self._now_ns:
            self._part_start_ns = self._last_sync_ns = now_ns
        self._now_ns = now_ns

    def start_part(self) -> None:
        """Count the time of a part, and of its first sync, from now on."""
        self._part_start_ns = self._last_sync_ns = self._now_ns

    def postpone_opening(self) -> None:
        """Wait before the next attempt to open a part."""
        self._retry_ns = self._now_ns + RETRY_NS

    def take_sync(self) -> bool:
        """Return whether a sync is due."""
        is_due = self._has_elapsed(self._last_sync_ns, self._settings.sync_s)
        if is_due:
            self._last_sync_ns = self._now_ns
        return is_due

    def take_space_check(self) -> bool:
        """Return whether a check of the free space is due; never without a reserve."""
        elapsed_ns = self._now_ns - self._last_space_check_ns
        is_due = bool(self._settings.reserve_bytes) and elapsed_ns >= SPACE_CHECK_NS
        if is_due:
            self._last_space_check_ns = self._now_ns
        return is_due

    def is_part_due(self, bytes_written: int, is_empty: bool) -> bool:
        """Return whether the next part is due, by the time or the size of this one.

        A part without messages goes on: its time begins again.
        """
        part_s, part_bytes = self._settings.part_s, self._settings.part_bytes
        is_old = part_s is not None and self._has_elapsed(self._part_start_ns, part_s)
        if is_empty and is_old:
            self.start_part()
            return False
        return is_old or (part_bytes is not None and bytes_written >= part_bytes)

    def _has_elapsed(self, since_ns: int, limit_s: float) -> bool:
        return self._now_ns - since_ns >= limit_s * 1e9
