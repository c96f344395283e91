"""What follows for a night without anybody: what will be written, and what will be refused.

What to use when: `examine_room` and `examine_schedule`, last, with what the others have
found.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from gyrorig_daemon.config.service import ScheduleEntry, ServiceSettings
from gyrorig_daemon.doctor.disk import Disk
from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning

SUBJECT = "tonight"
NIGHT_S = 12 * 3600.0
# A 40 s session of the emulated rig: 510 kB for 3984 samples and 3951 positions.
BYTES_PER_MESSAGE = 64
# A calibration of the same recording, report included, rounded up.
BYTES_PER_BOARD = 2_000_000


@dataclass(frozen=True, slots=True)
class Night:
    """What is to be expected of a night."""

    samples_hz: float  # of all boards together
    polls_hz: float  # positions of the unit
    boards: int


def examine_room(disk: Disk | None, night: Night, service: ServiceSettings) -> list[Finding]:
    """Return whether a night of recording without a break fits on the disk.

    Args:
        disk: where recordings go; None where it takes nothing.
        night: what there is to be recorded.
        service: how much is left free, and whether old recordings make room.
    """
    if disk is None:
        return []
    rate_bytes_s = (night.samples_hz + night.polls_hz) * BYTES_PER_MESSAGE
    free_bytes = disk.free_bytes - service.reserve_mb * 1_000_000 - night.boards * BYTES_PER_BOARD
    if night.samples_hz <= 0.0:
        what = f"{_size(disk.free_bytes)} are free; no board is heard, so nothing can be reckoned"
        remedy = "do what stands with the boards above, then ask again"
        return [note(SUBJECT, "no_rate", what, remedy)]
    found = []
    lasts_s = free_bytes / rate_bytes_s
    says = (
        f"{_size(rate_bytes_s * 3600.0)} an hour without a break; "
        f"{_size(disk.free_bytes)} are free in {disk.folder}, {service.reserve_mb} MB stay so"
    )
    if lasts_s <= 0.0 and not service.delete_when_full:
        remedy = f"move recordings away from {disk.folder}, or service: delete_when_full: true"
        found.append(fault(SUBJECT, "full", f"{says}: nothing can be recorded", remedy))
    elif lasts_s < NIGHT_S and not service.delete_when_full:
        what = f"{says}: full in {lasts_s / 3600.0:.1f} h, and recording waits then"
        remedy = f"move recordings away from {disk.folder}, or service: delete_when_full: true"
        found.append(warning(SUBJECT, "fills_up", what, remedy))
    elif lasts_s < NIGHT_S:
        what = f"{says}: full in {max(lasts_s, 0.0) / 3600.0:.1f} h; then the oldest are deleted"
        found.append(note(SUBJECT, "deletes", what))
    else:
        found.append(ok(SUBJECT, "fits", f"{says}: enough for {_days(lasts_s)}"))
    if rate_bytes_s > 0.5 * disk.write_bytes_s:
        what = (
            f"{_size(rate_bytes_s)} a second have to be written, and the disk takes "
            f"{_size(disk.write_bytes_s)} a second"
        )
        remedy = "record to a faster disk: --out of record, --state of run"
        found.append(fault(SUBJECT, "disk_too_slow", what, remedy))
    return found


def examine_schedule(
    entries: Sequence[ScheduleEntry], needs_homing: bool, homes_itself: bool, is_held: bool
) -> list[Finding]:
    """Return what stands against the sessions that are due.

    Args:
        entries: the rig's schedule.
        needs_homing: the unit is not homed, or may have lost steps.
        homes_itself: the configuration lets it home without asking.
        is_held: nothing moves until somebody has looked.
    """
    if not entries:
        return [note(SUBJECT, "no_schedule", "nothing is scheduled; sessions come from the queue")]
    names = ", ".join(entry.name for entry in entries)
    if is_held:
        what = f"{names} will not begin: the rig is held"
        return [fault(SUBJECT, "held", what, "look at the rig, then: gyrorigd clear")]
    refused = [entry.name for entry in entries if not entry.home]
    if needs_homing and refused and not homes_itself:
        what = f"{', '.join(refused)} will be refused: the unit has to be homed, and they may not"
        remedy = "home it once by hand (a session with --home), or home: true in the schedule"
        return [fault(SUBJECT, "will_be_refused", what, remedy)]
    return [ok(SUBJECT, "schedule", f"scheduled: {names}")]


def _days(seconds: float) -> str:
    days = seconds / 86400.0
    return f"{seconds / 3600.0:.0f} h" if days < 3.0 else f"{days:.0f} days"


def _size(byte_count: float) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if byte_count >= scale:
            return f"{byte_count / scale:.1f} {unit}"
    return f"{byte_count / 1e3:.0f} kB"
