"""Where recordings go: whether it can be written, how fast, and how much fits.

What to use when: `examine_disk` for findings and `Disk`, which `tonight` reckons with. The
test writes a few megabytes into a file of its own and takes it away again; nothing else in
the folder is touched.
"""

import contextlib
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system import System

SUBJECT = "disk"
TRIAL_BYTES = 256 * 1024  # about what a rig of 16 boards writes in a second
TRIALS = 8
SLOW_SYNC_S = 0.2  # a second of data must be on the disk well within a second
STUCK_SYNC_S = 1.0
FORGETFUL = ("tmpfs", "ramfs", "overlay")
ONE_COPY = ("vfat", "exfat", "msdos")
FEW_INODES = 1000


@dataclass(frozen=True, slots=True)
class Disk:
    """A place for recordings, measured."""

    folder: Path
    free_bytes: int
    write_bytes_s: float  # with every piece synced


def examine_disk(folder: Path, system: System) -> tuple[list[Finding], Disk | None]:
    """Return what is to be said of the disk under `folder`; None where it takes nothing."""
    place = _existing(folder)
    kind, options = _mount(place, system)
    if "ro" in options.split(","):
        return [_read_only(place)], None
    if not os.access(place, os.W_OK):
        why = f"this user may not write in {place}"
        remedy = f"sudo chown $USER {place}, or name another than {folder} with --out"
        return [fault(SUBJECT, "not_writable", why, remedy)], None
    room = os.statvfs(place)
    free_bytes = room.f_bavail * room.f_frsize
    try:
        spent_s = [_trial(place) for _ in range(TRIALS)]
    except OSError as failure:
        why = f"a trial of {TRIAL_BYTES // 1024} kB in {place} failed: {failure.strerror}"
        remedy = "move recordings away to make room; where there is room, dmesg says what is wrong"
        return [fault(SUBJECT, "trial_failed", why, remedy)], None
    disk = Disk(place, free_bytes, TRIAL_BYTES * TRIALS / max(sum(spent_s), 1e-9))
    found = [*_kind(place, kind), *_speed(disk, spent_s)]
    if room.f_files > 0 and room.f_favail < FEW_INODES:
        found.append(
            fault(
                SUBJECT,
                "inodes",
                f"{place} takes only {room.f_favail} more files",
                f"move old recordings and results away; at least {FEW_INODES} should be free",
            )
        )
    return found, disk


def _existing(folder: Path) -> Path:
    """Return the folder, or the nearest one above it that is there."""
    place = folder.absolute()
    while not place.is_dir() and place != place.parent:
        place = place.parent
    return place


def _mount(place: Path, system: System) -> tuple[str, str]:
    """Return the kind and the options of the file system that `place` is on."""
    best, kind, options = -1, "", ""
    for line in (system.text("/proc/mounts") or "").splitlines():
        words = line.split()
        if len(words) < 4:
            continue
        point = words[1].replace("\\040", " ")
        inside = str(place) == point or str(place).startswith(point.rstrip("/") + "/")
        if inside and len(point) >= best:
            best, kind, options = len(point), words[2], words[3]
    return kind, options


def _read_only(place: Path) -> Finding:
    return fault(
        SUBJECT,
        "read_only",
        f"{place} is mounted read-only: a dying card is set so by the kernel",
        "look at dmesg; copy what is on it, and put another one in",
    )


def _trial(place: Path) -> float:
    """Write a piece, sync it, and return how long that took."""
    with tempfile.NamedTemporaryFile(dir=place, prefix=".gyrorig-trial-") as file:
        data = os.urandom(TRIAL_BYTES)  # what a compressing disk cannot make smaller
        begun = time.monotonic()
        file.write(data)
        file.flush()
        os.fdatasync(file.fileno())
        return time.monotonic() - begun


def _kind(place: Path, kind: str) -> list[Finding]:
    if kind in FORGETFUL:
        return [
            note(
                SUBJECT,
                "not_kept",
                f"{place} is on {kind}: what is recorded there may be gone after a restart",
                "let recordings go to a real disk",
            )
        ]
    if kind in ONE_COPY:
        return [
            warning(
                SUBJECT,
                "no_journal",
                f"{place} is on {kind}: a power cut can damage files that were finished",
                "use ext4 for recordings",
            )
        ]
    return []


def _speed(disk: Disk, spent_s: list[float]) -> list[Finding]:
    slowest_s, usual_s = max(spent_s), sorted(spent_s)[len(spent_s) // 2]
    says = (
        f"{disk.write_bytes_s * 1e-6:.1f} MB/s with every 256 kB synced, "
        f"{usual_s * 1e3:.0f} ms each, {slowest_s * 1e3:.0f} ms the slowest"
    )
    if usual_s > STUCK_SYNC_S:
        return [fault(SUBJECT, "too_slow", says, "use another disk: this one loses data")]
    if slowest_s > SLOW_SYNC_S:
        return [
            warning(SUBJECT, "slow", says, "use an SSD: until then a power cut costs more data")
        ]
    return [ok(SUBJECT, "speed", says)]


def remove_old_trials(folder: Path) -> None:
    """Take away what an examination that was killed has left."""
    with contextlib.suppress(OSError):
        for path in folder.glob(".gyrorig-trial-*"):
            path.unlink(missing_ok=True)
