"""What each part of a recording has to say again, so that it stands alone.

What to use when: under `spool`. `PartOpener` opens them, in the disk's thread;
`Closing` has them closed there; `part_path` names them; `Facts` are their metadata and
attachments. What a part begins in the middle of, `restating` knows.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.recorder.counts import RecorderCounts
from gyrorig_daemon.recorder.disk_worker import DiskWorker, Job
from gyrorig_daemon.recorder.settings import RecorderSettings, RecordingPlan
from gyrorig_protocol.errors import GyrorigError, MachineError
from gyrorig_protocol.recording.disk_file import Disk
from gyrorig_protocol.recording.writer import Attachment, RecordingWriter

Records = dict[str, dict[str, str]]


def part_path(first: Path, number: int) -> Path:
    """The name of a part; parts sort behind each other by their names."""
    return first if number == 0 else first.with_name(f"{first.stem}_p{number:03d}.mcap")


class Facts:
    """Metadata and attachments of a session, which may grow."""

    def __init__(
        self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment]
    ) -> None:
        self._metadata: list[tuple[str, dict[str, str]]] = [
            (name, dict(record)) for name, record in metadata.items()
        ]
        self._attachments = list(attachments)
        self._lock = threading.Lock()  # parts are opened by another thread
        self._later: list[tuple[Records, tuple[Attachment, ...]]] = []

    @property
    def version(self) -> int:
        """How often they have grown."""
        return len(self._later)

    def add(
        self, metadata: Mapping[str, Mapping[str, str]], attachments: Sequence[Attachment]
    ) -> None:
        """Take in more."""
        more = {name: dict(record) for name, record in metadata.items()}
        with self._lock:
            self._later.append((more, tuple(attachments)))

    def since(self, version: int) -> tuple[Records, list[Attachment]]:
        """What came behind the first `version` additions."""
        metadata: Records = {}
        attachments: list[Attachment] = []
        for more, files in self._later[version:]:
            metadata |= more
            attachments += files
        return metadata, attachments

    def of_part(self, number: int, previous: str) -> tuple[int, Records, list[Attachment]]:
        """Everything that a part begins with, and the version that this is."""
        with self._lock:
            version = self.version
            metadata = dict(self._metadata)
            more, files = self.since(0)
        metadata = {name: dict(record) for name, record in (metadata | more).items()}
        if number:
            metadata["gyrorig"] |= {"part": str(number), "previous": previous}
        return version, metadata, [*self._attachments, *files]


@dataclass(frozen=True, slots=True)
class OpenedPart:
    """A part that has just been created."""

    writer: RecordingWriter
    number: int
    facts: int  # version of the facts that are in it


class PartOpener:
    """Opens the parts of one session; its methods may take as long as the disk does."""

    def __init__(
        self,
        plan: RecordingPlan,
        settings: RecorderSettings,
        disk: Disk,
        make_room: Callable[[], object] | None,
    ) -> None:
        self._first, self._settings = plan.path, settings
        self._disk, self._make_room = disk, make_room
        self.facts = Facts(plan.metadata, plan.attachments)

    def open(self, number: int, previous: str, room_bytes: int) -> OpenedPart:
        """Create a part.

        Args:
            number: of the part.
            previous: name of the part before it, empty for the first.
            room_bytes: that must be free, where anything is held in reserve.

        Raises:
            UsageError: a file of that name exists.
            MachineError: the disk refuses, or has too little room.
        """
        if self._settings.reserve_bytes and self.free_bytes(room_bytes) < room_bytes:
            raise MachineError(
                f"less than {room_bytes >> 20} MiB are free in {self._first.parent}",
                "make room: recording begins again by itself",
            )
        version, metadata, attachments = self.facts.of_part(number, previous)
        path = part_path(self._first, number)
        # The session waits for the first one, and a loaded disk may take seconds to sync it
        # (measured); the others are opened ahead of need.
        lasting = number > 0
        writer = RecordingWriter(
            path, metadata, attachments, disk=self._disk, aside=True, lasting=lasting
        )
        return OpenedPart(writer, number, version)

    def free_bytes(self, wanted_bytes: int) -> int:
        """What is free, after making room where that is less than wanted.

        Raises:
            MachineError: the disk does not say.
        """
        free = self._free_bytes()
        if free < wanted_bytes and self._make_room is not None:
            with suppress(GyrorigError, OSError):  # then there is no more room than there is
                self._make_room()
            free = self._free_bytes()
        return free

    def _free_bytes(self) -> int:
        folder = self._first.parent
        try:
            return self._disk.free_bytes(folder)
        except OSError as fault:
            raise MachineError(
                f"cannot look at {folder}: {fault.strerror}", f"see `ls -ld {folder}`, and its disk"
            ) from fault


class Closing:
    """Files in which nothing is left to be written, on their way to their final names."""

    LIMIT = 4  # that wait; with more the disk hardly works at all

    def __init__(self, worker: DiskWorker, counts: RecorderCounts) -> None:
        self._worker, self._counts = worker, counts
        self._jobs: list[Job[Path]] = []

    @property
    def is_full(self) -> bool:
        """Whether no more should be handed over."""
        return len(self._jobs) >= self.LIMIT

    def add(self, writer: RecordingWriter) -> None:
        """Have a file closed in the disk's thread."""
        self._jobs.append(self._worker.submit(writer.close))

    def look(self) -> None:
        """Count those that are closed."""
        for job in [job for job in self._jobs if job.done]:
            self._jobs.remove(job)
            if job.error is None:
                self._counts.parts_closed += 1
            else:
                self._counts.close_failures += 1

    def finish(self) -> Path | None:
        """Wait for all; the name of the last one, None where none was left.

        Raises:
            MachineError: the last one could not be closed.
        """
        jobs = list(self._jobs)
        for job in jobs:
            job.wait()
        self.look()
        return jobs[-1].result() if jobs else None
