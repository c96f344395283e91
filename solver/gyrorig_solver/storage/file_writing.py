"""Atomic file writes whose failures name a remedy."""

import errno
from pathlib import Path

from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.errors import MachineError


def write_file(path: Path, data: bytes, *, replace: bool, make_folder: bool = False) -> bool:
    """Write a file atomically and synced: whole, or not at all.

    Returns:
        False if the name is taken and must not be replaced; nothing was changed.

    Raises:
        MachineError: the file system refuses; nothing was changed.
    """
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        return write_atomically(path, data, replace=replace)
    except OSError as fault:
        raise MachineError(
            f"the file {path} cannot be written ({fault.strerror})", _write_remedy(fault)
        ) from fault


def _write_remedy(fault: OSError) -> str:
    if fault.errno in (errno.EPERM, errno.EOPNOTSUPP):
        return "choose a folder on a file system with hard links, such as ext4"
    if fault.errno in (errno.ENOSPC, errno.EDQUOT):
        return "free some disk space, and run the command again"
    return "choose another folder with --out"
