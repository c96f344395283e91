"""Storage protocol: operations that folders and buckets share, with writes that never replace.

What to use when: write against `Storage`, and get one from `location.storage_at`. Names are
relative and have `/` between their parts. A file appears complete or not at all. `write_new` never
replaces a file, even if several programs write at the same moment: everything that must happen
exactly once depends on it.
"""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True, slots=True)
class StorageEntry:
    """One file of a listing."""

    name: str
    size: int
    change_tag: str  # differs when the contents have changed
    modified_s: float = 0.0  # since 1970


class Storage(Protocol):
    """A folder or a bucket: a small value that can be sent to other processes."""

    @property
    def location(self) -> str:
        """The path or URL."""

    def read(self, name: str) -> bytes | None:
        """Return a file's contents, None if the file does not exist.

        Raises:
            MachineError: the storage does not answer, or refuses.
        """

    def write(self, name: str, data: bytes) -> None:
        """Write a file, or replace it.

        Raises:
            MachineError: the storage does not answer, or refuses; nothing was changed.
        """

    def write_new(self, name: str, data: bytes) -> bool:
        """Write a file; return False, and change nothing, if the name is taken.

        Raises:
            MachineError: as `write`.
        """

    def remove(self, names: Iterable[str]) -> None:
        """Remove files; a file that does not exist is not an error.

        Raises:
            MachineError: the storage does not answer, or refuses.
        """

    def list_files(self, folder: str = "") -> Iterator[StorageEntry]:
        """Yield all files in `folder` and its subfolders, in a stable order.

        The files of one folder follow each other.

        Raises:
            MachineError: the storage does not answer, or refuses.
        """

    def cache_folder(self) -> Path:
        """Return the folder of this machine for caches of this storage. They can be deleted.

        Raises:
            MachineError: the folder cannot be created.
        """

    def cached_copy(self, name: str) -> Path:
        """Return a file of this machine with the contents of a file that never changes.

        Raises:
            MachineError: the storage does not answer, or refuses.
            InputError: the file does not exist.
        """

    def local_copy(self, name: str) -> AbstractContextManager[Path]:
        """Provide the file on this machine, with its own name, while the block runs.

        Raises:
            MachineError: the storage does not answer, or refuses.
            InputError: the file does not exist.
        """
