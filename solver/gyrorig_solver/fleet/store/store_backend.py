"""Index, claims and journal of a store, in a folder or in a bucket.

What to use when: `open_index` to query; `open_index_and_claims` in a batch, whose claims give the
journal when the batch begins. A folder uses file locks (`folder_claims`, `folder_journal`); a
bucket uses conditional puts and heartbeats (`bucket_coordination`).
"""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self
from uuid import uuid4

from gyrorig_protocol.errors import BusyError
from gyrorig_solver.fleet.store.bucket_coordination import BucketClaims, other_live_batches
from gyrorig_solver.fleet.store.bucket_index import BucketIndex
from gyrorig_solver.fleet.store.folder_claims import FolderClaims, batches_excluded
from gyrorig_solver.fleet.store.index_rows import IndexRow
from gyrorig_solver.fleet.store.store_index import StoreIndex
from gyrorig_solver.storage import Folder, Storage


class RowJournal(Protocol):
    """The rows of one running batch, in parts; see `folder_journal.FolderJournal`."""

    def __enter__(self) -> Self:
        """Return this object."""

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the journal; the next merge takes its rows."""

    def add(self, rows: Sequence[IndexRow]) -> None:
        """Append the rows of one job, all or none of them."""

    @property
    def is_full(self) -> bool:
        """Whether it is time to merge the journal into the index."""

    def start_next_part(self) -> Path:
        """Start another part and return the one before."""


class WorkClaims(Protocol):
    """The claims of one batch; see `folder_claims.FolderClaims`."""

    def begin_batch(self, index: StoreIndex) -> RowJournal:
        """Begin the batch and return its journal."""

    def end_batch(self, index: StoreIndex) -> None:
        """Merge the rows into the index, after the journal is closed."""

    def try_claim(self, key: str) -> bool:
        """Return True if this batch now has the claim on that job."""

    def mark_done(self, key: str) -> None:
        """Record that the job has its rows."""

    def release(self, key: str) -> None:
        """Give up the claim: the job was not done."""


def open_index(storage: Storage) -> StoreIndex:
    """Return the index of a store."""
    return StoreIndex(storage.path) if isinstance(storage, Folder) else BucketIndex(storage)


@contextlib.contextmanager
def exclusive_access(storage: Storage) -> Iterator[None]:
    """Run the block while no batch writes.

    A bucket has no locks, so a batch can still start there while the block runs.

    Raises:
        BusyError: a batch is running.
        MachineError: the store does not answer, or cannot be written.
    """
    with (
        batches_excluded(storage.path)
        if isinstance(storage, Folder)
        else _no_live_batch(storage) as no_batch_runs
    ):
        if not no_batch_runs:
            raise BusyError(
                f"another command, `gyrorig batch`, is writing to the store {storage.location}",
                "wait until that command has ended",
            )
        yield


def _no_live_batch(bucket: Storage) -> contextlib.nullcontext[bool]:
    return contextlib.nullcontext(not other_live_batches(bucket, f"probe-{uuid4().hex[:12]}"))


def open_index_and_claims(storage: Storage, batch: str) -> tuple[StoreIndex, WorkClaims]:
    """Return the index of a store, and the claims of a batch on it."""
    if isinstance(storage, Folder):
        return StoreIndex(storage.path), FolderClaims(storage.path, batch)
    return BucketIndex(storage), BucketClaims(storage, batch)
