"""Schedule of sessions: when each entry is due, independent of changes of the system time.

What to use when: `Schedule.due_entry` from the main loop. `record_start` when a session starts,
`postpone` when it could not start: it is tried again after a while, a daily session until it is
too late for the day.

Theory of operation. Intervals in hours are measured with the monotonic clock. The time before
this start is taken from the system time, and only if that is plausible. A daily entry is due if
its time of day was within the last `MAX_DELAY_S`, unless it was started since then by the system
time, or less than `MIN_INTERVAL_S` ago by the monotonic clock. Therefore a clock that is set back
does not start it twice, and a clock that was years ahead does not prevent later starts.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.config.service_settings import ScheduleEntry
from gyrorig_daemon.service.state_file import StateFile

MAX_DELAY_S = 3_600.0  # a rig that is switched on later than this skips the day's session
MIN_INTERVAL_S = 12 * 3_600.0
FIRST_RETRY_S = 30.0  # until a session that could not start is tried again; doubled each time
LONGEST_RETRY_S = 600.0
DAY_S = 86_400.0
MAX_SCHEDULE_FILE_BYTES = 1_000_000


@dataclass(slots=True)
class _LastStart:
    """When an entry was last started."""

    utc_s: float | None = None
    monotonic_s: float | None = None
    previous: tuple[float | None, float | None] = (None, None)  # the start before this one
    failed_attempts: int = 0  # consecutive
    not_before_s: float = 0.0  # monotonic
    is_put_off: bool = False


class Schedule:
    """The entries of one configuration, and when each was last started."""

    def __init__(
        self, entries: Sequence[ScheduleEntry], state_path: Path, monotonic_s: float
    ) -> None:
        """Load the start times that an earlier process has saved.

        Args:
            entries: of the rig's document.
            state_path: the file with the start times; an invalid file is replaced.
            monotonic_s: the present time.
        """
        self.entries = tuple(entries)
        self.file = StateFile(state_path)
        self._started_s = monotonic_s
        saved_times = _load_start_times(state_path)
        self._last_starts = {
            entry.name: _LastStart(saved_times.get(entry.name)) for entry in entries
        }

    def due_entry(self, monotonic_s: float, utc_s: float) -> ScheduleEntry | None:
        """Return the entry that is overdue for longest, None if none is due."""
        overdue = [
            (self._overdue_s(entry, monotonic_s, utc_s), entry)
            for entry in self.entries
            if monotonic_s >= self._last_starts[entry.name].not_before_s
        ]
        waiting = [pair for pair in overdue if pair[0] >= 0.0]
        return max(waiting, key=lambda pair: pair[0])[1] if waiting else None

    def seconds_until_due(self, entry: ScheduleEntry, monotonic_s: float, utc_s: float) -> float:
        """Return the time until an entry is due, 0 if it is due."""
        overdue_s = self._overdue_s(entry, monotonic_s, utc_s)
        return max(0.0, -overdue_s, self._last_starts[entry.name].not_before_s - monotonic_s)

    def record_start(self, name: str, monotonic_s: float, utc_s: float) -> None:
        """Record that the session of an entry starts now."""
        start = self._last_starts[name]
        if not start.is_put_off:
            start.failed_attempts = 0
        start.is_put_off = False
        start.previous = start.utc_s, start.monotonic_s
        start.utc_s, start.monotonic_s = utc_s, monotonic_s
        self._save()

    def postpone(self, name: str, monotonic_s: float) -> float | None:
        """Record that the session could not start.

        Returns:
            The time until the next attempt, None if the entry no longer exists.
        """
        start = self._last_starts.get(name)
        if start is None:
            return None
        wait_s = min(FIRST_RETRY_S * 2.0 ** min(start.failed_attempts, 10), LONGEST_RETRY_S)
        start.failed_attempts += 1
        start.is_put_off = True
        start.utc_s, start.monotonic_s = start.previous
        start.not_before_s = monotonic_s + wait_s
        self._save()
        return wait_s

    def _save(self) -> None:
        start_times = {
            key: value.utc_s for key, value in self._last_starts.items() if value.utc_s is not None
        }
        self.file.write(json.dumps(start_times).encode())

    def _overdue_s(self, entry: ScheduleEntry, monotonic_s: float, utc_s: float) -> float:
        """Return for how long an entry has been due; negative before it is due."""
        start = self._last_starts[entry.name]
        if entry.every_h is not None:
            return self._overdue_interval_s(start, monotonic_s, utc_s, entry.every_h * 3_600.0)
        time_of_day_s = 60.0 * (entry.minute_of_day or 0)
        overdue_s = (utc_s - time_of_day_s) % DAY_S
        negative_wait_s = overdue_s - DAY_S
        if overdue_s > MAX_DELAY_S:
            return negative_wait_s
        if start.monotonic_s is not None and monotonic_s - start.monotonic_s < MIN_INTERVAL_S:
            return negative_wait_s
        clock_was_set_back = (
            start.utc_s is not None and start.utc_s > utc_s
        )  # the clock was set back since
        if start.utc_s is not None and not clock_was_set_back and start.utc_s >= utc_s - overdue_s:
            return negative_wait_s
        if clock_was_set_back and start.utc_s is not None and start.utc_s - utc_s < MIN_INTERVAL_S:
            return negative_wait_s
        return overdue_s

    def _overdue_interval_s(
        self, start: _LastStart, monotonic_s: float, utc_s: float, interval_s: float
    ) -> float:
        if start.monotonic_s is not None:
            return monotonic_s - start.monotonic_s - interval_s
        if start.utc_s is None:
            return monotonic_s - self._started_s  # never started: due now
        # A start in the future: one of the two clock readings was wrong.
        elapsed_before_s = max(0.0, utc_s - (monotonic_s - self._started_s) - start.utc_s)
        return elapsed_before_s + monotonic_s - self._started_s - interval_s


def _load_start_times(path: Path) -> dict[str, float]:
    try:
        with path.open("rb") as file:
            document = json.loads(file.read(MAX_SCHEDULE_FILE_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(document, dict):
        return {}
    return {
        name: float(value)
        for name, value in document.items()
        if isinstance(name, str) and isinstance(value, int | float) and abs(value) < 1e11
    }
