"""Which recordings may go, oldest first, and never one that a calibration cites.

What to use when: `tidy` now and then, and when less than the reserve is free. Nothing is
deleted without a rule that a person has written; and where it cannot be seen what is
cited (a store that is not mounted tonight), nothing at all.

Citations are found by their digests and names anywhere in a store's documents, without
understanding those: a document that is damaged, or of a version to come, still protects.
"""

import hashlib
import os
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.recorder.recovery import NOTE, UNCLEAN
from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.recording.disk_file import DISK, Disk, is_being_written

_DAY_S = 86_400.0
_DIGEST = re.compile(rb"[0-9a-f]{64}")
_NAME = re.compile(rb"[\w.+-]+\.mcap(?:\.part)?")
_DOCUMENTS = (".yaml", ".yml", ".json")
_DIGESTED_BYTES = 1 << 20
_LARGEST_DOCUMENT_BYTES = 16 << 20  # real ones have a few kB


@dataclass(frozen=True, slots=True)
class RetentionRules:
    """What may be deleted; without a rule, nothing."""

    max_days: float | None = None  # older than the newest recording by more than this
    max_bytes: int | None = None  # of all recordings together
    room_bytes: int | None = None  # until this much is free on the disk

    def __post_init__(self) -> None:
        """Refuse what would delete everything by mistake.

        Raises:
            UsageError: a limit is not positive.
        """
        for name in ("max_days", "max_bytes", "room_bytes"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise UsageError(f"retention: {name} is {value}", "give a number above 0")


@dataclass(frozen=True, slots=True)
class Tidied:
    """What was deleted, and what could not be."""

    deleted: tuple[Path, ...]
    deleted_bytes: int
    cited: tuple[Path, ...]  # would have gone, but a calibration cites them
    left_bytes: int  # of all recordings that are still there


@dataclass(frozen=True, slots=True)
class _File:
    path: Path
    size: int
    time_s: float  # of the last change


def tidy(
    folder: Path,
    rules: RetentionRules,
    stores: Sequence[Path],
    keep: Collection[Path] = (),
    *,
    clock_is_sound: bool = True,
    disk: Disk = DISK,
) -> Tidied:
    """Delete what the rules allow, oldest first.

    Args:
        folder: of recordings; finished ones, and originals in `unclean/`, may go.
        rules: what may be deleted.
        stores: folders of calibrations, whose citations are sacred; every one must be
            there. Empty: there are no calibrations.
        keep: recordings of the session that is running.
        clock_is_sound: whether the wall clock could be trusted when the recordings were
            made; without, age is no reason.
        disk: where all this happens.

    Raises:
        MachineError: a store or the folder cannot be read; nothing was deleted then.
    """
    names = {path.name for path in keep}
    files = [one for one in _files(folder) if one.path.name not in names]
    surplus = _Surplus(rules, files, clock_is_sound, lambda: disk.free_bytes(folder))
    if not files or not surplus.is_any(files[0]):
        return Tidied((), 0, (), sum(one.size for one in files))
    cited = _Cited(stores)
    deleted: list[_File] = []
    kept: list[Path] = []
    for one in files:
        if not surplus.is_any(one):
            break
        if cited.protects(one.path):
            kept.append(one.path)
            continue
        _delete(one.path, disk)
        deleted.append(one)
        surplus.took(one)
    if deleted:
        disk.sync_directory(folder)
    gone = sum(one.size for one in deleted)
    paths = tuple(one.path for one in deleted)
    return Tidied(paths, gone, tuple(kept), sum(one.size for one in files) - gone)


class _Surplus:
    """How much there is too much, as files go."""

    def __init__(
        self,
        rules: RetentionRules,
        files: Sequence[_File],
        clock_is_sound: bool,
        free_bytes: Callable[[], int],
    ) -> None:
        self._rules = rules
        self._free_bytes = free_bytes
        self._total = sum(one.size for one in files)
        # Age against the newest, not against now: a clock that jumps ahead, or a rig that
        # rested for a year, must not cost what is there.
        newest_s = max((one.time_s for one in files), default=0.0)
        days = rules.max_days if clock_is_sound else None
        self._oldest_s = None if days is None else newest_s - days * _DAY_S

    def is_any(self, oldest: _File) -> bool:
        """Whether a rule asks for the oldest file to go."""
        rules = self._rules
        if self._oldest_s is not None and oldest.time_s < self._oldest_s:
            return True
        if rules.max_bytes is not None and self._total > rules.max_bytes:
            return True
        return rules.room_bytes is not None and self._free_bytes() < rules.room_bytes

    def took(self, one: _File) -> None:
        """A file is gone."""
        self._total -= one.size


class _Cited:
    """The digests and names that the documents of all stores hold."""

    def __init__(self, stores: Sequence[Path]) -> None:
        self._digests: set[str] = set()
        self._names: set[str] = set()
        for store in stores:
            if not store.is_dir():
                raise MachineError(
                    f"the store {store} is not there, and nothing is deleted without it",
                    "mount it, or take it out of service: stores in the rig's configuration",
                )
            try:
                for document in _documents(store):
                    self._take(document)
            except OSError as fault:
                raise MachineError(
                    f"cannot read {fault.filename or store}: {fault.strerror}, and nothing is "
                    "deleted without it",
                    "mend its rights, or take it out of service: stores in the rig's configuration",
                ) from fault

    def protects(self, path: Path) -> bool:
        """Whether a calibration was made of this file."""
        return path.name in self._names or _digest(path) in self._digests

    def _take(self, document: Path) -> None:
        if document.stat().st_size > _LARGEST_DOCUMENT_BYTES:
            raise MachineError(
                f"{document} is too large to be a calibration "
                f"(beyond {_LARGEST_DOCUMENT_BYTES / 1e6:.0f} MB)",
                "move it out of the store",
            )
        text = document.read_bytes()
        self._digests.update(found.decode() for found in _DIGEST.findall(text))
        self._names.update(found.decode() for found in _NAME.findall(text))


def _documents(store: Path) -> Iterator[Path]:
    """Every document below a store, through links too; OSError where one cannot be seen."""

    def refuse(fault: OSError) -> None:
        raise fault

    seen: set[str] = set()
    for folder, below, names in os.walk(store, onerror=refuse, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen:  # links that lead round in a circle
            below.clear()
            continue
        seen.add(real)
        yield from (Path(folder, name) for name in names if name.endswith(_DOCUMENTS))


def _files(folder: Path) -> list[_File]:
    """Everything that may ever go, oldest first."""
    found = []
    try:
        for path in (*folder.glob("*.mcap"), *(folder / UNCLEAN).glob("*.mcap.part")):
            if path.is_file() and not path.is_symlink() and not is_being_written(path):
                status = path.stat()
                found.append(_File(path, status.st_size, status.st_mtime))
    except OSError as fault:
        raise MachineError(
            f"cannot look at {folder}: {fault.strerror}", f"see `ls -ld {folder}`, and its disk"
        ) from fault
    return sorted(found, key=lambda one: (one.time_s, one.path.name))


def _delete(path: Path, disk: Disk) -> None:
    note = path.with_name(path.name + NOTE)
    try:
        disk.unlink(path)
        if note.exists():
            disk.unlink(note)
    except OSError as fault:
        raise MachineError(
            f"cannot delete {path}: {fault.strerror}",
            "give its folder to the user that the daemon runs as (chown); recording goes on",
        ) from fault


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_DIGESTED_BYTES):
                digest.update(block)
    except OSError as fault:
        raise MachineError(
            f"cannot read {path}: {fault.strerror}",
            "nothing is deleted that may be cited: mend its rights, or its disk",
        ) from fault
    return digest.hexdigest()
