"""Heartbeats, claims and journal of a batch, in a folder and in a bucket, without locks.

What to use when: `BatchClaims.begin_batch` once, at the start of a batch; `try_claim` before each
job; `RowJournal.add` and `mark_done` when it is done. `exclusive_access` for work during which no
batch may write.

    alive/<batch>                   heartbeat, written every 20 s: which process runs the batch
    claims/<k2>/<key>.0000          which batch has the job; `.0001` after that one has died
    journal/<batch>-000017.jsonl    the rows of one job

Theory of operation: everything that must happen once is a write that never replaces a file. The
claim of a dead batch is taken over under the next number: exactly one of several succeeds. If the
process of a batch is on this machine, the operating system tells whether it runs. Otherwise the
batch runs while its heartbeat is younger than two minutes by the store's own clock. The age is the
difference to a file that was written just now, so no two clocks are compared.

A batch that was only asleep (a closed laptop) can wake up after its job was taken over. Then two
batches work on one job. Before a version is written, the store is checked again for a version of
that job (`session_job`), and a row that exists twice counts once (`store_index`): the work is
done twice, the result exists once.

Claims of finished jobs are removed when a batch starts while no other runs. It writes its own
heartbeat, lists the claims, then looks for other batches: a batch that begins later writes its
claims after that list. Likewise, of a batch and a command with exclusive access that begin at the
same moment, at least one sees the heartbeat of the other.
"""

import contextlib
import os
import threading
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Self
from uuid import uuid4

import msgspec

from gyrorig_protocol.errors import BusyError, GyrorigError, MachineError
from gyrorig_solver.fleet.store.index_rows import IndexRow, json_lines
from gyrorig_solver.storage import Storage

HEARTBEAT_FOLDER, CLAIMS_FOLDER = "alive", "claims"
JOURNAL_FOLDER, INDEX_FOLDER = "journal", "index"
JOURNAL_SUFFIX = ".jsonl"
HEARTBEAT_PERIOD_S = 20.0
HEARTBEAT_TIMEOUT_S = 120.0  # six missed heartbeats: longer than usual outages
EXCLUSIVE_PREFIX = "exclusive-"
EXCLUSIVE_POLL_S = 1.0
ROWS_PER_MERGE = 5_000  # then the journal is merged into the index
_DONE_SUFFIX = " done"


class _Holder(msgspec.Struct, frozen=True):
    """Content of a heartbeat: the process that writes it."""

    machine: str
    pid: int
    started: str


class Heartbeat:
    """Heartbeat of a batch, written by a separate thread until it is stopped."""

    def __init__(self, storage: Storage, batch: str) -> None:
        """Write the first heartbeat.

        Raises:
            MachineError: the store refuses.
        """
        self._storage, self._name = storage, f"{HEARTBEAT_FOLDER}/{batch}"
        holder = _Holder(this_machine(), os.getpid(), _process_start(os.getpid()))
        self._data = msgspec.json.encode(holder)
        storage.write(self._name, self._data)
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
                self._storage.write(self._name, self._data)


@cache
def this_machine() -> str:
    """Return what processes share that can see each other: one boot of one computer or container.

    Where it is unknown, it is a text that no other process has.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return uuid4().hex


def _process_start(pid: int) -> str:
    """Return when a process of this machine started, "" if it does not run."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    fields = text.rpartition(")")[2].split()  # state is the first, start the 20th
    return "" if fields[0] in "ZX" else fields[19]


def live_batches(storage: Storage) -> set[str]:
    """Return the batches whose process runs.

    Raises:
        MachineError: the store does not answer.
    """
    live, elsewhere_s = set(), {}
    for entry in list(storage.list_files(HEARTBEAT_FOLDER)):
        batch = PurePosixPath(entry.name).name
        if batch.startswith("."):
            continue
        try:
            holder = msgspec.json.decode(storage.read(entry.name) or b"null", type=_Holder | None)
        except msgspec.DecodeError:  # of an older version of the program
            holder = _Holder("", 0, "")
        if holder is not None and holder.machine != this_machine():
            elsewhere_s[batch] = entry.modified_s
        elif holder is not None and _process_start(holder.pid) == holder.started:
            live.add(batch)
    if elsewhere_s:
        now_s = _store_time_s(storage)
        live |= {batch for batch, at_s in elsewhere_s.items() if now_s - at_s < HEARTBEAT_TIMEOUT_S}
    return live


def _store_time_s(storage: Storage) -> float:
    """Return the time by the clock of the store."""
    name = f"{HEARTBEAT_FOLDER}/.{uuid4().hex}"
    storage.write(name, b"")
    try:
        return max(entry.modified_s for entry in storage.list_files(HEARTBEAT_FOLDER))
    finally:
        storage.remove([name])


@contextlib.contextmanager
def exclusive_access(storage: Storage) -> Iterator[None]:
    """Run the block while no batch writes; a batch that begins meanwhile waits.

    Raises:
        BusyError: a batch is running.
        MachineError: the store does not answer, or cannot be written.
    """
    name = f"{EXCLUSIVE_PREFIX}{uuid4().hex[:12]}"
    heartbeat = Heartbeat(storage, name)
    try:
        if live_batches(storage) - {name}:
            raise BusyError(
                f"another command, `gyrorig batch`, is writing to the store {storage.location}",
                "wait until that command has ended",
            )
        yield
    finally:
        heartbeat.stop()


class RowJournal:
    """The rows of one running batch, one file per job. Used by one thread."""

    def __init__(self, storage: Storage, batch: str) -> None:
        """Begin the heartbeat of the batch.

        Raises:
            MachineError: the store refuses.
        """
        self._storage, self.batch = storage, batch
        self._heartbeat = Heartbeat(storage, batch)
        self._files = 0
        self._unmerged_rows = 0

    def __enter__(self) -> Self:
        """Return this object."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Stop the heartbeat; the next merge takes the rows."""
        self.close()

    def close(self) -> None:
        """Stop the heartbeat."""
        self._heartbeat.stop()

    def add(self, rows: Sequence[IndexRow]) -> None:
        """Write the rows of one job, all or none of them.

        Raises:
            MachineError: the store refuses; no row was written.
        """
        text = json_lines(rows)
        is_written = False
        while not is_written:  # a name is taken if its put succeeded, but the answer was lost
            name = f"{JOURNAL_FOLDER}/{self.batch}-{self._files:06d}{JOURNAL_SUFFIX}"
            is_written = self._storage.write_new(name, text)
            self._files += 1
        self._unmerged_rows += len(rows)

    def take_full(self) -> bool:
        """Return whether to merge the journal into the index; if so, restart the count."""
        is_full = self._unmerged_rows >= ROWS_PER_MERGE
        if is_full:
            self._unmerged_rows = 0
        return is_full


def journal_files(storage: Storage) -> dict[str, list[str]]:
    """Return the names of the files of all journals, by batch.

    Older versions of the program wrote `<batch>-<part>.jsonl` and `<batch>-<part>/<n>.jsonl`.

    Raises:
        MachineError: the store does not answer.
    """
    names_by_batch: dict[str, list[str]] = {}
    for entry in storage.list_files(JOURNAL_FOLDER):
        part = PurePosixPath(entry.name).parts[1]
        if not part.startswith("."):
            batch = part.removesuffix(JOURNAL_SUFFIX).rpartition("-")[0]
            names_by_batch.setdefault(batch, []).append(entry.name)
    return names_by_batch


class BatchClaims:
    """The claims of one batch. Used by one thread."""

    def __init__(self, storage: Storage, batch: str) -> None:
        self._storage, self._batch = storage, batch
        self._claim_names: dict[str, str] = {}

    def begin_batch(self) -> RowJournal:
        """Begin the batch: start its heartbeat, and remove what ended batches have left.

        Raises:
            MachineError: the store refuses.
        """
        journal = RowJournal(self._storage, self._batch)
        try:
            while any(name.startswith(EXCLUSIVE_PREFIX) for name in live_batches(self._storage)):
                time.sleep(EXCLUSIVE_POLL_S)
            old_files = list(self._removable_files())
            # Everything listed so far belongs to batches that are seen here, or have ended.
            if live_batches(self._storage) == {self._batch}:
                self._storage.remove(old_files)
        except BaseException:
            journal.close()
            raise
        return journal

    def _removable_files(self) -> Iterator[str]:
        """Yield claims, heartbeats of others, and temporary files of killed writes."""
        for folder in (CLAIMS_FOLDER, HEARTBEAT_FOLDER, JOURNAL_FOLDER, INDEX_FOLDER):
            for entry in self._storage.list_files(folder):
                is_temporary = PurePosixPath(entry.name).name.startswith(".")
                if folder == CLAIMS_FOLDER:
                    yield entry.name
                elif folder == HEARTBEAT_FOLDER:
                    # A temporary file may be the first heartbeat of a batch that begins now.
                    if not is_temporary and entry.name != f"{folder}/{self._batch}":
                        yield entry.name
                elif is_temporary:
                    yield entry.name

    def try_claim(self, key: str) -> bool:
        """Return True if this batch now has the claim on that job.

        Raises:
            MachineError: the store refuses.
        """
        number = 0
        while True:
            name = f"{CLAIMS_FOLDER}/{key[:2]}/{key}.{number:04d}"
            if not self._storage.write_new(name, self._batch.encode()):
                holder = (self._storage.read(name) or b"").decode("utf-8", "replace")
                # A claim of this batch: the job was deferred, and is tried again.
                if holder != self._batch:
                    if holder.endswith(_DONE_SUFFIX) or holder in live_batches(self._storage):
                        return False
                    number += 1
                    continue
            self._claim_names[key] = name
            return True

    def mark_done(self, key: str) -> None:
        """Record that the job has its rows."""
        self._storage.write(self._claim_names[key], (self._batch + _DONE_SUFFIX).encode())

    def release(self, key: str) -> None:
        """Give up the claim: the job was not done."""
        name = self._claim_names.pop(key, None)
        if name is not None:
            self._storage.remove([name])
