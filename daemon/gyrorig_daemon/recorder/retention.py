"""Retention: which recordings may be deleted, oldest first, and never one that is cited.

What to use when: `apply_retention` from time to time, and when less than the reserve is free.
Nothing is deleted without a rule that a person has written. If it cannot be determined which
recordings a calibration cites (for example because a store is not mounted), nothing is
deleted.

Citations are found by digests and names anywhere in the documents of a store, without parsing
them. A damaged document, or one of a later version, still protects its recordings.
"""

import os
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.recorder.recovery import NOTE_SUFFIX, UNCLEAN_FOLDER, file_sha256
from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk, is_being_written

_DAY_S = 86_400.0
_DIGEST = re.compile(rb"[0-9a-f]{64}")
_NAME = re.compile(rb"[\w.+-]+\.mcap(?:\.part)?")
_DOCUMENTS = (".yaml", ".yml", ".json")
_LARGEST_DOCUMENT_BYTES = 16 << 20  # real documents have a few kB


@dataclass(frozen=True, slots=True)
class RetentionRules:
    """What may be deleted; without a rule, nothing."""

    max_days: float | None = None  # age relative to the newest recording
    max_bytes: int | None = None  # of all recordings together
    room_bytes: int | None = None  # until this much is free on the disk

    def __post_init__(self) -> None:
        """Reject rules that would delete everything by mistake.

        Raises:
            UsageError: a limit is not positive.
        """
        for name in ("max_days", "max_bytes", "room_bytes"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise UsageError(
                    f"the limit {name} for deleting old recordings is {value}, but it must be "
                    "above 0",
                    "correct the limit under `service` in the rig file",
                )


@dataclass(frozen=True, slots=True)
class RetentionResult:
    """What was deleted, and what was kept."""

    deleted: tuple[Path, ...]
    deleted_bytes: int
    cited: tuple[Path, ...]  # kept only because a calibration cites them


@dataclass(frozen=True, slots=True)
class _File:
    path: Path
    size: int
    time_s: float  # of the last change


def apply_retention(
    folder: Path,
    rules: RetentionRules,
    stores: Sequence[Path],
    keep: Collection[Path] = (),
    *,
    now_s: float | None = None,
    disk: Disk = DISK,
) -> RetentionResult:
    """Delete what the rules allow, oldest first.

    Args:
        folder: of recordings; finished recordings and originals in `unclean/` can be deleted.
        rules: what may be deleted.
        stores: folders of calibrations, whose citations protect recordings; each one must
            exist. Empty: there are no calibrations.
        keep: recordings of the running session.
        now_s: present system time; None if it is not valid: then the rule of age is not used.
        disk: where all this happens.

    Raises:
        MachineError: a store or the folder cannot be read; nothing was deleted then.
    """
    names = {path.name for path in keep}
    files = [file for file in _files(folder) if file.path.name not in names]
    need = _RetentionNeed(rules, files, now_s, lambda: disk.free_bytes(folder))
    if not files or not need.asks_for(files[0]):
        return RetentionResult((), 0, ())
    citations = _CitationIndex(stores)
    deleted: list[_File] = []
    cited_paths: list[Path] = []
    for file in files:
        if not need.asks_for(file):
            break
        if citations.protects(file.path):
            cited_paths.append(file.path)
            continue
        _delete(file.path, disk)
        deleted.append(file)
        need.note_deleted(file)
    if deleted:
        disk.sync_directory(folder)
    return RetentionResult(
        tuple(file.path for file in deleted),
        sum(file.size for file in deleted),
        tuple(cited_paths),
    )


class _RetentionNeed:
    """Which rules still ask for deletions, as files are deleted."""

    def __init__(
        self,
        rules: RetentionRules,
        files: Sequence[_File],
        now_s: float | None,
        free_bytes: Callable[[], int],
    ) -> None:
        self._rules = rules
        self._free_bytes = free_bytes
        self._total = sum(file.size for file in files)
        # Age relative to the newest recording, not to now: a clock that jumps ahead, or a rig
        # that was unused for a year, must not delete recordings. Nor must one recording that
        # was made while the clock was years ahead.
        self._oldest_s: float | None = None
        if rules.max_days is not None and now_s is not None:
            newest_s = min(max((file.time_s for file in files), default=0.0), now_s)
            self._oldest_s = newest_s - rules.max_days * _DAY_S

    def asks_for(self, oldest: _File) -> bool:
        """Whether a rule asks for the oldest file to be deleted."""
        rules = self._rules
        if self._oldest_s is not None and oldest.time_s < self._oldest_s:
            return True
        if rules.max_bytes is not None and self._total > rules.max_bytes:
            return True
        return rules.room_bytes is not None and self._free_bytes() < rules.room_bytes

    def note_deleted(self, file: _File) -> None:
        """Account for a deleted file."""
        self._total -= file.size


class _CitationIndex:
    """The digests and names in the documents of all stores."""

    def __init__(self, stores: Sequence[Path]) -> None:
        self._digests: set[str] = set()
        self._names: set[str] = set()
        for store in stores:
            if not store.is_dir():
                raise MachineError(
                    f"the calibration store {store} does not exist. The daemon deletes no old "
                    "recordings, because it cannot check which of them the calibrations in this "
                    "store need",
                    "mount the disk of the store, or remove the store from `service: stores` in "
                    "the rig file",
                )
            try:
                for document in _documents(store):
                    self._read_document(document)
            except OSError as fault:
                raise MachineError(
                    f"the daemon cannot read {fault.filename or store} in the calibration store "
                    f"({fault.strerror}). It deletes no old recordings, because it cannot check "
                    "which of them the calibrations in this store need",
                    "give the user of the daemon permission to read the store, or remove the store "
                    "from `service: stores` in the rig file",
                ) from fault

    def protects(self, path: Path) -> bool:
        """Whether a calibration was made from this file."""
        return path.name in self._names or _digest(path) in self._digests

    def _read_document(self, document: Path) -> None:
        if document.stat().st_size > _LARGEST_DOCUMENT_BYTES:
            raise MachineError(
                f"the file {document} in the store is too large for a calibration (more than "
                f"{_LARGEST_DOCUMENT_BYTES / 1e6:.0f} MB)",
                "move the file out of the store",
            )
        text = document.read_bytes()
        self._digests.update(match.decode() for match in _DIGEST.findall(text))
        self._names.update(match.decode() for match in _NAME.findall(text))


def _documents(store: Path) -> Iterator[Path]:
    """Every document in a store, also through links; OSError if one cannot be read."""

    def refuse(fault: OSError) -> None:
        raise fault

    visited: set[str] = set()
    for folder, subfolders, names in os.walk(store, onerror=refuse, followlinks=True):
        real = os.path.realpath(folder)
        if real in visited:  # links in a circle
            subfolders.clear()
            continue
        visited.add(real)
        yield from (Path(folder, name) for name in names if name.endswith(_DOCUMENTS))


def _files(folder: Path) -> list[_File]:
    """Everything that can be deleted, oldest first."""
    files = []
    try:
        for path in (*folder.glob("*.mcap"), *(folder / UNCLEAN_FOLDER).glob("*.mcap.part")):
            if path.is_file() and not path.is_symlink() and not is_being_written(path):
                status = path.stat()
                files.append(_File(path, status.st_size, status.st_mtime))
    except OSError as fault:
        raise MachineError(
            f"the folder {folder} cannot be read ({fault.strerror})",
            f"check the permissions of the folder with `ls -ld {folder}`, and check its disk",
        ) from fault
    return sorted(files, key=lambda file: (file.time_s, file.path.name))


def _delete(path: Path, disk: Disk) -> None:
    note = path.with_name(path.name + NOTE_SUFFIX)
    try:
        disk.unlink(path)
        if note.exists():
            disk.unlink(note)
    except OSError as fault:
        raise MachineError(
            f"the old recording {path} cannot be deleted ({fault.strerror})",
            "give the folder to the user of the daemon with chown. The daemon continues to record",
        ) from fault


def _digest(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as fault:
        raise MachineError(
            f"the old recording {path} cannot be read ({fault.strerror}). The daemon does not "
            "delete it, because without its SHA-256 it cannot check whether a calibration needs it",
            "give the user of the daemon permission to read the file, or check the disk",
        ) from fault
