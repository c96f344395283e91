"""Files that several test files read, made once in a run of the tests by the first that asks.

What to use when: `shared_folder` for the folder that all workers of pytest-xdist see; `made_once`
for what is expensive and the same for everyone. A test must not change these files.
"""

import fcntl
import hashlib
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest


def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of this run of the tests, the same one in each worker."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "made_once"
    shared.mkdir(exist_ok=True)
    return shared


def made_once(shared: Path, key: Sequence[str | bytes], make: Callable[[Path], None]) -> Path:
    """Return the folder of a key; `make` fills it if nobody has.

    Args:
        shared: from `shared_folder`.
        key: all that the content depends on.
        make: takes an empty folder.
    """
    parts = [part.encode() if isinstance(part, str) else part for part in key]
    digest = hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts))
    folder = shared / digest.hexdigest()[:24]
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another worker may make it now
        if not folder.exists():
            unfinished = folder.with_suffix(".unfinished")
            shutil.rmtree(unfinished, ignore_errors=True)
            unfinished.mkdir()
            make(unfinished)
            unfinished.rename(folder)
    return folder
