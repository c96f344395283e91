"""Capacity forecast for an unattended night: disk space, and sessions that will be rejected.

What to use when: `check_capacity` and `check_schedule_can_run`, after all other checks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gyrorig_daemon.config.service_settings import ScheduleEntry, ServiceSettings
from gyrorig_daemon.doctor.disk_check import DiskMeasurement
from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning

SUBJECT = "tonight"
NIGHT_S = 12 * 3600.0
# measured: 510 kB for 3984 samples and 3951 positions of a 40 s session of the emulated rig
BYTES_PER_MESSAGE = 64
# a calibration of the same recording with its report, rounded up
RESULT_BYTES_PER_BOARD = 2_000_000


@dataclass(frozen=True, slots=True)
class RecordingLoad:
    """The expected data rates of a night."""

    samples_hz: float  # of all boards together
    polls_hz: float  # positions of the unit
    boards: int


def check_capacity(
    disk: DiskMeasurement | None, load: RecordingLoad, service: ServiceSettings
) -> Iterator[Finding]:
    """Yield whether a night of continuous recording fits on the disk.

    Args:
        disk: the disk for recordings; None if it cannot be written.
        load: the expected data rates.
        service: the free space to keep, and whether old recordings are deleted.
    """
    if disk is None:
        return
    free = _format_size(disk.free_bytes)
    if load.samples_hz <= 0.0:
        message = (
            f"{free} of disk space are free, but no board is responding, so `gyrorigd doctor` "
            "cannot estimate how much space a recording needs"
        )
        yield note(
            SUBJECT,
            "no_rate",
            message,
            "correct the faults of the boards first, then run `gyrorigd doctor` again",
        )
        return
    rate_bytes_s = (load.samples_hz + load.polls_hz) * BYTES_PER_MESSAGE
    reserved_bytes = service.reserve_mb * 1_000_000 + load.boards * RESULT_BYTES_PER_BOARD
    duration_s = (disk.free_bytes - reserved_bytes) / rate_bytes_s
    summary = (
        f"continuous recording needs {_format_size(rate_bytes_s * 3600.0)} of disk space per "
        f"hour. {disk.folder} has {free} of free space, of which {service.reserve_mb} MB are "
        "reserved"
    )
    remedy = (
        f"move recordings away from {disk.folder}, or set `delete_when_full: true` under "
        "`service` in the rig file"
    )
    hours = max(duration_s, 0.0) / 3600.0
    if duration_s >= NIGHT_S:
        yield ok(SUBJECT, "fits", f"{summary}. This is enough for {_format_duration(duration_s)}")
    elif service.delete_when_full:
        message = (
            f"{summary}. The disk will be full in {hours:.1f} h, and the daemon then deletes "
            "the oldest recordings"
        )
        yield note(SUBJECT, "deletes", message)
    elif duration_s <= 0.0:
        yield fault(SUBJECT, "full", f"{summary}. Therefore no recording can start", remedy)
    else:
        message = (
            f"{summary}. The disk will be full in {hours:.1f} h, and the recording then "
            "waits for free space"
        )
        yield warning(SUBJECT, "fills_up", message, remedy)
    if rate_bytes_s > 0.5 * disk.write_bytes_s:
        message = (
            f"the disk can write {_format_size(disk.write_bytes_s)} per second, but it should "
            f"write twice as fast as the recording, which needs {_format_size(rate_bytes_s)} "
            "per second"
        )
        remedy = (
            "record to a faster disk, with the option --out of `gyrorigd record` or --state of "
            "`gyrorigd run`"
        )
        yield fault(SUBJECT, "disk_too_slow", message, remedy)


def check_schedule_can_run(
    entries: Sequence[ScheduleEntry],
    needs_homing: bool,
    can_home_unattended: bool,
    motion_is_locked: bool,
) -> Finding:
    """Return whether the scheduled sessions can start.

    Args:
        entries: the schedule of the rig.
        needs_homing: the unit is not homed, or may have lost steps.
        can_home_unattended: the configuration permits homing without consent.
        motion_is_locked: nothing moves until a person releases the lock.
    """
    names = ", ".join(entry.name for entry in entries)
    if not entries:
        return note(
            SUBJECT,
            "no_schedule",
            "the rig file schedules no session, so sessions come only from the queue",
        )
    if motion_is_locked:
        message = (
            f"the scheduled sessions {names} will not start, because the daemon has locked all "
            "motion of the rig"
        )
        return fault(
            SUBJECT, "held", message, "check the rig, then run `gyrorigd clear` to release the lock"
        )
    blocked_entries = [entry.name for entry in entries if not entry.home]
    if needs_homing and blocked_entries and not can_home_unattended:
        blocked = ", ".join(blocked_entries)
        message = (
            f"the daemon will reject the scheduled sessions {blocked}, because the pan-tilt unit "
            "must be homed first"
        )
        remedy = (
            "run one session with --home, or set `home: true` for these sessions in the schedule"
        )
        return fault(SUBJECT, "will_be_refused", message, remedy)
    return ok(SUBJECT, "schedule", f"scheduled: {names}")


def _format_duration(seconds: float) -> str:
    days = seconds / 86400.0
    return f"{seconds / 3600.0:.0f} h" if days < 3.0 else f"{days:.0f} days"


def _format_size(byte_count: float) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if byte_count >= scale:
            return f"{byte_count / scale:.1f} {unit}"
    return f"{byte_count / 1e3:.0f} kB"
