"""Batch run: scan a spool, solve its new sessions, and update the store and its index.

What to use when: `run_batch`. A batch can be killed at any moment and started again. Jobs with a
row in the index are finished, a version without a row is found again, and rows that are not yet
merged into the index are merged at the next start. Two batches on one store share the jobs by
claims.
"""

import contextlib
import os
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from gyrorig_protocol.errors import MachineError
from gyrorig_solver.calibration import create_store
from gyrorig_solver.fleet.jobs.interruption import Interruption, remember_interruption
from gyrorig_solver.fleet.jobs.recording_cache import RecordingCache
from gyrorig_solver.fleet.jobs.session_job import Job, JobResult, SolveSettings
from gyrorig_solver.fleet.jobs.spool_scanner import (
    RecordedSession,
    SpoolListing,
    group_into_sessions,
    read_recordings,
    scan_spool,
)
from gyrorig_solver.fleet.jobs.workers import DeferredJob, WorkerPool, run_all
from gyrorig_solver.fleet.store import IndexRow, StoreIndex, job_key
from gyrorig_solver.fleet.store.coordination import BatchClaims, RowJournal
from gyrorig_solver.fleet.store.manifest import Signer, write_manifests
from gyrorig_solver.storage import Storage, storage_at

RECORDING_CACHE_FILE = "spool-heads.sqlite"
GIVE_UP_AFTER_DEFERRALS = 20  # consecutive ones: the store is full, or gone
_WORST_FIRST = ("quarantined", "failed", "rejected", "ok")

ProgressCallback = Callable[["BatchSummary"], None]


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several batches that divide the jobs without communication."""

    number: int = 1
    count: int = 1

    def contains(self, key: str) -> bool:
        """Return whether this shard has to do the job."""
        return int(key[:8], 16) % self.count == self.number - 1


@dataclass(slots=True)
class BatchSummary:
    """Progress and result of a batch."""

    spool: SpoolListing
    sessions: int = 0  # in the spool
    done_before: int = 0
    taken_by_others: int = 0  # jobs of another batch or shard
    to_do: int = 0
    started_s: float = field(default_factory=time.monotonic)
    # A session counts under the worst status of its boards.
    sessions_by_status: Counter[str] = field(default_factory=Counter)
    boards_by_status: Counter[str] = field(default_factory=Counter)
    deferred_keys: set[str] = field(default_factory=set)  # the machine or the store refused them
    deferral_reason: str = ""
    own_rows: list[IndexRow] = field(default_factory=list)  # of calibrations, to be signed
    unsuccessful_rows: list[IndexRow] = field(default_factory=list)
    joint_fit_failures: list[str] = field(default_factory=list)  # of boards solved singly instead
    consecutive_deferrals: int = 0
    gave_up: bool = False
    unmerged_reason: str = ""  # the index was not updated; the next batch does it

    @property
    def deferred(self) -> int:
        """Number of sessions that the machine or the store refused."""
        return len(self.deferred_keys)

    @property
    def finished(self) -> int:
        """Number of sessions that this batch finished."""
        return sum(self.sessions_by_status.values())

    @property
    def not_started(self) -> int:
        """Number of sessions that were not started, because the batch gave up."""
        return self.to_do - self.finished - self.deferred

    @property
    def elapsed_s(self) -> float:
        """Time since the batch started."""
        return time.monotonic() - self.started_s

    @property
    def sessions_per_second(self) -> float:
        """Mean rate so far."""
        return self.finished / max(self.elapsed_s, 1e-9)

    @property
    def remaining_s(self) -> float | None:
        """Estimated remaining time; None before the first session."""
        return self.not_started / self.sessions_per_second if self.finished else None

    @property
    def is_partial(self) -> bool:
        """Whether a session did not end with ok."""
        return bool(
            self.deferred
            or self.unmerged_reason
            or sum(self.sessions_by_status.values()) > self.sessions_by_status["ok"]
        )


def run_batch(
    spool: Path | Storage,
    store: Path | Storage,
    settings: SolveSettings,
    pools: list[WorkerPool],
    *,
    shard: Shard | None = None,
    retry: Sequence[str] = (),
    signer: Signer | None = None,
    progress: ProgressCallback = lambda _summary: None,
) -> BatchSummary:
    """Solve the new sessions of a spool.

    The store is created if it does not exist. The jobs whose status is in `retry` are repeated.
    `progress` is called after each session.

    Raises:
        UsageError: the spool does not exist, or the store's folder contains other files.
        MachineError: the store cannot be used.
        InputError: its index is damaged, or it has a newer schema.
        KeyboardInterrupt: a person pressed Ctrl-C; finished sessions keep their rows.
    """
    listing, storage = scan_spool(spool), storage_at(store)
    create_store(storage)
    batch = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}-{secrets.token_hex(3)}"
    index, claims = StoreIndex(storage), BatchClaims(storage, batch)
    summary = BatchSummary(listing)
    with remember_interruption() as interruption, claims.begin_batch() as journal:
        index.merge_ended_batches()
        work = _new_work(listing, storage, settings, index, shard or Shard(), retry, summary)
        progress(summary)
        for is_second_pass in (False, True):
            jobs = _claimed_jobs(work, listing.storage, storage, batch, settings, claims, summary)
            _run_jobs(jobs, pools, journal, index, claims, summary, progress, interruption)
            workers_lost = any(pool.is_lost() for pool in pools)
            if is_second_pass or not summary.deferred or summary.gave_up or workers_lost:
                break
            work = _retry_deferred(work, claims, summary)
        _close_batch(storage, index, batch, signer, summary)
    return summary


def _retry_deferred(
    work: list[tuple[str, RecordedSession]], claims: BatchClaims, summary: BatchSummary
) -> list[tuple[str, RecordedSession]]:
    """Return the deferred jobs for a second attempt, after their claims are released."""
    retried = [(key, session) for key, session in work if key in summary.deferred_keys]
    summary.deferred_keys -= {key for key, _ in retried}
    summary.consecutive_deferrals = 0
    with contextlib.suppress(MachineError):
        for key, _ in retried:
            claims.release(key)
    return retried


def _close_batch(
    storage: Storage,
    index: StoreIndex,
    batch: str,
    signer: Signer | None,
    summary: BatchSummary,
) -> None:
    """Merge the rows into the index and write manifests; on an error the next batch does it."""
    try:
        index.merge_batch(batch)
        index.merge_ended_batches()
        write_manifests(storage, signer, summary.own_rows)
    except MachineError as fault:
        summary.unmerged_reason = str(fault)


def _new_work(
    listing: SpoolListing,
    store: Storage,
    settings: SolveSettings,
    index: StoreIndex,
    shard: Shard,
    retry: Sequence[str],
    summary: BatchSummary,
) -> list[tuple[str, RecordedSession]]:
    cache_file = store.cache_folder() / RECORDING_CACHE_FILE
    with RecordingCache(cache_file, listing.storage.location) as cache:
        known, unread = cache.split_known(listing)
        all_sessions = group_into_sessions(
            [*known, *cache.remember(read_recordings(listing.storage, unread))], listing.storage
        )
    finished_keys = index.finished_keys(retry)
    work: list[tuple[str, RecordedSession]] = []
    for session in all_sessions:
        key = job_key(session.digests, settings.solver_version, settings.config_sha256)
        summary.sessions += 1
        if key in finished_keys:
            summary.done_before += 1
        elif not shard.contains(key):
            summary.taken_by_others += 1
        elif session.read_error:  # of a bucket; the digest is unknown, so nothing is recorded
            summary.deferred_keys.add(key)
            summary.deferral_reason = session.read_error
        else:
            work.append((key, session))
    summary.to_do = len(work) + len(summary.deferred_keys)
    return work


def _claimed_jobs(
    work: Sequence[tuple[str, RecordedSession]],
    spool: Storage,
    store: Storage,
    batch: str,
    settings: SolveSettings,
    claims: BatchClaims,
    summary: BatchSummary,
) -> Iterator[Job]:
    for key, session in work:
        if summary.gave_up:
            return
        try:
            claimed = claims.try_claim(key)
        except MachineError as fault:
            _defer(summary, key, fault)
            continue
        if not claimed:
            summary.taken_by_others += 1
            summary.to_do -= 1
            continue
        paths = tuple(recording.path for recording in session.recordings)
        size = sum(recording.size for recording in session.recordings)
        yield Job(
            *(key, batch, store, spool, paths, session.digests, settings),
            rejection=session.rejection,
            remedy=session.remedy,
            input_bytes=size,
        )


def _run_jobs(
    jobs: Iterator[Job],
    pools: list[WorkerPool],
    journal: RowJournal,
    index: StoreIndex,
    claims: BatchClaims,
    summary: BatchSummary,
    progress: ProgressCallback,
    interruption: Interruption,
) -> None:
    for outcome in run_all(jobs, pools, interruption.check):
        try:
            if isinstance(outcome, DeferredJob):
                raise outcome.fault
            journal.add(outcome.rows)
            _count_result(outcome, summary)
            summary.own_rows += [row for row in outcome.rows if row.status == "ok"]
            summary.consecutive_deferrals = 0
            with contextlib.suppress(MachineError):  # the job has its rows, which is enough
                claims.mark_done(outcome.key)
            if journal.take_full():
                with contextlib.suppress(MachineError):  # it is merged later
                    index.merge_batch(journal.batch)
        except MachineError as fault:
            key = outcome.job.key if isinstance(outcome, DeferredJob) else outcome.key
            _defer(summary, key, fault)  # nothing of the job is recorded
        progress(summary)


def _defer(summary: BatchSummary, key: str, fault: MachineError) -> None:
    summary.deferred_keys.add(key)
    summary.consecutive_deferrals += 1
    summary.deferral_reason = str(fault)
    summary.gave_up |= summary.consecutive_deferrals >= GIVE_UP_AFTER_DEFERRALS


def _count_result(result: JobResult, summary: BatchSummary) -> None:
    statuses = [row.status for row in result.rows]
    summary.sessions_by_status[min(statuses, key=_WORST_FIRST.index)] += 1
    summary.boards_by_status.update(statuses)
    summary.unsuccessful_rows += [row for row in result.rows if row.status != "ok"]
    summary.joint_fit_failures += {
        f"{', '.join(row.names)}: {row.reason}"
        for row in result.rows
        if row.status == "ok" and row.reason
    }
