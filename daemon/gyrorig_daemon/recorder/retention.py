"""Retention: which recordings may be deleted, oldest first, and never one that is cited.

What to use when: `apply_retention` from time to time, and when less than the reserve is free.
Nothing is deleted without a rule that a person has written. If it cannot be determined which
recordings a calibration cites (for example because a store is not mounted), nothing is
deleted. `retention_memory` has what was seen at the last check.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gyrorig_daemon.recorder.citation_index import CitationIndex, check_citation_counts
from gyrorig_daemon.recorder.recovery import NOTE_SUFFIX, UNCLEAN_FOLDER
from gyrorig_daemon.recorder.retention_memory import (
    RetentionMemory,
    read_memory,
    write_memory,
)
from gyrorig_protocol.errors import MachineError, UsageError
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk, is_being_written
from gyrorig_protocol.recording.recording_metadata import recording_order

_DAY_S = 86_400.0


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
    name: str  # relative to the folder
    changed_s: float  # time of the last change
    time_s: float = math.inf  # not older than this; infinite: not yet seen with a valid clock

    @property
    def order(self) -> tuple[float, float, tuple[str, int, str]]:
        """The oldest file has the smallest value."""
        return self.time_s, self.changed_s, recording_order(self.path)


def apply_retention(
    folder: Path,
    rules: RetentionRules,
    stores: Sequence[Path],
    keep: Collection[Path] = (),
    *,
    memory_path: Path,
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
        memory_path: file with what was seen at the last check.
        now_s: present system time; None if it is not valid: then the rule of age is not used.
        disk: where all this happens.

    Raises:
        MachineError: a store or the folder cannot be read, or a store has lost all citations;
            nothing was deleted then.
    """
    previous = read_memory(memory_path)
    all_files = _files(folder)
    memory = previous.with_files([file.name for file in all_files], now_s)
    citations = CitationIndex(stores)
    check_citation_counts(citations.counts, previous, memory_path)
    memory = memory.with_citations(citations.counts)
    if memory != previous:
        write_memory(memory_path, memory)
    names = {path.name for path in keep}
    files = sorted(
        (_dated(file, memory) for file in all_files if file.path.name not in names),
        key=lambda file: file.order,
    )
    need = _RetentionNeed(rules, files, now_s, lambda: disk.free_bytes(folder))
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


def _dated(file: _File, memory: RetentionMemory) -> _File:
    """Return the file with its time: that of its last change if it was not first seen later."""
    first_seen_s = memory.first_seen_s.get(file.name, math.inf)
    return replace(file, time_s=max(file.changed_s, first_seen_s))


def _files(folder: Path) -> list[_File]:
    """Everything that can be deleted."""
    files = []
    try:
        for path in (*folder.glob("*.mcap"), *(folder / UNCLEAN_FOLDER).glob("*.mcap.part")):
            if path.is_file() and not path.is_symlink() and not is_being_written(path):
                status = path.stat()
                name = str(path.relative_to(folder))
                files.append(_File(path, status.st_size, name, status.st_mtime))
    except OSError as fault:
        raise MachineError(
            f"the folder {folder} cannot be read ({fault.strerror})",
            f"check the permissions of the folder with `ls -ld {folder}`, and check its disk",
        ) from fault
    return files


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
