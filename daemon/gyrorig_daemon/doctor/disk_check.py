"""Checks of the disk for recordings: permissions, file system, write speed, free space.

What to use when: `check_disk` for findings, and for the `DiskMeasurement` that
`capacity_forecast` needs. The test writes a few megabytes into a temporary file; nothing else in
the folder changes.
"""

import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system_files import SystemFiles

SUBJECT = "disk"
TEST_BYTES = 256 * 1024  # about what a rig with 16 boards writes per second
TEST_WRITES = 8
SLOW_SYNC_S = 0.2  # one second of data must be on the disk well within a second
FAILING_SYNC_S = 1.0
VOLATILE_FILE_SYSTEMS = ("tmpfs", "ramfs", "overlay")
UNJOURNALED_FILE_SYSTEMS = ("vfat", "exfat", "msdos")
MIN_FREE_INODES = 1000


@dataclass(frozen=True, slots=True)
class DiskMeasurement:
    """A folder for recordings, measured."""

    folder: Path
    free_bytes: int
    write_bytes_s: float  # with a sync after every write


def check_disk(folder: Path, system: SystemFiles) -> tuple[list[Finding], DiskMeasurement | None]:
    """Return the findings about the disk of `folder`; None if it cannot be written."""
    existing = _nearest_existing(folder)
    file_system, options = _mount_of(existing, system)
    if "ro" in options.split(","):
        message = (
            f"the disk of {existing} is mounted read-only. The kernel does this when a "
            "memory card fails"
        )
        remedy = "run `dmesg` to find the reason, copy the data, and replace the card"
        return [fault(SUBJECT, "read_only", message, remedy)], None
    if not os.access(existing, os.W_OK):
        message = f"the present user cannot write to the folder {existing}"
        remedy = (
            f"run `sudo chown $USER {existing}`, or choose another folder than {folder} with --out"
        )
        return [fault(SUBJECT, "not_writable", message, remedy)], None
    statistics = os.statvfs(existing)
    try:
        write_times_s = [_timed_write(existing) for _ in range(TEST_WRITES)]
    except OSError as error:
        message = (
            f"a test write of {TEST_BYTES // 1024} kB to the folder {existing} failed "
            f"({error.strerror})"
        )
        remedy = (
            "if the disk is full, move recordings to another disk. Otherwise run `dmesg` to find "
            "the fault of the disk"
        )
        return [fault(SUBJECT, "trial_failed", message, remedy)], None
    write_bytes_s = TEST_BYTES * TEST_WRITES / max(sum(write_times_s), 1e-9)
    disk = DiskMeasurement(existing, statistics.f_bavail * statistics.f_frsize, write_bytes_s)
    findings = [*_check_file_system(existing, file_system), *_check_speed(disk, write_times_s)]
    if statistics.f_files > 0 and statistics.f_favail < MIN_FREE_INODES:
        message = (
            f"the file system of {existing} can hold only {statistics.f_favail} more files (inodes)"
        )
        remedy = f"move old files to another disk until at least {MIN_FREE_INODES} inodes are free"
        findings.append(fault(SUBJECT, "inodes", message, remedy))
    return findings, disk


def _nearest_existing(folder: Path) -> Path:
    """Return the folder, or the nearest existing folder above it."""
    existing = folder.absolute()
    while not existing.is_dir() and existing != existing.parent:
        existing = existing.parent
    return existing


def _mount_of(path: Path, system: SystemFiles) -> tuple[str, str]:
    """Return the type and the mount options of the file system of `path`."""
    best_length, file_system, options = -1, "", ""
    for line in (system.read_text("/proc/mounts") or "").splitlines():
        fields = line.split()
        if len(fields) < 4:
            continue
        mount_point = fields[1].replace("\\040", " ")
        is_inside = str(path) == mount_point or str(path).startswith(mount_point.rstrip("/") + "/")
        if is_inside and len(mount_point) >= best_length:
            best_length, file_system, options = len(mount_point), fields[2], fields[3]
    return file_system, options


def _timed_write(folder: Path) -> float:
    """Write and sync a block, and return the time that took."""
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".gyrorig-trial-") as file:
        data = os.urandom(TEST_BYTES)  # not compressible
        start_s = time.monotonic()
        file.write(data)
        file.flush()
        os.fdatasync(file.fileno())
        return time.monotonic() - start_s


def _check_file_system(path: Path, file_system: str) -> Iterator[Finding]:
    if file_system in VOLATILE_FILE_SYSTEMS:
        message = (
            f"the folder {path} is on the file system {file_system}, which does not keep files "
            "permanently. Recordings in this folder can be lost at a restart"
        )
        yield note(SUBJECT, "not_kept", message, "record to a folder on a disk")
    elif file_system in UNJOURNALED_FILE_SYSTEMS:
        message = (
            f"the folder {path} is on the file system {file_system}, so a power cut can damage "
            "even complete files"
        )
        yield warning(SUBJECT, "no_journal", message, "record to a folder on an ext4 file system")


def _check_speed(disk: DiskMeasurement, write_times_s: list[float]) -> Iterator[Finding]:
    slowest_s, median_s = max(write_times_s), sorted(write_times_s)[len(write_times_s) // 2]
    summary = (
        f"the disk writes {disk.write_bytes_s * 1e-6:.1f} MB/s if all data are synced to it every "
        f"256 kB. The median of the sync times is {median_s * 1e3:.0f} ms, and the longest is "
        f"{slowest_s * 1e3:.0f} ms"
    )
    if median_s > FAILING_SYNC_S:
        yield fault(
            SUBJECT,
            "too_slow",
            f"{summary}. This disk is too slow, so recordings lose data",
            "record to another disk",
        )
    elif slowest_s > SLOW_SYNC_S:
        message = f"{summary}. This disk is slow, so a power cut loses more data"
        yield warning(SUBJECT, "slow", message, "record to a faster disk, such as an SSD")
    else:
        yield ok(SUBJECT, "speed", summary)
