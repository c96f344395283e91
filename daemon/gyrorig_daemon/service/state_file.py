"""A small file of the state folder that is written again until the disk accepts it.

What to use when: one `StateFile` per file whose content must survive a restart. `write` replaces
the content. `write_pending` from a timer repeats a write that failed, for example because the disk
was full for a moment.
"""

from pathlib import Path

from gyrorig_protocol.atomic_files import write_atomically

STATE_FILE_MODE = 0o640


class StateFile:
    """A file and its newest content that is not on the disk yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._pending: bytes | None = None
        self._failures = 0

    def write(self, content: bytes) -> None:
        """Replace the content; a disk that refuses it is tolerated."""
        self._pending = content
        self.write_pending()

    def write_pending(self) -> None:
        """Write the content that the disk has not accepted yet, if there is one."""
        if self._pending is None:
            return
        try:
            write_atomically(self._path, self._pending, mode=STATE_FILE_MODE)
        except OSError:
            self._failures += 1
        else:
            self._pending = None

    def take_failures(self) -> int:
        """Return the number of attempts that have failed since the last call."""
        failures, self._failures = self._failures, 0
        return failures
