"""Recovery after a crash: unfinished files become finished recordings.

What to use when: `recover_folder` at every start, before a session begins. It can run in a
thread or in another process, at any time, twice, and can be killed at any moment.

What happens to a `.part` file that nobody writes:

    finished, only not renamed   it is renamed
    undamaged up to some byte    everything undamaged is copied to a new file with the final
                                 name, after mcap's own reader has read it. The original is
                                 kept in `unclean/`; a note next to it names both files by
                                 digest, and so does the metadata of the new file
    no complete message          it is kept in `unclean/`

An unclean file is never appended to, and never deleted here.
"""

import contextlib
import hashlib
import json
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.errors import GyrorigError, InputError, MachineError, sentence
from gyrorig_protocol.recording.mcap.disk_file import DISK, Disk, hold_lock, list_abandoned_files
from gyrorig_protocol.recording.salvage import (
    RECOVERED_RECORD,
    is_finished,
    read_file_metadata,
    read_strictly,
    salvage,
)

UNCLEAN_FOLDER = "unclean"  # the folder for originals, inside the folder of recordings
NOTE_SUFFIX = ".json"  # the note next to an original
_PARTIAL_SUFFIX = ".recovering"  # suffix of a file in progress; never read, and deleted when found


class RecoveryOutcome(Enum):
    """What happened to an unfinished file."""

    RECOVERED = "recovered"
    RENAMED = "renamed"  # it was finished
    EMPTY = "empty"  # no complete message in it
    FAILED = "failed"  # it stays where it is, for the next start


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What happened to one unfinished file, as text and in numbers."""

    original: Path  # where it is now
    outcome: RecoveryOutcome
    recording: Path | None  # the finished file
    messages: int
    lost_bytes: int
    text: str


def recover_folder(folder: Path, reserve_bytes: int = 0, disk: Disk = DISK) -> list[RecoveryReport]:
    """Recover all unfinished files that nobody writes.

    Args:
        folder: folder of recordings; it need not exist.
        reserve_bytes: must stay free on the disk; files that do not fit are left for later.
        disk: where all this happens.

    Returns:
        One report per unfinished file, in the order of their names. A single file raises no
        error.

    Raises:
        MachineError: the folder cannot be read.
    """
    try:
        if not folder.is_dir():
            return []
        for partial in list_abandoned_files(folder, f"*{_PARTIAL_SUFFIX}"):
            _delete_abandoned(partial, disk)
        parts = list_abandoned_files(folder, "*.mcap.part")
    except OSError as fault:
        raise MachineError(
            f"the folder {folder} cannot be read ({fault.strerror})",
            f"check the permissions of the folder with `ls -ld {folder}`, and check its disk",
        ) from fault
    reports = (_recover_locked(part, reserve_bytes, disk) for part in parts)
    return [recovery for recovery in reports if recovery is not None]


def _delete_abandoned(partial: Path, disk: Disk) -> None:
    """Delete a file in progress, unless another process is recovering its original.

    Its own lock is not sufficient: it is released before the file is verified.
    """
    part = partial.with_name(partial.name.removesuffix(_PARTIAL_SUFFIX) + ".part")
    with contextlib.suppress(FileNotFoundError):  # another process was faster
        if not part.exists():
            disk.unlink(partial)
            return
        with hold_lock(part) as is_free:
            if is_free:
                disk.unlink(partial)


def _recover_locked(part: Path, reserve_bytes: int, disk: Disk) -> RecoveryReport | None:
    """Recover one file; None if another process is recovering it."""
    try:
        with hold_lock(part) as is_free:
            return _recover_part(part, reserve_bytes, disk) if is_free else None
    except FileNotFoundError:  # another process has just recovered it
        return None
    except GyrorigError as fault:
        return RecoveryReport(part, RecoveryOutcome.FAILED, None, 0, 0, f"{part.name}: {fault}")
    except OSError as fault:
        reason = f"{fault.strerror or fault}. Check the disk and its permissions."
        text = f"{part.name}: {reason} {sentence(_retry_hint(part))}"
        return RecoveryReport(part, RecoveryOutcome.FAILED, None, 0, 0, text)


def _recover_part(part: Path, reserve_bytes: int, disk: Disk) -> RecoveryReport:
    size = part.stat().st_size
    digest = file_sha256(part)
    final = part.with_suffix("")  # without `.part`
    if finished := _find_recovery(final, digest):
        return _recovered_report(_set_aside(part, digest, finished, disk), finished)
    if size and is_finished(part) and not disk.exists(final):
        disk.rename(part, final)
        disk.sync_directory(final.parent)
        text = f"{final.name} was complete, so it only had to be renamed"
        return RecoveryReport(final, RecoveryOutcome.RENAMED, final, 0, 0, text)
    if size + reserve_bytes > disk.free_bytes(part.parent):
        raise MachineError(
            f"the recovery of the recording needs {(size + reserve_bytes) / 1e6:.1f} MB of "
            "free disk space",
            f"free some disk space. {sentence(_retry_hint(part))}",
        )
    partial = final.with_name(final.name + _PARTIAL_SUFFIX)
    origin = {"original": part.name, "original_sha256": digest}
    try:
        salvaged = salvage(part, partial, origin, disk)
    except InputError as fault:
        original = _set_aside(part, digest, None, disk)
        return RecoveryReport(
            original, RecoveryOutcome.EMPTY, None, 0, size, f"{part.name}: {fault.problem}"
        )
    try:
        if read_strictly(partial) != salvaged.messages:
            raise InputError(
                f"the copy {partial.name} differs from the data that were read from {part.name}",
                "copy the folder to another disk and run gyrorigd recover there, because "
                "the present disk may be failing",
            )
        if disk.exists(final):
            final = final.with_name(f"{final.stem}_recovered.mcap")
            if disk.exists(final):
                raise MachineError(
                    f"the recording was not recovered, because {final} already exists with "
                    "other content",
                    f"move {final.name} to another folder. {sentence(_retry_hint(part))}",
                )
        disk.rename(partial, final)
    except BaseException:
        if disk.exists(partial):
            disk.unlink(partial)
        raise
    disk.sync_directory(final.parent)
    return _recovered_report(_set_aside(part, digest, final, disk), final)


def _retry_hint(part: Path) -> str:
    return (
        "the daemon tries again at its next start, as does the command gyrorigd recover "
        f"{part.parent}"
    )


def _recovered_report(original: Path, final: Path) -> RecoveryReport:
    metadata = read_file_metadata(final)[RECOVERED_RECORD]
    messages, lost = int(metadata["messages"]), int(metadata["lost_bytes"])
    text = f"{final.name}: {messages} messages recovered; {lost} damaged bytes are lost"
    return RecoveryReport(original, RecoveryOutcome.RECOVERED, final, messages, lost, text)


def _find_recovery(final: Path, digest: str) -> Path | None:
    """Return the finished file that was made from the original with this digest, if any."""
    for path in (final, final.with_name(f"{final.stem}_recovered.mcap")):
        try:
            metadata = read_file_metadata(path).get(RECOVERED_RECORD, {})
        except GyrorigError:
            continue
        if metadata.get("original_sha256") == digest:
            return path
    return None


def _set_aside(part: Path, digest: str, final: Path | None, disk: Disk) -> Path:
    """Move an original to `unclean/` with a note of what was made of it; return its new path."""
    folder = part.parent / UNCLEAN_FOLDER
    folder.mkdir(exist_ok=True)
    target = folder / part.name
    if target.exists():  # of another file with that name
        target = folder / f"{digest[:12]}_{part.name}"
    note = {"original": part.name, "original_sha256": digest}
    if final is not None:
        note |= {"recovered": final.name, "recovered_sha256": file_sha256(final)}
    write_atomically(
        target.with_name(target.name + NOTE_SUFFIX), json.dumps(note, indent=1).encode() + b"\n"
    )
    disk.rename(part, target)
    disk.sync_directory(folder)
    disk.sync_directory(part.parent)
    return target


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
