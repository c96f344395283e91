"""Counters of a recorder: what became of the messages, losses by cause, and the disk.

What to use when: `RecorderCounts.values()` for diagnostics, status and metrics. The names are
part of the interface.
"""

from dataclasses import dataclass, fields


@dataclass(slots=True)
class RecorderCounts:
    """Counters since the recorder was created, except where a comment says otherwise."""

    written: int = 0  # messages written to a file
    dropped_queue_full: int = 0  # the writer was too slow
    dropped_too_early: int = 0  # too many messages before the file was open
    dropped_from_memory: int = 0  # older than the buffer in memory can hold
    dropped_at_close: int = 0  # in memory when the session ended and the disk still failed
    dropped_unsynced: int = 0  # of a file whose last sync failed, or too many since the last sync
    refused: int = 0  # out of order on their topic
    queue_high_water: int = 0
    memory_messages: int = 0  # in memory now, because the disk fails
    memory_bytes: int = 0  # now
    memory_high_water_bytes: int = 0
    parts_opened: int = 0
    parts_closed: int = 0
    rotations: int = 0
    rotations_postponed: int = 0  # the next part could not be opened: the present one is continued
    disk_faults: int = 0  # errors after which a file was abandoned
    open_failures: int = 0
    close_failures: int = 0  # the file stays a `.part`, to be recovered
    room_stops: int = 0  # stops because less than the reserve was free
    resumes: int = 0
    syncs: int = 0
    sync_last_ms: int = 0
    sync_max_ms: int = 0
    disk_busy_ms: int = 0  # how long the disk thread has worked on its present job
    disk_busy_max_ms: int = 0
    bytes_written: int = 0  # of all parts
    free_bytes: int = -1  # on the disk at the last check; -1: never checked

    @property
    def lost(self) -> int:
        """Messages that are in no file and will not be."""
        return (
            self.dropped_queue_full
            + self.dropped_too_early
            + self.dropped_from_memory
            + self.dropped_at_close
            + self.dropped_unsynced
            + self.refused
        )

    def update_memory(self, messages: int, size_bytes: int, dropped: int) -> None:
        """Set what is in memory now, and what it dropped so far."""
        self.memory_messages, self.memory_bytes = messages, size_bytes
        self.memory_high_water_bytes = max(self.memory_high_water_bytes, size_bytes)
        self.dropped_from_memory = dropped

    def update_disk(self, busy_ns: int) -> None:
        """Set how long the disk thread has worked on its present job."""
        self.disk_busy_ms = busy_ns // 1_000_000
        self.disk_busy_max_ms = max(self.disk_busy_max_ms, self.disk_busy_ms)

    def values(self) -> dict[str, int]:
        """Every counter by name, and `lost`."""
        return {counter.name: getattr(self, counter.name) for counter in fields(self)} | {
            "lost": self.lost
        }
