"""State folder of the service: its lock, and the paths in it.

    lock               held while the service runs
    recordings/        recordings; unfinished files end in .part
    queue/             jobs (see `job_queue`)
    experiments/       one folder per experiment, with the findings of each round
    metrics/           gyrorig.prom for a Prometheus node exporter, unless configured otherwise
    schedule.json      when each entry of the schedule last started
    retention.json     what the last check of old recordings saw (see `retention_memory`)
    rig.json           the motion lock, and whether the step count is reliable

What to use when: open the `StateFolder` first. A process that does not get the lock must end. A
full or read-only disk is no reason to end, because the unit must be halted: the main loop then
waits for the disk.
"""

import contextlib
import errno
import fcntl
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from gyrorig_protocol.errors import BusyError, MachineError

DEFAULT_STATE_FOLDER = Path("/var/lib/gyrorig")  # StateDirectory= of the systemd unit
UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)  # codes of a full or read-only disk
SUBFOLDERS = ("recordings", "queue", "experiments", "metrics")


def is_in_use(root: Path) -> bool:
    """Return whether a service uses this state folder; True if that cannot be determined."""
    try:
        pid = int((root / "lock").read_text(encoding="ascii"))
        os.kill(pid, 0)
    except (FileNotFoundError, NotADirectoryError, ProcessLookupError):
        return False
    except (OSError, ValueError, OverflowError):
        return True
    return True


def apply_umask(mode: int) -> int:
    """Return the permissions of a new file under the umask of this process."""
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    match = re.search(r"^Umask:\s*([0-7]+)", status, re.MULTILINE)
    return mode & ~int(match[1], 8) if match else mode


@contextlib.contextmanager
def tolerate_unwritable_disk() -> Iterator[None]:
    """Ignore the errors of a full or read-only disk."""
    try:
        yield
    except OSError as error:
        if error.errno not in UNWRITABLE:
            raise


class StateFolder:
    """The folder of one service; a context manager that holds the lock."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.recordings, self.queue, self.experiments, self.metrics = (
            root / name for name in SUBFOLDERS
        )
        self.schedule = root / "schedule.json"
        self.persistent_state = root / "rig.json"
        self.retention_memory = root / "retention.json"
        self._lock: int | None = None

    def __enter__(self) -> "StateFolder":
        """Take the lock and create the folders.

        Raises:
            BusyError: another process holds the lock.
            MachineError: the folder cannot be used.
        """
        lock_path = self.root / "lock"
        try:
            for folder in (self.root, self.recordings, self.queue):
                with tolerate_unwritable_disk():
                    folder.mkdir(parents=True, exist_ok=True)
            self._lock, is_writable = _open_lock(lock_path)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if is_writable:
                with tolerate_unwritable_disk():  # the number only informs people and `is_in_use`
                    os.ftruncate(self._lock, 0)
                    os.write(self._lock, f"{os.getpid()}\n".encode())
        except BlockingIOError as error:
            holder = self._release_and_read_holder(lock_path)
            raise BusyError(
                f"another daemon uses the state folder {self.root}{holder}",
                "end the other daemon, or choose another folder with --state",
            ) from error
        except OSError as error:
            raise MachineError(
                f"the state folder {error.filename or self.root} cannot be used ({error.strerror})",
                "choose another folder with --state",
            ) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Release the lock."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def free_bytes(self) -> int | None:
        """Return the free disk space for recordings, None if the system does not report it."""
        try:
            file_system = os.statvfs(self.recordings)
        except OSError:
            return None
        return file_system.f_bavail * file_system.f_frsize

    def _release_and_read_holder(self, lock_path: Path) -> str:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
        try:
            pid = lock_path.read_text(encoding="ascii").strip()
        except (OSError, ValueError):
            return ""
        return f" (process {pid})" if pid.isdecimal() else ""


def _open_lock(path: Path) -> tuple[int, bool]:
    """Open the lock file, or its folder if the disk cannot hold the file; tell if it is writable.

    Raises:
        OSError: neither can be opened.
    """
    flags = os.O_NOFOLLOW | os.O_CLOEXEC
    with tolerate_unwritable_disk():
        return os.open(path, flags | os.O_RDWR | os.O_CREAT, 0o640), True
    with contextlib.suppress(FileNotFoundError):
        return os.open(path, flags | os.O_RDONLY), False
    return os.open(path.parent, flags | os.O_RDONLY | os.O_DIRECTORY), False
