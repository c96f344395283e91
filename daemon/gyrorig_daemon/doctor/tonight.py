"""What follows for a night without anybody: how much will be written, and whether it fits.

What to use when: `examine_tonight`, last, with what the others have measured.
"""

from gyrorig_daemon.doctor.disk import Disk
from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning

SUBJECT = "tonight"
NIGHT_S = 12 * 3600.0
# A 40 s session of the emulated rig: 510 kB for 3984 samples and 3951 positions.
BYTES_PER_MESSAGE = 64
# A calibration of the same recording, report included, rounded up.
BYTES_PER_BOARD = 2_000_000
RESERVE_BYTES = 512 << 20  # left for the system and for people; recording stops before


def examine_tonight(
    disk: Disk | None, samples_hz: float, polls_hz: float, boards: int
) -> list[Finding]:
    """Return whether a night of recording without a break fits on the disk.

    Args:
        disk: where recordings go; None where it takes nothing.
        samples_hz: of all boards together.
        polls_hz: positions of the unit a second.
        boards: how many there are.
    """
    if disk is None:
        return []
    rate_bytes_s = (samples_hz + polls_hz) * BYTES_PER_MESSAGE
    free_bytes = disk.free_bytes - RESERVE_BYTES - boards * BYTES_PER_BOARD
    if samples_hz <= 0.0:
        what = f"{_size(disk.free_bytes)} are free; no board is heard, so nothing can be reckoned"
        return [note(SUBJECT, "no_rate", what)]
    found = []
    lasts_s = free_bytes / rate_bytes_s
    says = (
        f"{_size(rate_bytes_s * 3600.0)} an hour without a break; "
        f"{_size(disk.free_bytes)} are free in {disk.folder}"
    )
    if lasts_s <= 0.0:
        found.append(fault(SUBJECT, "full", f"{says}: nothing can be recorded", "free space"))
    elif lasts_s < NIGHT_S:
        what = f"{says}: full in {lasts_s / 3600.0:.1f} h, and recording stops then"
        found.append(warning(SUBJECT, "fills_up", what, "free space, or allow retention"))
    else:
        found.append(ok(SUBJECT, "fits", f"{says}: enough for {_days(lasts_s)}"))
    if rate_bytes_s > 0.5 * disk.write_bytes_s:
        what = (
            f"{_size(rate_bytes_s)} a second have to be written, and the disk takes "
            f"{_size(disk.write_bytes_s)} a second"
        )
        found.append(fault(SUBJECT, "disk_too_slow", what, "record to a faster disk"))
    return found


def _days(seconds: float) -> str:
    days = seconds / 86400.0
    return f"{seconds / 3600.0:.0f} h" if days < 3.0 else f"{days:.0f} days"


def _size(byte_count: float) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if byte_count >= scale:
            return f"{byte_count / scale:.1f} {unit}"
    return f"{byte_count / 1e3:.0f} kB"
