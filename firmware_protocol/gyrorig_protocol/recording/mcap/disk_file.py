"""Disk interface of the writer: a new file that can be truncated, and operations on names.

What to use when: in `writer`, and in code that moves recordings. `Disk` is the interface that tests
replace by a disk that fails or loses data; `DISK` is the real one. A `DiskFile` writes without a
buffer, so that its position is exact after an error. It never opens an existing file. It holds a
lock that shows other processes that the file is being written; the system releases the lock when
the process ends for any reason.
"""

import fcntl
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FOLDER_LOCK_S = 2.0


class DiskFile:
    """A new, unbuffered file.

    Another thread can call `sync` at the same time.

    Raises:
        FileExistsError: the path exists already.
        OSError: from every method, as the system reports it.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:  # `list_abandoned_files` never sees the file without its lock
            _take_lock_soon(folder, fcntl.LOCK_SH)
            self._descriptor = os.open(path, flags, 0o644)
            _take_lock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(folder)
        self._position = 0

    def write(self, data: bytes) -> int:
        """Write all of `data`; a full disk writes a part of it, then raises an error."""
        remaining = memoryview(data)
        while remaining:
            written = os.write(self._descriptor, remaining)
            self._position += written
            remaining = remaining[written:]
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._position

    def sync(self) -> None:
        """Wait until the bytes are on the disk (fdatasync)."""
        os.fdatasync(self._descriptor)

    def cut(self, length: int) -> None:
        """Truncate the file to its first `length` bytes."""
        os.ftruncate(self._descriptor, length)
        os.lseek(self._descriptor, length, os.SEEK_SET)
        self._position = length

    def close(self) -> None:
        """Close the descriptor once; later calls do nothing, because its number can be reused."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            os.close(descriptor)


class Disk:
    """Operations on names; every method raises OSError as the system reports it."""

    def create(self, path: Path) -> DiskFile:
        """Create a new, empty file; raises FileExistsError if the name exists."""
        return DiskFile(path)

    def exists(self, path: Path) -> bool:
        """Return whether the name exists."""
        return path.exists()

    def rename(self, old: Path, new: Path) -> None:
        """Rename a file; no other process may create the new name."""
        old.rename(new)

    def unlink(self, path: Path) -> None:
        """Delete a name."""
        path.unlink()

    def sync_directory(self, folder: Path) -> None:
        """Make created, renamed and deleted names in `folder` survive a power cut."""
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def free_bytes(self, folder: Path) -> int:
        """Return the number of bytes that this process can still write there."""
        status = os.statvfs(folder)
        return status.f_bavail * status.f_frsize


DISK = Disk()


def is_being_written(path: Path) -> bool:
    """Return whether a running process holds the lock of a `DiskFile`.

    Raises:
        OSError: the file cannot be opened.
    """
    try:
        with hold_lock(path) as is_free:
            return not is_free
    except FileNotFoundError:  # another process has just renamed it
        return True


def list_abandoned_files(folder: Path, pattern: str) -> list[Path]:
    """Return the matching files that no running process writes, sorted by name.

    Raises:
        OSError: the folder cannot be read.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        # With the lock, no process is between creating a file and locking it. Without it, a file
        # that is old enough has its own lock.
        newest_s = math.inf
        if not _take_lock_soon(descriptor, fcntl.LOCK_EX):
            newest_s = time.time() - FOLDER_LOCK_S
        return sorted(
            path
            for path in folder.glob(pattern)
            if not is_being_written(path) and path.stat().st_mtime < newest_s
        )
    finally:
        os.close(descriptor)


@contextmanager
def hold_lock(path: Path) -> Iterator[bool]:
    """Hold a file's lock during the block; yields False if another process holds it.

    Raises:
        OSError: the file cannot be opened.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        yield _take_lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.close(descriptor)


def _take_lock_soon(descriptor: int, kind: int) -> bool:
    """Lock a folder, or return False after a while.

    Our programs hold it for milliseconds. Everybody who can read the folder could hold it for ever.
    """
    end_s = time.monotonic() + FOLDER_LOCK_S
    while not (is_locked := _take_lock(descriptor, kind | fcntl.LOCK_NB)):
        if time.monotonic() >= end_s:
            break
        time.sleep(0.01)
    return is_locked


def _take_lock(descriptor: int, kind: int) -> bool:
    """Lock; return False if another process holds it. Some network file systems lack locks."""
    try:
        fcntl.flock(descriptor, kind)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
