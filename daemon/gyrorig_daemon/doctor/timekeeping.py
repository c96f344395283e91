"""The computer's clocks: whether UTC can be believed, now and after the next power cut.

What to use when: `examine_time`. Nothing here touches intervals: those are taken from a
clock that nobody steers; UTC names files and days.
"""

import math
import time

from gyrorig_daemon.doctor.finding import Finding, note, ok, warning
from gyrorig_daemon.doctor.system import System
from gyrorig_daemon.links.capture_clock import HostClocks

SUBJECT = "time"
STA_UNSYNC = 0x0040  # <linux/timex.h>
# 2026-01-01: older than this program, so a clock that shows it was never set
NOT_BEFORE_NS = 1_767_225_600 * 1_000_000_000
LARGE_ERROR_S = 1.0
SERVICES = ("chronyd", "systemd-timesyn", "ntpd", "ntpsec", "phc2sys")  # as comm, 15 letters
SLOW_SOURCES = ("jiffies", "hpet", "acpi_pm", "refined-jiffies")  # 1 us a reading and more


def examine_time(system: System, clocks: HostClocks) -> list[Finding]:
    """Return what is to be said of the clocks, read as `clocks`."""
    found = [*_utc(system, clocks), *_after_a_power_cut(system), *_source(system)]
    return found


def _utc(system: System, clocks: HostClocks) -> list[Finding]:
    keeper = sorted(set(SERVICES) & system.programs())
    shows = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(clocks.realtime_ns // 10**9))
    if clocks.realtime_ns < NOT_BEFORE_NS:
        return [
            warning(
                SUBJECT,
                "wrong_date",
                f"the clock shows {shows}: it was never set",
                "connect a network with a time server, or set it: timedatectl set-time ...",
            )
        ]
    unsynchronised = bool(clocks.ntp_status & STA_UNSYNC) and not math.isnan(clocks.frequency_ppm)
    if unsynchronised or (clocks.estimated_error_s > LARGE_ERROR_S):
        who = f"{keeper[0]} runs and has not managed it yet" if keeper else "and nothing tries to"
        return [
            warning(
                SUBJECT,
                "not_synchronised",
                f"UTC is not synchronised ({shows}), {who}: recordings of two rigs, and of two "
                "days, cannot be put in order by it; within a recording nothing is lost",
                "look at chronyc tracking, or timedatectl timesync-status"
                if keeper
                else "install chrony",
            )
        ]
    kept = f", kept by {keeper[0]}" if keeper else ""
    return [ok(SUBJECT, "synchronised", f"UTC is synchronised{kept}")]


def _after_a_power_cut(system: System) -> list[Finding]:
    if system.names("/sys/class/rtc", "rtc*"):
        return []
    return [
        note(
            SUBJECT,
            "no_rtc",
            "no clock with a battery: after a power cut it is wrong until the network answers; "
            "recordings begun before are named after a wrong day, and say so inside",
            "add a real-time clock (a Pi 5 has one and needs only a battery)",
        )
    ]


def _source(system: System) -> list[Finding]:
    source = system.text("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source not in SLOW_SOURCES:
        return []
    return [
        warning(
            SUBJECT,
            "slow_clock",
            f"the kernel reads its time from {source}, which is slow and coarse",
            "look into dmesg why it has given up the processor's own counter",
        )
    ]
