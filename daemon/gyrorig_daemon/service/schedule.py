"""When the sessions of the schedule are due, whatever the wall clock does.

What to use when: `Schedule.due` from the daemon's loop; `begun` when a session begins,
`put_off` when it could not begin after all: it is tried again after a while, a daily one as
long as it is not too late for the day.

Theory of operation. An entry that comes every so many hours is measured on the monotonic
clock; what passed before this start is taken from the wall clock, and only where that makes
sense. A daily entry is due when its time of day has come within the last `LATE_S`, unless it
was begun since then by the wall clock, or less than `APART_S` ago by the monotonic one: a
clock that is set back over the time does not begin it twice, and one that was years ahead
does not keep it from ever beginning again.
"""

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.config.service import ScheduleEntry
from gyrorig_daemon.service.files import write_whole

LATE_S = 3_600.0  # a rig that is switched on later than this leaves the day's session out
APART_S = 12 * 3_600.0
FIRST_WAIT_S = 30.0  # until a session that could not begin is tried again, then twice as long
LONGEST_WAIT_S = 600.0
DAY_S = 86_400.0
MAX_STATE_BYTES = 1_000_000


@dataclass(slots=True)
class _Begun:
    """When an entry was last begun."""

    utc_s: float | None = None
    monotonic_s: float | None = None
    before: tuple[float | None, float | None] = (None, None)  # the same, the time before
    tries: int = 0  # in vain, in a row
    not_before_s: float = 0.0  # monotonic
    is_put_off: bool = False


class Schedule:
    """The entries of one configuration, and when each was last begun."""

    def __init__(self, entries: Sequence[ScheduleEntry], state: Path, monotonic_s: float) -> None:
        """Begin with what an earlier daemon left in `state`.

        Args:
            entries: of the rig's document.
            state: where the times are kept; a file that is no such thing is replaced.
            monotonic_s: now.
        """
        self.entries = tuple(entries)
        self._state = state
        self._started_s = monotonic_s
        kept = _read(state)
        self._begun = {entry.name: _Begun(kept.get(entry.name)) for entry in entries}

    def due(self, monotonic_s: float, utc_s: float) -> ScheduleEntry | None:
        """Return the entry that has waited longest, None where none is due."""
        late = [
            (self._late_s(entry, monotonic_s, utc_s), entry)
            for entry in self.entries
            if monotonic_s >= self._begun[entry.name].not_before_s
        ]
        waiting = [pair for pair in late if pair[0] >= 0.0]
        return max(waiting, key=lambda pair: pair[0])[1] if waiting else None

    def next_s(self, entry: ScheduleEntry, monotonic_s: float, utc_s: float) -> float:
        """Return in how many seconds an entry is due, 0 where it is."""
        late_s = self._late_s(entry, monotonic_s, utc_s)
        return max(0.0, -late_s, self._begun[entry.name].not_before_s - monotonic_s)

    def begun(self, name: str, monotonic_s: float, utc_s: float) -> None:
        """Note that an entry's session begins now; the disk may refuse to remember it."""
        begun = self._begun[name]
        if not begun.is_put_off:
            begun.tries = 0
        begun.is_put_off = False
        begun.before = begun.utc_s, begun.monotonic_s
        begun.utc_s, begun.monotonic_s = utc_s, monotonic_s
        self._keep()

    def put_off(self, name: str, monotonic_s: float) -> float | None:
        """Note that the session could not begin after all.

        Returns:
            After how many seconds it is tried again, None where there is no such entry any more.
        """
        begun = self._begun.get(name)
        if begun is None:
            return None
        wait_s = min(FIRST_WAIT_S * 2.0 ** min(begun.tries, 10), LONGEST_WAIT_S)
        begun.tries += 1
        begun.is_put_off = True
        begun.utc_s, begun.monotonic_s = begun.before
        begun.not_before_s = monotonic_s + wait_s
        self._keep()
        return wait_s

    def _keep(self) -> None:
        kept = {key: value.utc_s for key, value in self._begun.items() if value.utc_s is not None}
        with contextlib.suppress(OSError):
            write_whole(self._state, json.dumps(kept).encode())

    def _late_s(self, entry: ScheduleEntry, monotonic_s: float, utc_s: float) -> float:
        """Return for how long an entry has been due; below 0, until then."""
        begun = self._begun[entry.name]
        if entry.every_h is not None:
            return self._since_s(begun, monotonic_s, utc_s, entry.every_h * 3_600.0)
        time_of_day_s = 60.0 * (entry.minute_of_day or 0)
        late_s = (utc_s - time_of_day_s) % DAY_S
        until_s = late_s - DAY_S
        if late_s > LATE_S:
            return until_s
        if begun.monotonic_s is not None and monotonic_s - begun.monotonic_s < APART_S:
            return until_s
        ahead = begun.utc_s is not None and begun.utc_s > utc_s  # the clock was set back since
        if begun.utc_s is not None and not ahead and begun.utc_s >= utc_s - late_s:
            return until_s
        if ahead and begun.utc_s is not None and begun.utc_s - utc_s < APART_S:
            return until_s
        return late_s

    def _since_s(self, begun: _Begun, monotonic_s: float, utc_s: float, every_s: float) -> float:
        if begun.monotonic_s is not None:
            return monotonic_s - begun.monotonic_s - every_s
        if begun.utc_s is None:
            return monotonic_s - self._started_s  # never before: at once
        # Begun in the future: that clock was wrong, or this one is.
        before_s = max(0.0, utc_s - (monotonic_s - self._started_s) - begun.utc_s)
        return before_s + monotonic_s - self._started_s - every_s


def _read(state: Path) -> dict[str, float]:
    try:
        with state.open("rb") as file:
            document = json.loads(file.read(MAX_STATE_BYTES))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(document, dict):
        return {}
    return {
        name: float(value)
        for name, value in document.items()
        if isinstance(name, str) and isinstance(value, int | float) and abs(value) < 1e11
    }
