"""Atomic file writes: a file is there whole or not at all, also after a power cut.

What to use when: `write_atomically` for every small file that another program may read or
that must survive a crash; `sync_directory` after a name was created or renamed by hand;
`remove_leftovers` from time to time, in a folder whose writers can be killed.
"""

import contextlib
import fcntl
import itertools
import os
import re
import stat
import tempfile
import time
from pathlib import Path

LEFTOVER_S = 600.0  # a temporary file is locked far below a second after its creation
_RANDOM_PART = re.compile(r"[a-z0-9_]{8}")  # as `tempfile.mkstemp` writes it
_MAX_ENTRIES = 100_000  # of a folder; reading them takes 0.1 s


def sync_directory(folder: Path) -> None:
    """Make a created or renamed name in `folder` survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_atomically(
    path: Path, data: bytes, *, mode: int = 0o644, replace: bool = True, durable: bool = True
) -> bool:
    """Write `data` to `path` in one step, by a temporary name in the same folder.

    Args:
        path: the name to take.
        data: the whole content.
        mode: permissions of the new file.
        replace: whether an existing file may be replaced.
        durable: whether the file must survive a power cut (fsync of file and folder).

    Returns:
        False if the name is taken and `replace` is False; nothing was changed.

    Raises:
        OSError: as the system reports it; `path` is as it was before.
    """
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(descriptor, "wb") as file:
            lock_temporary(file.fileno())
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), mode)
            if durable:
                os.fsync(file.fileno())
            if replace:
                temporary.replace(path)
            else:
                path.hardlink_to(temporary)  # unlike a rename, never replaces another file
    except FileExistsError:
        return False
    finally:
        temporary.unlink(missing_ok=True)
    if durable:
        sync_directory(path.parent)
    return True


def lock_temporary(descriptor: int) -> None:
    """Lock a temporary file until it is closed, so that `remove_leftovers` leaves it alone."""
    with contextlib.suppress(OSError):  # some network file systems lack locks
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def remove_leftovers(folder: Path, name_end: str) -> int:
    """Remove temporary files that a crash in `write_atomically` has left.

    A file that a running process writes is locked, and stays. So does a file that this process
    may not read, or that is younger than `LEFTOVER_S`.

    Args:
        folder: without following a link; it need not exist.
        name_end: of the files that were written, for example `.yaml`, or a whole name.

    Returns:
        The number of removed files.
    """
    removed_count = 0
    with contextlib.suppress(OSError):
        flags = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
        folder_fd = os.open(folder, flags)
        try:
            with os.scandir(folder_fd) as entries:
                names = [entry.name for entry in itertools.islice(entries, _MAX_ENTRIES)]
            for name in names:
                target, _, random_part = name.removeprefix(".").rpartition(".")
                is_temporary = name.startswith(".") and _RANDOM_PART.fullmatch(random_part)
                if is_temporary and target.endswith(name_end):
                    removed_count += _remove_abandoned(name, folder_fd)
        finally:
            os.close(folder_fd)
    return removed_count


def _remove_abandoned(name: str, folder_fd: int) -> bool:
    """Remove an old regular file that nobody has locked; return whether it was removed."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    try:
        descriptor = os.open(name, flags, dir_fd=folder_fd)
    except OSError:
        return False
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or time.time() - status.st_mtime < LEFTOVER_S:
            return False
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.unlink(name, dir_fd=folder_fd)
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True
