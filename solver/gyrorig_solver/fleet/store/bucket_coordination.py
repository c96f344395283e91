"""Heartbeats, claims and journal of a batch in a bucket, which has no locks.

What to use when: through `store_backend.open_index_and_claims`.

    alive/<batch>                       heartbeat, written every 20 s
    claims/<k2>/<key>.0000              which batch has the job; `.0001` after that one has died
    journal/<batch>-<part>/000017.jsonl the rows of one job

Theory of operation: a batch runs while its heartbeat is younger than two minutes by the store's
own clock. The age is the difference to a heartbeat that was written just now, so no two clocks
are compared. A claim is taken by a put that never replaces an object. The claim of a dead batch
is taken over under the next number, by the same kind of put: exactly one of several succeeds.

A batch that was only asleep (a closed laptop) can wake up after its job was taken over. Then two
batches work on one job. Before a version is written, the store is checked again for a version of
that job (`session_job`), and a row that exists twice counts once (`store_index`): the work is
done twice, the result exists once.

Claims of finished jobs are removed when a batch starts while no other runs. It writes its own
heartbeat, lists the claims, then looks for other batches: a batch that begins later writes its
claims after that list.
"""

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import msgspec

from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_solver.fleet.store.folder_journal import JOURNAL_SUFFIX, ROWS_PER_PART
from gyrorig_solver.fleet.store.index_rows import IndexRow, row_columns
from gyrorig_solver.fleet.store.store_index import StoreIndex
from gyrorig_solver.storage import Storage

HEARTBEAT_FOLDER, CLAIMS_FOLDER, JOURNAL_FOLDER = "alive", "claims", "journal"
HEARTBEAT_PERIOD_S = 20.0
HEARTBEAT_TIMEOUT_S = 120.0  # six missed heartbeats: longer than usual outages
_DONE_SUFFIX = " done"


class Heartbeat:
    """Heartbeat of a batch, written by a separate thread until it is stopped."""

    def __init__(self, storage: Storage, batch: str) -> None:
        """Write the first heartbeat.

        Raises:
            MachineError: the bucket refuses.
        """
        self._storage, self._name = storage, f"{HEARTBEAT_FOLDER}/{batch}"
        storage.write(self._name, batch.encode())
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread and remove the heartbeat."""
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(MachineError):  # then it expires
            self._storage.remove([self._name])

    def _run(self) -> None:
        while not self._stop.wait(HEARTBEAT_PERIOD_S):
            with contextlib.suppress(GyrorigError):  # the next one may succeed
                self._storage.write(self._name, self._name.encode())


def live_batches(storage: Storage, probe_name: str) -> set[str]:
    """Return the batches whose heartbeat is recent.

    A heartbeat with the unused name `probe_name` is written to read the store's clock.

    Raises:
        MachineError: the bucket does not answer.
    """
    storage.write(f"{HEARTBEAT_FOLDER}/{probe_name}", probe_name.encode())
    written_s = {
        entry.name.rpartition("/")[2]: entry.modified_s
        for entry in storage.list_files(HEARTBEAT_FOLDER)
    }
    now_s = written_s.get(probe_name, 0.0)
    return {batch for batch, sign_s in written_s.items() if now_s - sign_s < HEARTBEAT_TIMEOUT_S}


def other_live_batches(storage: Storage, probe_name: str) -> set[str]:
    """Return the other running batches; the probe's own heartbeat is removed again.

    Raises:
        MachineError: the bucket does not answer.
    """
    try:
        return {batch for batch in live_batches(storage, probe_name) if batch != probe_name}
    finally:
        storage.remove([f"{HEARTBEAT_FOLDER}/{probe_name}"])


class BucketJournal:
    """The rows of one running batch, one object per job. Used by one thread."""

    def __init__(self, storage: Storage, batch: str, heartbeat: Heartbeat) -> None:
        self._storage, self._batch, self._heartbeat = storage, batch, heartbeat
        self._part = 0
        self._pieces = 0
        self.row_count = 0

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Stop the heartbeat; the next merge takes the rows."""
        self._heartbeat.stop()

    def add(self, rows: Sequence[IndexRow]) -> None:
        """Write the rows of one job.

        Raises:
            MachineError: the bucket refuses; no row was written.
        """
        text = b"".join(msgspec.json.encode(row_columns(row)) + b"\n" for row in rows)
        name = f"{JOURNAL_FOLDER}/{self._part_name()}/{self._pieces:06d}{JOURNAL_SUFFIX}"
        if not self._storage.write_new(name, text):
            # An earlier put succeeded, but its answer was lost and the job was deferred.
            self._pieces += 1
            self.add(rows)
            return
        self._pieces += 1
        self.row_count += len(rows)

    @property
    def is_full(self) -> bool:
        """Whether it is time to merge the journal into the index."""
        return self.row_count >= ROWS_PER_PART

    def start_next_part(self) -> Path:
        """Start another part and return the name of the one before, which can be merged now."""
        finished = Path(f"{self._part_name()}{JOURNAL_SUFFIX}")
        self._part += 1
        self._pieces = self.row_count = 0
        return finished

    def _part_name(self) -> str:
        return f"{self._batch}-{self._part:04d}"


class BucketClaims:
    """The claims of one batch. Used by one thread."""

    def __init__(self, storage: Storage, batch: str) -> None:
        self._storage, self._batch = storage, batch
        self._claim_names: dict[str, str] = {}

    def begin_batch(self, index: StoreIndex) -> BucketJournal:
        """Begin the batch: start its heartbeat, merge abandoned journals, remove old claims.

        Raises:
            MachineError: the bucket refuses.
            InputError: an abandoned journal is damaged.
        """
        heartbeat = Heartbeat(self._storage, self._batch)
        try:
            old_objects = [entry.name for entry in self._storage.list_files(CLAIMS_FOLDER)]
            index.merge_abandoned_journals()
            own_heartbeat = f"{HEARTBEAT_FOLDER}/{self._batch}"
            old_objects += [
                entry.name
                for entry in self._storage.list_files(HEARTBEAT_FOLDER)
                if entry.name != own_heartbeat
            ]
            # Everything listed so far belongs to batches that are seen here, or have ended.
            if live_batches(self._storage, self._batch) == {self._batch}:
                index.remove_temporary_files()
                self._storage.remove(old_objects)
        except BaseException:
            heartbeat.stop()
            raise
        return BucketJournal(self._storage, self._batch, heartbeat)

    def end_batch(self, index: StoreIndex) -> None:
        """Merge the rows of this batch and abandoned journals; its heartbeat has stopped.

        Raises:
            MachineError: the bucket refuses.
            InputError: an abandoned journal is damaged.
        """
        index.merge_abandoned_journals()

    def try_claim(self, key: str) -> bool:
        """Return True if this batch now has the claim on that job.

        Raises:
            MachineError: the bucket refuses.
        """
        number = 0
        while True:
            name = f"{CLAIMS_FOLDER}/{key[:2]}/{key}.{number:04d}"
            if self._storage.write_new(name, self._batch.encode()):
                self._claim_names[key] = name
                return True
            holder = (self._storage.read(name) or b"").decode("utf-8", "replace")
            if holder.endswith(_DONE_SUFFIX) or holder in live_batches(self._storage, self._batch):
                return False
            number += 1

    def mark_done(self, key: str) -> None:
        """Record that the job has its rows."""
        self._storage.write(self._claim_names[key], (self._batch + _DONE_SUFFIX).encode())

    def release(self, key: str) -> None:
        """Give up the claim: the job was not done."""
        name = self._claim_names.pop(key, None)
        if name is not None:
            self._storage.remove([name])
