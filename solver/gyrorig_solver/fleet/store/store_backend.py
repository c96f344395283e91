"""Index, claims and journal of a store, in a folder or in a bucket.

What to use when: `open_index` to query; `open_index_and_claims` in a batch, whose claims give the
journal when the batch begins. A folder uses file locks (`folder_claims`, `folder_journal`); a
bucket uses conditional puts and heartbeats (`bucket_coordination`).
"""

import contextlib
from collections.abc import Iterator
from uuid import uuid4

from gyrorig_protocol.errors import BusyError
from gyrorig_solver.fleet.store.bucket_coordination import (
    BucketClaims,
    BucketJournal,
    other_live_batches,
)
from gyrorig_solver.fleet.store.bucket_index import BucketIndex
from gyrorig_solver.fleet.store.folder_claims import FolderClaims, batches_excluded
from gyrorig_solver.fleet.store.folder_journal import FolderJournal
from gyrorig_solver.fleet.store.store_index import StoreIndex
from gyrorig_solver.storage import Folder, Storage

RowJournal = FolderJournal | BucketJournal
WorkClaims = FolderClaims | BucketClaims


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
