"""What has been written to a file, and would be gone with the disk.

What to use when: under `spool`. A disk that turns read-only keeps what was synced, and
nothing of what the system still had in memory; so that is kept here until it is synced.
"""

from collections import deque

from gyrorig_daemon.recorder.ring import Record

LIMIT = 65_536  # five seconds of 16 boards at 800 Hz; of a slower disk, the newest


class Unsynced:
    """The messages given to one file, from the last sync on."""

    def __init__(self) -> None:
        self._records: deque[Record] = deque(maxlen=LIMIT)
        self.count = 0  # of all messages given to the file

    def add(self, record: Record) -> None:
        """One more message is given to the file."""
        self._records.append(record)
        self.count += 1

    def withdraw(self) -> None:
        """The last message was none."""
        self._records.pop()
        self.count -= 1

    def synced(self, count: int) -> None:
        """The first `count` messages of the file are on the disk."""
        records = self._records
        while records and self.count - len(records) < count:
            records.popleft()

    def behind(self, count: int) -> deque[Record]:
        """The messages behind the first `count`, as far as they are known."""
        unknown = self.count - len(self._records)
        return deque(list(self._records)[max(count - unknown, 0) :])
