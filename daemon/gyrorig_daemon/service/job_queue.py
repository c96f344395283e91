"""Job queue: a folder with one file per session that waits to run.

    queue/NAME.yaml                      waits; the first name in alphabetical order is next
    queue/running/NAME.yaml              is running
    queue/done/NAME.yaml, .result.json   has finished
    queue/failed/NAME.yaml, .result.json did not finish; the result contains the reason

A job is a document `gyrorig/job/1`, or a `gyrorig/program/1` without further settings. It must
appear in the folder in one step: written under another name and renamed, or moved from the
same disk. Names that begin with a dot are ignored.

What to use when: `JobQueue` to take jobs; `jobs.enqueue_job` adds them. A job that was running
when the service crashed is not started again, because it may be the cause of the crash.

Members of the daemon's group write to `queue/`, so nothing in it is trusted. `JobQueue` opens each
folder once, without following links, and then names every file relative to the opened folder. A
folder that a member has exchanged for a link is refused at the start and has no effect later.
"""

import contextlib
import errno
import itertools
import json
import os
import secrets
import stat
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.jobs import MAX_JOB_BYTES, SessionJob, parse_job
from gyrorig_daemon.service.state_folder import tolerate_unwritable_disk
from gyrorig_protocol.atomic_files import lock_temporary
from gyrorig_protocol.errors import GyrorigError, MachineError, UsageError

INTERRUPTED = (
    "The daemon ended while the job was running. Check the rig and the log, then enqueue "
    "the job again."
)
MAX_KEPT_RESULTS = 1_000  # in done/ and in failed/ each
MAX_KEPT_STEM = 200  # characters of the name of a job that gets a new name
MAX_TEMPORARY_STEM = 40  # characters
MAX_JOBS = 4_096  # waiting jobs; the others are seen when these are gone
MAX_SCANNED = 100_000  # entries of the folder; reading them takes 0.1 s
MAX_REJECTED_AT_ONCE = 16  # files of one call; the event loop waits for it
MAX_REJECTION_S = 0.5  # no further file is read in the same call after this time
MTIME_STEP_NS = 100_000_000  # two changes of a folder within this time can have one mtime
FOLDER_MODE = 0o3770  # the daemon's group can add jobs; sticky: each member removes only its own
OWN_FOLDER_MODE = 0o750
FOLDERS = ("running", "done", "failed")
RESULT_MODE = 0o640
RESULT_SUFFIX = ".result.json"


class JobQueue:
    """The queue as the service uses it; the content of a file never raises an exception here."""

    def __init__(self, folder: Path) -> None:
        """Create missing folders, and move jobs that were running to `failed`.

        Raises:
            MachineError: the folders cannot be created, or another user has exchanged one.
        """
        self._folder = folder
        self.rejected_count = 0
        self._unmovable: set[str] = set()  # files that cannot be taken out of the folder
        self._names: list[str] = []
        self._names_mtime_ns = -1
        try:
            with tolerate_unwritable_disk():
                folder.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(PermissionError), tolerate_unwritable_disk():
                folder.chmod(FOLDER_MODE)  # unless another user owns the folder
            self._inbox_fd = os.open(folder, _FOLDER_FLAGS)
            self._fds = {name: self._open_own_folder(name) for name in FOLDERS}
        except OSError as error:
            raise MachineError(
                f"the folder {folder} cannot be used for the queue ({error.strerror})",
                "choose another folder with --state",
            ) from error
        for name in _names(self._fds["running"], ".yaml"):
            self._archive(self._folder / "running" / name, "failed", {"reason": INTERRUPTED})

    def waiting_jobs(self) -> list[str]:
        """Return the names of the waiting jobs, the next one first; at most `MAX_JOBS`."""
        return [name.removesuffix(".yaml") for name in self._waiting_names()]

    def take_next(self) -> SessionJob | None:
        """Take the next job, which is running from now on; None if no job waits.

        A file that is not a valid job is moved to `failed`, and the next one is read, unless
        there are many of them.
        """
        rejected_before, end_s = self.rejected_count, time.monotonic() + MAX_REJECTION_S
        for name in self._waiting_names():
            rejected = self.rejected_count - rejected_before
            if rejected >= MAX_REJECTED_AT_ONCE or (rejected and time.monotonic() > end_s):
                break
            running = self._folder / "running" / name
            try:
                self._move(name, self._inbox_fd, "running")
            except FileNotFoundError:
                continue  # withdrawn since the folder was read
            except OSError as error:
                self._reject_unreadable(running, error)
                continue
            try:
                text = _read_regular(name, self._fds["running"])
                return parse_job(text, name, running)
            except GyrorigError as error:
                self._reject(running, str(error))
            except (OSError, ValueError) as error:
                self._reject_unreadable(running, error)
        return None

    def finish(self, job: SessionJob, succeeded: bool, result: Mapping[str, Any]) -> None:
        """Move a job to `done` or `failed`, with its result."""
        if job.path is not None:
            self._archive(job.path, "done" if succeeded else "failed", result)

    def requeue(self, job: SessionJob) -> None:
        """Put a job back that was not started; it gets a new name if its old one is in use."""
        if job.path is not None:
            name = job.path.name
            with contextlib.suppress(FileNotFoundError):
                os.stat(name, dir_fd=self._inbox_fd, follow_symlinks=False)
                name = f"{job.path.stem[:MAX_KEPT_STEM]}-{secrets.token_hex(2)}{job.path.suffix}"
            with contextlib.suppress(OSError):
                os.rename(
                    job.path.name,
                    name,
                    src_dir_fd=self._fds["running"],
                    dst_dir_fd=self._inbox_fd,
                )

    def close(self) -> None:
        """Close the folders."""
        for descriptor in (self._inbox_fd, *self._fds.values()):
            os.close(descriptor)

    def _open_own_folder(self, name: str) -> int:
        """Open a folder of the daemon's in the queue, without following a link.

        Raises:
            OSError: it cannot be opened.
            MachineError: it is not the daemon's.
        """
        with contextlib.suppress(FileExistsError), tolerate_unwritable_disk():
            os.mkdir(name, OWN_FOLDER_MODE, dir_fd=self._inbox_fd)
        try:
            descriptor = os.open(name, _FOLDER_FLAGS, dir_fd=self._inbox_fd)
        except (NotADirectoryError, OSError) as error:
            if error.errno not in (errno.ELOOP, errno.ENOTDIR):
                raise
            raise self._foreign_folder_error(name) from error
        status, owner = os.fstat(descriptor), os.fstat(self._inbox_fd).st_uid
        if status.st_uid not in (os.geteuid(), owner):
            os.close(descriptor)
            raise self._foreign_folder_error(name)
        if status.st_mode & 0o022:  # others could exchange its files
            with contextlib.suppress(PermissionError), tolerate_unwritable_disk():
                os.fchmod(descriptor, stat.S_IMODE(status.st_mode) & ~0o022)
        return descriptor

    def _foreign_folder_error(self, name: str) -> MachineError:
        return MachineError(
            f"{self._folder / name} is not a folder of the daemon",
            "find out which user has put it there. Then remove it, and start the daemon again",
        )

    def _waiting_names(self) -> list[str]:
        """Return the waiting files in order; the folder is read only if it has changed."""
        mtime_ns = os.fstat(self._inbox_fd).st_mtime_ns
        if mtime_ns != self._names_mtime_ns:
            names = _names(self._inbox_fd, ".yaml")
            is_settled = time.time_ns() - mtime_ns > MTIME_STEP_NS
            self._names, self._names_mtime_ns = names, mtime_ns if is_settled else -1
        return [name for name in self._names if name not in self._unmovable]

    def _move(self, name: str, source_fd: int, target: str) -> None:
        try:
            os.rename(name, name, src_dir_fd=source_fd, dst_dir_fd=self._fds[target])
        except FileNotFoundError:
            raise
        except OSError:
            if len(self._unmovable) < MAX_JOBS:
                self._unmovable.add(name)  # such as the folder of another user
            raise

    def _reject(self, path: Path, reason: str) -> None:
        self.rejected_count += 1
        self._archive(path, "failed", {"reason": reason}, durable=False)

    def _reject_unreadable(self, path: Path, error: Exception) -> None:
        error_text = getattr(error, "strerror", None) or error
        self._reject(
            path,
            f"The file of the job cannot be read ({error_text}). Give the group of the daemon "
            "permission to read the file, and enqueue the job again.",
        )

    def _archive(
        self, path: Path, outcome: str, result: Mapping[str, Any], durable: bool = True
    ) -> None:
        target = self._fds[outcome]
        document = {"schema": "gyrorig/job-result/1", "job": path.stem, "result": outcome, **result}
        with contextlib.suppress(OSError):  # on a full disk the job is moved at least
            _write_in(target, f"{path.stem}{RESULT_SUFFIX}", json.dumps(document).encode(), durable)
        with contextlib.suppress(OSError):
            os.rename(path.name, path.name, src_dir_fd=self._fds["running"], dst_dir_fd=target)
        results = {name.removesuffix(RESULT_SUFFIX) for name in _names(target, RESULT_SUFFIX)}
        stems = sorted(results | {Path(name).stem for name in _names(target, ".yaml")})
        for stem in stems[: max(0, len(stems) - MAX_KEPT_RESULTS)]:
            for name in (f"{stem}.yaml", f"{stem}{RESULT_SUFFIX}"):
                with contextlib.suppress(OSError):  # a rejected job can have one of both only
                    os.unlink(name, dir_fd=target)


_FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def _names(folder_fd: int, suffix: str) -> list[str]:
    """Return at most `MAX_JOBS` names that end so, in alphabetical order."""
    try:
        with os.scandir(folder_fd) as entries:
            names = (entry.name for entry in itertools.islice(entries, MAX_SCANNED))
            wanted = (n for n in names if n.endswith(suffix) and not n.startswith("."))
            return sorted(itertools.islice(wanted, MAX_JOBS))
    except OSError:
        return []


def _write_in(folder_fd: int, name: str, data: bytes, durable: bool) -> None:
    """Write a file of an opened folder in one step; no link in the folder is followed."""
    # `remove_leftovers` recognises it; the name of a file has at most 255 bytes.
    temporary = f".{name[-MAX_TEMPORARY_STEM:]}.{secrets.token_hex(4)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(temporary, flags, RESULT_MODE, dir_fd=folder_fd)
    try:
        with os.fdopen(descriptor, "wb") as file:
            lock_temporary(file.fileno())
            file.write(data)
            file.flush()
            if durable:
                os.fsync(file.fileno())
            os.rename(temporary, name, src_dir_fd=folder_fd, dst_dir_fd=folder_fd)
    except OSError:
        os.unlink(temporary, dir_fd=folder_fd)
        raise
    if durable:
        os.fsync(folder_fd)


def _read_regular(name: str, folder_fd: int) -> bytes:
    """Return the bytes of a regular file; pipes, devices, links and large files are rejected.

    Raises:
        UsageError: the file is one of these.
        OSError: the file cannot be read.
    """
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    descriptor = os.open(name, flags, dir_fd=folder_fd)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise UsageError(
                f"the job {name} in the queue is not a regular file",
                "remove the file, and add a motion program with `gyrorigd enqueue`",
            )
        if status.st_size > MAX_JOB_BYTES:
            raise UsageError(
                f"the job {name} in the queue has {status.st_size} bytes, and the daemon takes at "
                f"most {MAX_JOB_BYTES}",
                "write repeated steps with `repeat`, or divide the program into several jobs",
            )
        data = bytearray()
        while chunk := os.read(descriptor, MAX_JOB_BYTES + 1 - len(data)):
            data += chunk
        return bytes(data)
    finally:
        os.close(descriptor)
