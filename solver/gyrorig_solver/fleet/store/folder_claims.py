"""Claims in a folder: which batch works on which job, so that two batches share the work.

What to use when: `FolderClaims.begin_batch` once, at the start of a batch; `try_claim` before
each job; `mark_done` when its rows are written.

Theory of operation: a claim is a file with the job's key as its name and the batch's name as its
content. It is valid while that batch runs, which is known from the lock on its journal, and after
its job is done. Claims of finished jobs are kept until a batch starts while no other runs;
otherwise a batch that read the index earlier would repeat such jobs. All of this happens under
one lock of the store.
"""

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.fleet.store.folder_journal import (
    FolderJournal,
    is_batch_running,
    other_batch_running,
)
from gyrorig_solver.fleet.store.store_index import StoreIndex

CLAIMS_FOLDER = "claims"
_DONE_SUFFIX = " done"


class FolderClaims:
    """The claims of one batch. Used by one thread."""

    def __init__(self, store: Path, batch: str) -> None:
        self._store = store
        self._folder = store / CLAIMS_FOLDER
        self._batch = batch

    def begin_batch(self, index: StoreIndex) -> FolderJournal:
        """Begin the batch: open its journal, merge abandoned journals, remove old claims.

        Raises:
            MachineError: the store cannot be written.
            InputError: an abandoned journal is damaged.
        """
        with self._store_lock():
            journal = FolderJournal(self._store, self._batch)
            index.merge_abandoned_journals()
            if not other_batch_running(self._store, self._batch):
                index.remove_temporary_files()
                for old_claims in self._folder.glob("??"):
                    shutil.rmtree(old_claims, ignore_errors=True)
        return journal

    def end_batch(self, index: StoreIndex) -> None:
        """Merge the rows of this batch and abandoned journals; its own journal is closed.

        Raises:
            MachineError: the store cannot be written.
            InputError: an abandoned journal is damaged.
        """
        with self._store_lock():  # a batch that begins now would remove half-written files
            index.merge_abandoned_journals()

    def try_claim(self, key: str) -> bool:
        """Return True if this batch now has the claim on that job.

        Raises:
            MachineError: the store cannot be written.
        """
        claim = self._claim_path(key)
        with self._store_lock():
            if claim.exists():
                holder = claim.read_text(encoding="utf-8")
                is_own = holder == self._batch  # the job was deferred, and is tried again
                if holder.endswith(_DONE_SUFFIX) or (
                    not is_own and is_batch_running(self._store, holder)
                ):
                    return False
            self._write(claim, self._batch)
        return True

    def mark_done(self, key: str) -> None:
        """Record that the job has its rows."""
        with self._store_lock():
            self._write(self._claim_path(key), self._batch + _DONE_SUFFIX)

    def release(self, key: str) -> None:
        """Give up the claim: the job was not done."""
        with self._store_lock():
            self._claim_path(key).unlink(missing_ok=True)

    def _claim_path(self, key: str) -> Path:
        return self._folder / key[:2] / key

    def _write(self, claim: Path, text: str) -> None:
        claim.parent.mkdir(parents=True, exist_ok=True)
        claim.write_text(text, encoding="utf-8")

    @contextlib.contextmanager
    def _store_lock(self) -> Iterator[None]:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            fd = os.open(self._folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX)
                yield
            finally:
                os.close(fd)
        except OSError as fault:
            raise MachineError(
                f"the folder {self._folder} of the store cannot be written ({fault.strerror})",
                "free some disk space, or correct the permissions of the store",
            ) from fault


@contextlib.contextmanager
def batches_excluded(store: Path) -> Iterator[bool]:
    """Prevent batches from starting while the block runs; tell whether none is running now.

    Raises:
        MachineError: the store cannot be written.
    """
    with FolderClaims(store, "")._store_lock():
        yield not other_batch_running(store, "")
