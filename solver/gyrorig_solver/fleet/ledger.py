"""What a batch writes down while it runs: who works on what, and what has come of it.

What to use when: `ledger_at` gives the index, the claims and, when begun, the journal of a
store. In a folder they rest upon locks of the system (`claims`, `journal`), in a bucket upon
puts that replace nothing and a sign of life (`bucket_ledger`).
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self
from uuid import uuid4

from gyrorig_protocol.errors import BusyError
from gyrorig_solver.fleet.bucket_index import BucketIndex
from gyrorig_solver.fleet.bucket_ledger import BucketClaims, others_live
from gyrorig_solver.fleet.claims import Claims, kept_quiet
from gyrorig_solver.fleet.index import Index
from gyrorig_solver.fleet.rows import Row
from gyrorig_solver.places.folder import Folder
from gyrorig_solver.places.place import Place


class JournalLike(Protocol):
    """The rows of one running batch, in parts; see `journal.Journal`."""

    def __enter__(self) -> Self:
        """Itself."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let go; what is in it stays for the next fold."""

    def add(self, rows: Sequence[Row]) -> None:
        """Append the rows of one piece of work, all or none of them."""

    @property
    def is_full(self) -> bool:
        """Whether it is time to fold."""

    def next_part(self) -> Path:
        """Begin another part and return the one before."""


class ClaimsLike(Protocol):
    """The claims of one batch; see `claims.Claims`."""

    def begin(self, index: Index) -> JournalLike:
        """Begin the batch."""

    def end(self, index: Index) -> None:
        """Fold what was written, once the journal is closed."""

    def take(self, key: str) -> bool:
        """Return True if the work of that key is now this batch's."""

    def done(self, key: str) -> None:
        """Say that the work of that key has its rows."""

    def give_back(self, key: str) -> None:
        """Let the work of that key be taken again: it was not done."""


def index_at(place: Place) -> Index:
    """Return the index of a store."""
    return Index(place.path) if isinstance(place, Folder) else BucketIndex(place)


@contextlib.contextmanager
def alone(place: Place) -> Iterator[None]:
    """Do what no batch may write beside. In a folder none begins meanwhile; a bucket has no locks.

    Raises:
        BusyError: a batch is running.
        MachineError: the store does not answer, or cannot be written.
    """
    with kept_quiet(place.path) if isinstance(place, Folder) else _none_lives(place) as quiet:
        if not quiet:
            raise BusyError(f"a batch writes to {place.text}", "wait until it has ended")
        yield


def _none_lives(bucket: Place) -> contextlib.nullcontext[bool]:
    return contextlib.nullcontext(not others_live(bucket, f"probe-{uuid4().hex[:12]}"))


def ledger_at(place: Place, batch: str) -> tuple[Index, ClaimsLike]:
    """Return the index of a store, and the claims of a batch on it."""
    if isinstance(place, Folder):
        return Index(place.path), Claims(place.path, batch)
    return BucketIndex(place), BucketClaims(place, batch)
