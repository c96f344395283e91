"""The file system as a recording needs it, and a new file that can be cut back.

What to use when: only under `writer` and whoever moves recordings about. `Disk` is the
seam at which tests put a disk that fails or forgets; there is one real one, `DISK`. A
`DiskFile` writes without a buffer of its own, so after an error its position is the
truth; it never opens a file that exists, and holds a lock by which others see that the
file is being written: the system drops it with the process, however that ends.
"""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class DiskFile:
    """A new file on a bare descriptor.

    `sync` may be called by another thread meanwhile.

    Raises:
        FileExistsError: the path exists already.
        OSError: from every method, as the system reports it.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:  # whoever lists what is abandoned never sees the file without its lock
            _lock(folder, fcntl.LOCK_SH)
            self._handle = os.open(path, flags, 0o644)
            _lock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        finally:
            os.close(folder)
        self._position = 0

    def write(self, data: bytes) -> int:
        """Write all of `data`; a full disk first writes short, then raises."""
        rest = memoryview(data)
        while rest:
            written = os.write(self._handle, rest)
            self._position += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self._position

    def sync(self) -> None:
        """Wait until the bytes are on the disk."""
        os.fdatasync(self._handle)

    def cut(self, length: int) -> None:
        """Drop everything behind the first `length` bytes."""
        os.ftruncate(self._handle, length)
        os.lseek(self._handle, length, os.SEEK_SET)
        self._position = length

    def close(self) -> None:
        """Close the descriptor, once: its number may be another file's by the next call."""
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)


class Disk:
    """What happens to names; every method raises OSError as the system reports it."""

    def create(self, path: Path) -> DiskFile:
        """A new, empty file; FileExistsError where the name is taken."""
        return DiskFile(path)

    def exists(self, path: Path) -> bool:
        """Whether the name is taken."""
        return path.exists()

    def rename(self, old: Path, new: Path) -> None:
        """Give a file another name, which nobody else takes meanwhile."""
        old.rename(new)

    def unlink(self, path: Path) -> None:
        """Take a name away."""
        path.unlink()

    def sync_directory(self, folder: Path) -> None:
        """Make created, renamed and deleted names in `folder` survive a power cut."""
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    def free_bytes(self, folder: Path) -> int:
        """What this process may still write there."""
        room = os.statvfs(folder)
        return room.f_bavail * room.f_frsize


DISK = Disk()


def is_being_written(path: Path) -> bool:
    """Whether a living process holds the lock of a `DiskFile`.

    Raises:
        OSError: the file cannot be opened.
    """
    try:
        with held(path) as free:
            return not free
    except FileNotFoundError:  # another has just finished with it
        return True


def abandoned(folder: Path, pattern: str) -> list[Path]:
    """The files that match and that no living process writes, sorted by name.

    Raises:
        OSError: the folder cannot be looked at.
    """
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        _lock(handle, fcntl.LOCK_EX)  # nobody is between creating a file and its lock
        return sorted(path for path in folder.glob(pattern) if not is_being_written(path))
    finally:
        os.close(handle)


@contextmanager
def held(path: Path) -> Iterator[bool]:
    """Hold a file's lock as long as the block lasts; yields False where another has it.

    Raises:
        OSError: the file cannot be opened.
    """
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        yield _lock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    finally:
        os.close(handle)


def _lock(handle: int, kind: int) -> bool:
    """Take a lock; False where another has it. Some network file systems have no locks."""
    try:
        fcntl.flock(handle, kind)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
