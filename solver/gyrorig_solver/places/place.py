"""What a folder and a bucket can both do: whole files by name, and no name taken twice.

What to use when: write against `Place`, get one from `choose.place_at`. Names are relative and have
`/` between their parts. A file appears whole or not at all, and `put_new` never replaces
one, whoever else writes at the same moment: everything that must not happen twice hangs
on that alone.
"""

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Entry:
    """One file as a listing tells of it."""

    name: str
    size: int
    stamp: str  # another one where the contents were changed
    changed_s: float = 0.0  # since 1970


class Place(Protocol):
    """A folder or a bucket. A small value that can be sent to other processes."""

    @property
    def text(self) -> str:
        """As a person names it."""

    def read(self, name: str) -> bytes | None:
        """Return a file's contents, None without such a file.

        Raises:
            MachineError: the place does not answer, or refuses.
        """

    def put(self, name: str, data: bytes) -> None:
        """Write a file, or replace it.

        Raises:
            MachineError: the place does not answer, or refuses; nothing was changed.
        """

    def put_new(self, name: str, data: bytes) -> bool:
        """Write a file; return False, and change nothing, where the name is taken.

        Raises:
            MachineError: as `put`.
        """

    def remove(self, names: Iterable[str]) -> None:
        """Remove files; one that is not there is no fault.

        Raises:
            MachineError: the place does not answer, or refuses.
        """

    def entries(self, below: str = "") -> Iterator[Entry]:
        """Yield all files in the folder `below` and those below it, in an order that stays.

        The files that lie in one folder follow each other.

        Raises:
            MachineError: the place does not answer, or refuses.
        """

    def local(self, name: str) -> AbstractContextManager[Path]:
        """Give the file on this machine, under its own last name, while the block runs.

        Raises:
            MachineError: the place does not answer, or refuses.
            InputError: there is no such file.
        """
