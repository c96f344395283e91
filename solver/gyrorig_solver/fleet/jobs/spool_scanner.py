"""Spool scanner: the recordings of a spool folder or bucket, grouped by session.

What to use when: `scan_spool` once, at the start of a batch; `group_into_sessions` for the jobs.
The parts of one session are solved together, so they are one job. Files that are still being
written (`.mcap.part`) are counted and left alone, because the daemon finishes or recovers them.
Until then, or for a day, the parts before them wait too. Names and sizes do not identify a
recording; its SHA-256 does. A recording in a bucket is fetched only while it is read.
"""

import hashlib
import json
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath

from gyrorig_protocol.errors import GyrorigError, MachineError, UsageError
from gyrorig_protocol.recording.reader import read_recording_metadata
from gyrorig_solver.storage import Folder, Storage, StorageEntry, storage_at
from gyrorig_solver.storage.bucket import Bucket

UNREAD_PREFIX = "unread:"  # in place of a digest
SET_ASIDE_FOLDER = "unclean"  # the daemon's originals of recovered recordings
_BLOCK_BYTES = 1 << 20
READER_THREADS = 4  # hashlib releases Python's lock
_CONFLICT_REMEDY = "remove the wrong one, and run the batch with --retry rejected"
_PART_SUFFIX = re.compile(r"(_p\d{3,})?\.mcap(\.part)?$")  # names of the daemon's recorder
ABANDONED_AFTER_S = 86_400.0  # a part lasts one hour at most, so its writer is gone


@dataclass(frozen=True, slots=True)
class SpooledRecording:
    """One recording of a spool."""

    path: PurePosixPath  # below the spool
    sha256: str
    session: str  # rig, name and start; "" if its head cannot be read
    part: str = ""
    size: int = 0
    change_tag: str = ""  # differs when the file has changed
    read_error: str = ""  # why the storage did not deliver it

    @property
    def has_known_start(self) -> bool:
        """Whether the session has the time of day of its start; an import has only its name."""
        return not self.session.endswith(', "0"]')


@dataclass(frozen=True, slots=True)
class RecordedSession:
    """The parts of one session, which are solved together."""

    recordings: tuple[SpooledRecording, ...]
    rejection: str = ""  # why they must not be solved
    remedy: str = ""  # of the rejection

    @property
    def read_error(self) -> str:
        """Why the session cannot be read now; "" if it can."""
        return next(
            (recording.read_error for recording in self.recordings if recording.read_error), ""
        )

    @property
    def digests(self) -> tuple[str, ...]:
        """Sorted SHA-256 digests, so that the order of names does not matter."""
        return tuple(sorted(recording.sha256 for recording in self.recordings))


@dataclass(frozen=True, slots=True)
class SpoolListing:
    """The recordings of a spool."""

    storage: Storage
    recordings: tuple[StorageEntry, ...]
    unfinished: int = 0
    waiting_parts: int = 0  # finished parts of sessions that are still being written
    abandoned: int = 0  # unfinished ones that have not changed for a day


def scan_spool(spool: Path | Storage) -> SpoolListing:
    """Return the recordings of a spool, sorted by name.

    Raises:
        UsageError: the folder or the bucket does not exist.
        MachineError: the bucket does not answer.
    """
    storage = storage_at(spool)
    if isinstance(storage, Folder) and not storage.path.is_dir():
        is_file = storage.path.exists()
        raise UsageError(
            f"the spool {storage.location} is a file, not a folder"
            if is_file
            else f"the spool folder {storage.location} does not exist",
            "choose a folder with recordings with --spool",
        )
    recordings: list[StorageEntry] = []
    unfinished_stems: set[str] = set()
    unfinished = abandoned = 0
    for entry in storage.list_files():
        if SET_ASIDE_FOLDER in entry.name.split("/")[:-1]:
            continue
        if entry.name.endswith(".mcap.part"):
            unfinished += 1
            if 0.0 < entry.modified_s < time.time() - ABANDONED_AFTER_S:
                abandoned += 1
            else:
                unfinished_stems.add(_session_stem(entry.name))
        elif entry.name.endswith(".mcap"):
            recordings.append(entry)
    if isinstance(storage, Folder):
        # A worker rejects each with its reason, as it does for a file that cannot be read.
        recordings += [
            StorageEntry(name, 0, "", 0.0)
            for name in storage.dangling_links()
            if name.endswith(".mcap") and SET_ASIDE_FOLDER not in name.split("/")[:-1]
        ]
    is_empty = not (recordings or unfinished)
    if is_empty and isinstance(storage, Bucket) and not storage.exists():
        raise UsageError(
            f"the bucket of the spool {storage.location} does not exist",
            "choose a bucket with recordings with --spool",
        )
    complete = [entry for entry in recordings if _session_stem(entry.name) not in unfinished_stems]
    complete.sort(key=lambda entry: PurePosixPath(entry.name))
    return SpoolListing(
        storage, tuple(complete), unfinished, len(recordings) - len(complete), abandoned
    )


def _session_stem(name: str) -> str:
    """Return the part of a file name that all parts of a session share."""
    return _PART_SUFFIX.sub("", name)


def group_into_sessions(
    recordings: Iterable[SpooledRecording], storage: Storage | None = None
) -> list[RecordedSession]:
    """Return the sessions of these recordings, each with its parts in the order of names.

    The parts of a session are in one folder: what another folder contains, which can be of another
    person, changes nothing. Two recordings with the same bytes count once. One whose head cannot be
    read is a separate session, so that it is rejected with its reason. If two recordings in one
    folder claim to be the same part, the shorter one is a copy if the other one begins with its
    bytes. Otherwise nobody knows which one is right, and the session is rejected. Imports of the
    same name are different sessions, because an import has one part and no time of its start.

    Args:
        recordings: of one spool.
        storage: the spool, to compare such recordings; None: they are copies.
    """
    parts_by_session: dict[str, dict[str, SpooledRecording]] = {}
    conflicts: dict[str, str] = {}
    single_sessions: list[RecordedSession] = []
    seen_digests: set[str] = set()
    for recording in sorted(recordings, key=lambda recording: (-recording.size, recording.path)):
        if recording.sha256 in seen_digests:
            continue
        seen_digests.add(recording.sha256)
        session = f"{recording.path.parent}:{recording.session}"
        parts = parts_by_session.setdefault(session, {}) if recording.session else {}
        if recording.part in parts:
            whole = parts[recording.part]
            if _is_beginning(recording, whole, storage):
                # A partial copy next to the complete part would count its samples twice.
                reason = f"{recording.path.name} is a shorter copy of {whole.path.name}"
                remedy = "remove the shorter copy from the spool"
            elif not recording.has_known_start:
                reason = remedy = ""  # files of the same name, from different folders
            else:
                reason = (
                    f"{recording.path.name} and {whole.path.name} differ, but both claim to be the "
                    "same part of one session"
                )
                remedy = _CONFLICT_REMEDY
                conflicts[session] = reason
            single_sessions.append(RecordedSession((recording,), reason, remedy))
        elif recording.session:
            parts[recording.part] = recording
        else:
            single_sessions.append(RecordedSession((recording,)))
    whole_sessions = (
        (tuple(sorted(parts.values(), key=_by_path)), conflicts.get(session, ""))
        for session, parts in parts_by_session.items()
    )
    part_sessions = [
        RecordedSession(parts, reason, _CONFLICT_REMEDY if reason else "")
        for parts, reason in whole_sessions
    ]
    return sorted(
        [*part_sessions, *single_sessions], key=lambda session: session.recordings[0].path
    )


def _is_beginning(
    recording: SpooledRecording, whole: SpooledRecording, storage: Storage | None
) -> bool:
    """Return whether the larger recording begins with the bytes of the other one."""
    if storage is None:
        return True
    try:
        with storage.local_copy(str(whole.path)) as path, path.open("rb") as file:
            digest, remaining = hashlib.sha256(), recording.size
            while remaining > 0 and (data := file.read(min(remaining, _BLOCK_BYTES))):
                digest.update(data)
                remaining -= len(data)
    except (OSError, GyrorigError):
        return False
    return digest.hexdigest() == recording.sha256


def _by_path(recording: SpooledRecording) -> PurePosixPath:
    return recording.path


def read_recordings(
    storage: Storage, entries: Sequence[StorageEntry]
) -> Iterator[SpooledRecording]:
    """Yield the recordings in the order of entries; several are read at a time."""
    with ThreadPoolExecutor(READER_THREADS, "digest") as readers:
        yield from readers.map(partial(read_spooled, storage), entries)


def read_spooled(storage: Storage, entry: StorageEntry) -> SpooledRecording:
    """Return digest and session of a recording. Never raises: the worker reports errors."""
    name = PurePosixPath(entry.name)
    try:
        with storage.local_copy(entry.name) as path:
            digest, size = _digest(path), path.stat().st_size
            try:
                metadata = read_recording_metadata(path).get("gyrorig", {})
            except GyrorigError:
                return SpooledRecording(name, digest, "", size=size, change_tag=entry.change_tag)
    except MachineError as fault:
        return SpooledRecording(name, f"{UNREAD_PREFIX}{entry.name}", "", read_error=str(fault))
    except (OSError, GyrorigError):
        return SpooledRecording(name, f"{UNREAD_PREFIX}{entry.name}", "")
    names = [metadata.get(key, "") for key in ("rig", "session", "anchor_utc_ns")]
    session = json.dumps(names) if any(names) else ""
    return SpooledRecording(name, digest, session, metadata.get("part", ""), size, entry.change_tag)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
