"""Atomic file writes: a file is there whole or not at all, also after a power cut.

What to use when: `write_atomically` for every small file that another program may read or
that must survive a crash; `sync_directory` after a name was created or renamed by hand.
"""

import os
import tempfile
from pathlib import Path


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
