"""Part files: metadata and attachments are repeated, so that each part is self-contained.

What to use when: under `part_writer`. `PartOpener` creates parts; `NextPart` has the next one
created in the disk thread; `PartCloser` has those that are closed there; `SpaceCheck` asks there
for the free space; `part_path` names them; `SessionMetadata` is their metadata and attachments. The
session state at the start of a part comes from `state_replay`.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent import futures
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.recorder.disk_worker import DiskWorker
from gyrorig_daemon.recorder.recorder_counts import RecorderCounts
from gyrorig_daemon.recorder.recorder_settings import RecorderSettings, RecordingPlan
from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_protocol.recording.mcap.disk_file import Disk
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter

MetadataRecords = dict[str, dict[str, str]]


def part_path(first: Path, number: int) -> Path:
    """Return the path of a part; `recording_order` sorts the parts."""
    return first if number == 0 else first.with_name(f"{first.stem}_p{number:03d}.mcap")


class SessionMetadata:
    """Metadata and attachments of a session; they can grow."""

    def __init__(
        self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment]
    ) -> None:
        self._metadata: list[tuple[str, dict[str, str]]] = [
            (name, dict(record)) for name, record in metadata.items()
        ]
        self._attachments = list(attachments)
        self._lock = threading.Lock()  # parts are opened in another thread
        self._additions: list[tuple[MetadataRecords, tuple[Attachment, ...]]] = []
        self._written_version = 0  # of the open part

    @property
    def version(self) -> int:
        """Number of additions."""
        return len(self._additions)

    def add(
        self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment]
    ) -> None:
        """Add metadata and attachments."""
        added = {name: dict(record) for name, record in metadata.items()}
        with self._lock:
            self._additions.append((added, tuple(attachments)))

    def set_written(self, version: int) -> None:
        """Note that the open part has the first `version` additions."""
        self._written_version = version

    def take_new(self) -> tuple[MetadataRecords, list[Attachment]]:
        """Return the additions that the open part does not have; it has them from now on."""
        metadata, attachments = self._added_since(self._written_version)
        self._written_version = self.version
        return metadata, attachments

    def _added_since(self, version: int) -> tuple[MetadataRecords, list[Attachment]]:
        """Return what was added after the first `version` additions."""
        metadata: MetadataRecords = {}
        attachments: list[Attachment] = []
        for added, files in self._additions[version:]:
            metadata |= added
            attachments += files
        return metadata, attachments

    def for_part(self, number: int, previous: str) -> tuple[int, MetadataRecords, list[Attachment]]:
        """Return the version, and all metadata and attachments for the start of a part."""
        with self._lock:
            version = self.version
            metadata = dict(self._metadata)
            added, files = self._added_since(0)
        metadata = {name: dict(record) for name, record in (metadata | added).items()}
        if number:
            metadata["gyrorig"] |= {"part": str(number), "previous": previous}
        return version, metadata, [*self._attachments, *files]


@dataclass(frozen=True, slots=True)
class OpenedPart:
    """A part that was just created."""

    writer: RecordingWriter
    number: int
    previous: str  # file name of the part before it
    metadata_version: int  # version of the metadata in it


class PartOpener:
    """Creates the parts of one session; its methods can be as slow as the disk."""

    def __init__(
        self,
        plan: RecordingPlan,
        settings: RecorderSettings,
        disk: Disk,
        make_room: Callable[[], object] | None,
    ) -> None:
        self._first_path, self._settings = plan.path, settings
        self._disk, self._make_room = disk, make_room
        self.session_metadata = SessionMetadata(plan.metadata, plan.attachments)

    def open(self, number: int, previous: str, room_bytes: int) -> OpenedPart:
        """Create a part.

        Args:
            number: number of the part.
            previous: file name of the part before it, empty for the first.
            room_bytes: must be free, if there is a reserve.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk fails, or has too little free space.
        """
        if self._settings.reserve_bytes and self.free_bytes(room_bytes) < room_bytes:
            raise MachineError(
                f"the folder {self._first_path.parent} has less than {room_bytes >> 20} MiB "
                "of free space",
                "free some disk space. The daemon then resumes the recording automatically",
            )
        version, metadata, attachments = self.session_metadata.for_part(number, previous)
        path = part_path(self._first_path, number)
        # The session waits for the first part, and a busy disk can take seconds to sync it
        # (measured). Later parts are opened in advance.
        lasting = number > 0
        writer = RecordingWriter(
            path, metadata, attachments, disk=self._disk, owner_syncs=True, sync_at_start=lasting
        )
        return OpenedPart(writer, number, previous, version)

    def free_bytes(self, wanted_bytes: int) -> int:
        """Return the free space; make room first if it is less than wanted.

        Raises:
            MachineError: the disk does not report it.
        """
        free_bytes = self._free_bytes()
        if free_bytes < wanted_bytes and self._make_room is not None:
            with suppress(GyrorigError, OSError):  # then the space stays as it is
                self._make_room()
            free_bytes = self._free_bytes()
        return free_bytes

    def _free_bytes(self) -> int:
        folder = self._first_path.parent
        try:
            return self._disk.free_bytes(folder)
        except OSError as fault:
            raise MachineError(
                f"the folder {folder} cannot be read ({fault.strerror})",
                f"check the permissions of the folder with `ls -ld {folder}`, and check its disk",
            ) from fault


class NextPart:
    """The part that follows the open one, opened in the disk thread."""

    def __init__(self, worker: DiskWorker, opener: PartOpener) -> None:
        self._worker, self._opener = worker, opener
        self._job: Future[OpenedPart] | None = None

    @property
    def is_opening(self) -> bool:
        """Whether a part is being opened or can be taken."""
        return self._job is not None

    def open(self, number: int, previous: str, room_bytes: int) -> None:
        """Start to open a part; see `PartOpener.open`."""
        self._job = self._worker.submit(lambda: self._opener.open(number, previous, room_bytes))

    def wait(self) -> None:
        """Wait until it is open or has failed."""
        if self._job is not None:
            futures.wait([self._job])

    def take(self, previous: str) -> OpenedPart | BaseException | None:
        """Return the part or the error, once; None while it is being opened.

        A part that does not follow the part `previous` is discarded: the one that it follows was
        empty, and does not exist any more.
        """
        job = self._job
        if job is None or not job.done():
            return None
        self._job = None
        if (fault := job.exception()) is not None:
            return fault
        part = job.result()
        if part.previous == previous:
            return part
        self._worker.submit(part.writer.discard)
        return None

    def discard(self) -> None:
        """Discard a part that is being opened: it would be empty."""
        job, self._job = self._job, None
        if job is not None and job.exception() is None:  # it waits for the end of the job
            self._worker.submit(job.result().writer.discard)


class SpaceCheck:
    """Asks for the free space in the disk thread, one question at a time."""

    def __init__(self, worker: DiskWorker, opener: PartOpener) -> None:
        self._worker, self._opener = worker, opener
        self._job: Future[int] | None = None

    @property
    def is_running(self) -> bool:
        """Whether an answer is outstanding."""
        return self._job is not None

    def start(self, wanted_bytes: int) -> None:
        """Ask; room is made first if less is free than wanted."""
        self._job = self._worker.submit(lambda: self._opener.free_bytes(wanted_bytes))

    def take_answer(self) -> int | None:
        """Return the free bytes once they are known, None before or if the disk failed."""
        job = self._job
        if job is None or not job.done():
            return None
        self._job = None
        return job.result() if job.exception() is None else None


class PartCloser:
    """The files that the disk thread closes and gives their final names."""

    MAX_WAITING = 4  # with more files waiting the disk hardly works

    def __init__(self, counts: RecorderCounts) -> None:
        self._counts = counts
        self._jobs: list[Future[Path]] = []

    @property
    def is_full(self) -> bool:
        """Whether no more files should be added."""
        return len(self._jobs) >= self.MAX_WAITING

    def add(self, job: Future[Path]) -> None:
        """Add a file that the disk thread closes."""
        self._jobs.append(job)

    def count_finished(self) -> None:
        """Count the files that are closed."""
        for job in [job for job in self._jobs if job.done()]:
            self._jobs.remove(job)
            if job.exception() is None:
                self._counts.parts_closed += 1
            else:
                self._counts.close_failures += 1

    def finish(self) -> Path | None:
        """Wait for all files; return the path of the last one, None if there were none.

        Raises:
            MachineError: the last one could not be closed.
        """
        jobs = list(self._jobs)
        futures.wait(jobs)
        self.count_finished()
        return jobs[-1].result() if jobs else None
