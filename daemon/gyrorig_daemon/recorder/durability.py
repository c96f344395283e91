"""What of the file being written is on the disk, and what would be gone with it.

What to use when: under `spool`. A disk that turns read-only keeps what was synced, and
nothing of what the system still had in memory; so the messages that are not synced yet
are kept here as well.
"""

import errno
import math
from collections import deque

from gyrorig_daemon.recorder.counts import RecorderCounts
from gyrorig_daemon.recorder.disk_worker import DiskWorker, Job
from gyrorig_daemon.recorder.ring import Record
from gyrorig_protocol.errors import MachineError
from gyrorig_protocol.recording.writer import RecordingWriter

LIMIT = 65_536  # five seconds of 16 boards at 800 Hz; of a slower disk, the newest
_MS_NS = 1_000_000


class Durability:
    """Syncs one file in the disk's thread, and remembers what is not synced."""

    def __init__(self, writer: RecordingWriter, worker: DiskWorker, counts: RecorderCounts) -> None:
        self._writer, self._worker, self._counts = writer, worker, counts
        self._records: deque[Record] = deque(maxlen=LIMIT)
        self._given = 0  # of all messages given to the file
        self._synced = 0  # of those, on the disk
        self.synced_bytes = writer.bytes_written  # at first the beginning
        self._job: Job[None] | None = None
        self._job_covers = (0, 0)  # messages and bytes

    @property
    def is_empty(self) -> bool:
        """Whether the file holds no message."""
        return self._given == 0

    @property
    def is_syncing(self) -> bool:
        """Whether a sync is under way, or its result not looked at."""
        return self._job is not None

    def add(self, record: Record) -> None:
        """One more message is given to the file."""
        self._records.append(record)
        self._given += 1

    def withdraw(self) -> None:
        """The last message was none."""
        self._records.pop()
        self._given -= 1

    def sync(self) -> None:
        """Have the disk's thread sync what is whole by now."""
        writer = self._writer
        self._job_covers = self._given - writer.waiting_messages, writer.bytes_written
        self._job = self._worker.submit(writer.sync)

    def look(self) -> OSError | None:
        """Take note of a sync that is done; return what went wrong with it."""
        job = self._job
        if job is None or not job.done:
            return None
        self._job = None
        counts, took_ms = self._counts, math.ceil(job.took_ns / _MS_NS)
        counts.syncs += 1
        counts.sync_last_ms = took_ms
        counts.sync_max_ms = max(counts.sync_max_ms, took_ms)
        if job.error is not None:
            # Whatever its number: nothing since the last sync is certain to be there.
            return OSError(errno.EIO, getattr(job.error, "strerror", None) or str(job.error))
        self._synced, self.synced_bytes = self._job_covers
        records = self._records
        while records and self._given - len(records) < self._synced:
            records.popleft()
        return None

    def give_up(self, fault: MachineError) -> tuple[deque[Record], bool]:
        """Let go of the file after an error.

        Returns:
            The messages that are not in it, or would be gone with the disk; and whether any
            other is left in it. Then it is cut back to those in the disk's thread; else
            that is the caller's to say.
        """
        writer = self._writer
        if _is_full(fault):  # what was written before is safe
            kept, position = self._given - writer.lost_messages, writer.bytes_written
        else:
            kept, position = self._synced, self.synced_bytes
        unknown = self._given - len(self._records)
        again = deque(list(self._records)[max(kept - unknown, 0) :])
        if kept:
            self._worker.submit(lambda: writer.salvage(position))
        return again, kept > 0


def _is_full(fault: MachineError) -> bool:
    cause = fault.__cause__
    return isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)
