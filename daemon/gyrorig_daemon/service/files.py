"""Files that are there whole or not at all, whoever reads them and whenever power fails."""

import os
from pathlib import Path


def sync_directory(folder: Path) -> None:
    """Make a created or renamed name in `folder` survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_whole(path: Path, data: bytes, mode: int = 0o640, durable: bool = True) -> None:
    """Put `data` at `path` in one step.

    Args:
        path: the name; a file there is replaced.
        data: all of it.
        mode: of the new file.
        durable: it has to survive a power cut too.

    Raises:
        OSError: as the system reports it; nothing is at `path` that was not before.
    """
    beside = path.with_name(f".{path.name}.new")
    handle = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, mode)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(handle, rest) :]
        if durable:
            os.fsync(handle)
    finally:
        os.close(handle)
    beside.replace(path)
    if durable:
        sync_directory(path.parent)
