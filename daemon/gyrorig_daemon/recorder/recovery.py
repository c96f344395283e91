"""What a crash has left in a folder of recordings, made into finished recordings.

What to use when: `recover_folder` at every start, before a session begins; it may run in
a thread or a process of its own, at any time, twice, and be killed at any moment.

What becomes of a `.part` that nobody writes any more:

    finished, only not renamed   renamed
    sound up to some byte        everything sound goes into a new file under the final
                                 name, once mcap's own reader has gone through it; the
                                 original is kept in `unclean/`, and a note beside it
                                 names both files by digest, as the new file's metadata does
    nothing whole in it          kept in `unclean/` as it is

Nothing is appended to an unclean file, ever, and none is deleted here.
"""

import contextlib
import hashlib
import json
import os
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from gyrorig_protocol.errors import GyrorigError, InputError, MachineError
from gyrorig_protocol.recording.disk_file import DISK, Disk, abandoned, held
from gyrorig_protocol.recording.salvage import (
    RECOVERED,
    is_finished,
    metadata_of,
    read_strictly,
    salvage,
)

UNCLEAN = "unclean"  # the folder for originals, below that of the recordings
NOTE = ".json"  # what was made of an original, beside it
_HALF = ".recovering"  # of a file that is being made; never read, and deleted when found
_DIGESTED_BYTES = 1 << 20


class Outcome(Enum):
    """What became of an unfinished file."""

    RECOVERED = "recovered"
    RENAMED = "renamed"  # it was finished
    EMPTY = "empty"  # no whole message in it
    FAILED = "failed"  # it stays where it is, for the next start


@dataclass(frozen=True, slots=True)
class Recovery:
    """What became of one unfinished file, in one line and in numbers."""

    original: Path  # where it is now
    outcome: Outcome
    recording: Path | None  # the finished file
    messages: int
    lost_bytes: int
    text: str


def recover_folder(folder: Path, reserve_bytes: int = 0, disk: Disk = DISK) -> list[Recovery]:
    """Make finished recordings of all that nobody writes any more.

    Args:
        folder: of recordings; there need be none.
        reserve_bytes: must stay free on the disk; what does not fit waits.
        disk: where all this happens.

    Returns:
        One report an unfinished file, in the order of their names. Nothing is raised for
        a single file.

    Raises:
        MachineError: the folder cannot be looked at.
    """
    try:
        if not folder.is_dir():
            return []
        for half in abandoned(folder, f"*{_HALF}"):
            with contextlib.suppress(FileNotFoundError):  # another process was faster
                disk.unlink(half)
        parts = abandoned(folder, "*.mcap.part")
    except OSError as fault:
        raise MachineError(
            f"cannot look at {folder}: {fault.strerror}", f"see `ls -ld {folder}`, and its disk"
        ) from fault
    found = (_recover_one(part, reserve_bytes, disk) for part in parts)
    return [recovery for recovery in found if recovery is not None]


def _recover_one(part: Path, reserve_bytes: int, disk: Disk) -> Recovery | None:
    """Recover one file; None where another process does so at this moment."""
    try:
        with held(part) as free:
            return _recover(part, reserve_bytes, disk) if free else None
    except FileNotFoundError:  # another process has just done it
        return None
    except GyrorigError as fault:
        return Recovery(part, Outcome.FAILED, None, 0, 0, f"{part.name}: {fault}")
    except OSError as fault:
        why = f"{fault.strerror or fault}: mend the disk or its rights; {_again(part)}"
        text = f"{part.name}: {why}"
        return Recovery(part, Outcome.FAILED, None, 0, 0, text)


def _recover(part: Path, reserve_bytes: int, disk: Disk) -> Recovery:
    size = part.stat().st_size
    digest = _digest(part)
    final = part.with_suffix("")  # without `.part`
    if done := _recovery_of(final, digest):
        return _report(_set_aside(part, digest, done, disk), done)
    if size and is_finished(part) and not disk.exists(final):
        disk.rename(part, final)
        disk.sync_directory(final.parent)
        text = f"{final.name} was finished, and has its name now"
        return Recovery(final, Outcome.RENAMED, final, 0, 0, text)
    if size + reserve_bytes > disk.free_bytes(part.parent):
        raise MachineError(
            f"too little room to recover it: {(size + reserve_bytes) / 1e6:.1f} MB have to be free",
            f"make room; {_again(part)}",
        )
    half = final.with_name(final.name + _HALF)
    about = {"original": part.name, "original_sha256": digest}
    try:
        salvaged = salvage(part, half, about, disk)
    except InputError as fault:
        aside = _set_aside(part, digest, None, disk)
        return Recovery(aside, Outcome.EMPTY, None, 0, size, f"{part.name}: {fault.what}")
    try:
        if read_strictly(half) != salvaged.messages:
            raise InputError(
                f"{half.name}, read back, holds not what was copied from {part.name}",
                "the disk may be failing: copy its folder elsewhere and run gyrorigd recover there",
            )
        if disk.exists(final):
            final = final.with_name(f"{final.stem}_recovered.mcap")
            if disk.exists(final):
                raise MachineError(
                    f"not recovered: {final} is there already and holds something else",
                    f"move that away; {_again(part)}",
                )
        disk.rename(half, final)
    except BaseException:
        if disk.exists(half):
            disk.unlink(half)
        raise
    disk.sync_directory(final.parent)
    return _report(_set_aside(part, digest, final, disk), final)


def _again(part: Path) -> str:
    return f"the daemon's next start, or gyrorigd recover {part.parent}, tries again"


def _report(original: Path, final: Path) -> Recovery:
    told = metadata_of(final)[RECOVERED]
    messages, lost = int(told["messages"]), int(told["lost_bytes"])
    text = f"{final.name}: {messages} messages recovered, {lost} bytes at its end were no use"
    return Recovery(original, Outcome.RECOVERED, final, messages, lost, text)


def _recovery_of(final: Path, digest: str) -> Path | None:
    """The finished file that was made of the original with this digest, if there is one."""
    for path in (final, final.with_name(f"{final.stem}_recovered.mcap")):
        try:
            told = metadata_of(path).get(RECOVERED, {})
        except GyrorigError:
            continue
        if told.get("original_sha256") == digest:
            return path
    return None


def _set_aside(part: Path, digest: str, final: Path | None, disk: Disk) -> Path:
    """Move an original to `unclean/`, with a note of what was made of it; return its place."""
    folder = part.parent / UNCLEAN
    folder.mkdir(exist_ok=True)
    aside = folder / part.name
    if aside.exists():  # of another file of that name
        aside = folder / f"{digest[:12]}_{part.name}"
    note = {"original": part.name, "original_sha256": digest}
    if final is not None:
        note |= {"recovered": final.name, "recovered_sha256": _digest(final)}
    _write_note(aside.with_name(aside.name + NOTE), note)
    disk.rename(part, aside)
    disk.sync_directory(folder)
    disk.sync_directory(part.parent)
    return aside


def _write_note(path: Path, note: dict[str, str]) -> None:
    with path.open("w") as file:
        json.dump(note, file, indent=1)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_DIGESTED_BYTES):
            digest.update(block)
    return digest.hexdigest()
