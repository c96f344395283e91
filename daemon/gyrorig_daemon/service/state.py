"""The daemon's own folder: one daemon at a time, and where things are in it.

    lock               held while a daemon runs
    recordings/        what was recorded; unfinished files end in .part
    queue/             jobs: a file dropped here is carried out (see `jobs`)
    metrics/           gyrorig.prom, for a Prometheus node exporter, unless told otherwise
    schedule.json      when each entry of the schedule was last begun
    rig.json           a hold on all motion, and doubt about the unit's steps

What to use when: `StateFolder` first of all; whoever does not get the lock ends.
"""

import fcntl
import os
from pathlib import Path
from types import TracebackType

from gyrorig_protocol.errors import BusyError, MachineError

DEFAULT = Path("/var/lib/gyrorig")  # where the service's StateDirectory= is
FOLDERS = ("recordings", "queue", "metrics")


class StateFolder:
    """The folder of one daemon. Use it as a context: the lock is held in it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.recordings, self.queue, self.metrics = (root / name for name in FOLDERS)
        self.schedule = root / "schedule.json"
        self.memory = root / "rig.json"
        self._lock: int | None = None

    def __enter__(self) -> "StateFolder":
        """Take the lock and make the folders.

        Raises:
            BusyError: another daemon holds it.
            MachineError: the folder cannot be used.
        """
        lock = self.root / "lock"
        try:
            for folder in (self.root, self.recordings, self.queue):
                folder.mkdir(parents=True, exist_ok=True)
            self._lock = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(self._lock, 0)
            os.write(self._lock, f"{os.getpid()}\n".encode())
        except BlockingIOError as fault:
            holder = self._release_and_read(lock)
            raise BusyError(
                f"another daemon uses {self.root}{holder}", "end that one, or give another --state"
            ) from fault
        except OSError as fault:
            raise MachineError(
                f"{fault.filename or self.root} cannot be used: {fault.strerror}",
                "name another folder with --state",
            ) from fault
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let go of the lock."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def free_bytes(self) -> int | None:
        """Return how much room recordings have, None where the system does not say."""
        try:
            there = os.statvfs(self.recordings)
        except OSError:
            return None
        return there.f_bavail * there.f_frsize

    def _release_and_read(self, lock: Path) -> str:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
        try:
            pid = lock.read_text(encoding="ascii").strip()
        except (OSError, ValueError):
            return ""
        return f" (process {pid})" if pid.isdecimal() else ""
