"""Tracks which messages of the open file are synced to the disk.

What to use when: under `part_writer`. A disk that becomes read-only keeps what was synced and
loses what the system had in memory. Therefore messages that are not synced are kept here, too.
"""

import errno
import math
import time
from collections import deque
from collections.abc import Callable
from concurrent import futures
from concurrent.futures import Future
from pathlib import Path
from typing import TypeVar

from gyrorig_daemon.recorder.disk_worker import DiskWorker
from gyrorig_daemon.recorder.ram_buffer import Record
from gyrorig_daemon.recorder.recorder_counts import RecorderCounts
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.writer import RecordingWriter

MAX_UNSYNCED_RECORDS = 65_536  # five seconds of 16 boards at 800 Hz; with a slower disk, the newest
_MS_NS = 1_000_000

T = TypeVar("T")


class SyncTracker:
    """Syncs one file in the disk thread and keeps the messages that are not synced."""

    def __init__(self, writer: RecordingWriter, worker: DiskWorker, counts: RecorderCounts) -> None:
        self._writer, self._worker, self._counts = writer, worker, counts
        self._records: deque[Record] = deque(maxlen=MAX_UNSYNCED_RECORDS)
        self._written_count = 0  # messages written to the file
        self._synced_count = 0  # of those, on the disk
        self.synced_bytes = writer.bytes_written  # initially the header of the file
        self._job: Future[None] | None = None
        self._job_extent = (0, 0)  # messages and bytes
        self._sync_ns = 0  # duration of the last sync

    @property
    def is_empty(self) -> bool:
        """Whether the file has no messages."""
        return self._written_count == 0

    @property
    def is_syncing(self) -> bool:
        """Whether a sync is in progress, or its result not collected."""
        return self._job is not None

    def add(self, record: Record) -> None:
        """Add a message that is written to the file."""
        self._records.append(record)
        self._written_count += 1

    def remove_last(self) -> None:
        """Remove the last message, which was not valid."""
        self._records.pop()
        self._written_count -= 1

    def sync(self) -> None:
        """Sync what is complete by now, in the disk thread."""
        writer = self._writer
        self._job_extent = self._written_count - writer.waiting_messages, writer.bytes_written
        self._job = self._worker.submit(self._sync_file)

    def _sync_file(self) -> None:
        start_ns = time.monotonic_ns()
        try:
            self._writer.sync()
        finally:
            # In simulated time, the same seed must give the same bytes.
            self._sync_ns = time.monotonic_ns() - start_ns if self._worker.threaded else 0

    def wait(self) -> None:
        """Wait until the sync in progress has ended."""
        if self._job is not None:
            futures.wait([self._job])

    def poll_sync(self) -> OSError | None:
        """Collect the result of a finished sync; return its error."""
        job = self._job
        if job is None or not job.done():
            return None
        self._job = None
        counts, duration_ms = self._counts, math.ceil(self._sync_ns / _MS_NS)
        counts.syncs += 1
        counts.sync_last_ms = duration_ms
        counts.sync_max_ms = max(counts.sync_max_ms, duration_ms)
        if (error := job.exception()) is not None:
            # Whatever the error number, data since the last sync may be lost.
            return OSError(errno.EIO, getattr(error, "strerror", None) or str(error))
        self._synced_count, self.synced_bytes = self._job_extent
        records = self._records
        while records and self._written_count - len(records) < self._synced_count:
            records.popleft()
        return None

    def salvage_after_fault(self, fault: MachineError) -> tuple[deque[Record], bool]:
        """Abandon the file after an error.

        Returns:
            The messages that are not in the file, or would be lost with the disk; and whether any
            others are left in it. If so, the disk thread cuts the file back to those; otherwise
            the caller decides what to do with the file.
        """
        writer = self._writer
        if _is_full(fault) and not self.is_syncing:  # earlier data is safe
            kept_count, position = self._written_count - writer.lost_messages, writer.bytes_written
        else:
            kept_count, position = self._synced_count, self.synced_bytes
        forgotten_count = self._written_count - len(self._records)
        unsaved = deque(list(self._records)[max(kept_count - forgotten_count, 0) :])
        cut_count = max(forgotten_count - kept_count, 0)
        if kept_count:
            risk_count = kept_count - self._synced_count
            self._run_last_step(lambda: writer.truncate_and_close(position), risk_count, cut_count)
        elif cut_count:
            self._run_last_step(lambda: None, 0, cut_count)
        return unsaved, kept_count > 0

    def close_file(self) -> Future[Path]:
        """Close the completely written file in the disk thread."""
        return self._run_last_step(self._writer.close, self._written_count - self._synced_count)

    def _run_last_step(
        self, step: Callable[[], T], risk_count: int, cut_count: int = 0
    ) -> Future[T]:
        """Run a step in the disk thread, and count the messages that are lost.

        Args:
            step: closes the file.
            risk_count: messages that are lost if the sync of the step fails.
            cut_count: messages that the step removes, and that are not in memory.
        """

        def run() -> T:
            try:
                return step()
            finally:
                is_failed = self._writer.has_failed_sync
                self._counts.dropped_unsynced += cut_count + (risk_count if is_failed else 0)

        return self._worker.submit(run)


def _is_full(fault: MachineError) -> bool:
    cause = fault.__cause__
    return isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)
