"""A new file that knows what of it is on disk, and can be cut back to that.

What to use when: only under `writer`. It writes without a buffer of its own, so after
an error its position is the truth, and it never opens a file that exists.
"""

import os
from pathlib import Path


def sync_directory(folder: Path) -> None:
    """Make a created or renamed name in `folder` survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


class DiskFile:
    """The part of a binary stream that `mcap.writer.Writer` needs, on a bare descriptor.

    Raises:
        FileExistsError: the path exists already.
        OSError: from every method, as the system reports it.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        self._handle = os.open(path, flags, 0o644)
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

    def flush(self) -> None:
        """Nothing is buffered here."""

    def sync(self) -> None:
        """Wait until the bytes are on the disk."""
        os.fdatasync(self._handle)

    def cut(self, length: int) -> None:
        """Drop everything behind the first `length` bytes."""
        os.ftruncate(self._handle, length)
        os.lseek(self._handle, length, os.SEEK_SET)
        self._position = length

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._handle)
