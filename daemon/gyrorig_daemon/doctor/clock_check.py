"""Checks of the computer's clocks: whether UTC is valid, now and after the next power cut.

What to use when: `check_clocks`. Intervals are not affected: they are measured with the raw
monotonic clock. UTC is used for file names and dates.
"""

import time
from collections.abc import Iterator

from gyrorig_daemon.clocks.capture_clock import HostClocks
from gyrorig_daemon.doctor.finding import Finding, note, ok, warning
from gyrorig_daemon.doctor.system_files import SystemFiles

SUBJECT = "time"
# 2026-01-01, before this program was written: a clock that shows less was never set
EARLIEST_VALID_NS = 1_767_225_600 * 1_000_000_000
LARGE_ERROR_S = 1.0
# as in /proc/PID/comm, at most 15 letters
TIME_SERVICES = ("chronyd", "systemd-timesyn", "ntpd", "ntpsec", "phc2sys")
SLOW_CLOCK_SOURCES = ("jiffies", "hpet", "acpi_pm", "refined-jiffies")  # 1 us or more per reading


def check_clocks(system: SystemFiles, clocks: HostClocks) -> list[Finding]:
    """Return the findings about the clocks, which were read as `clocks`."""
    return [*_check_utc(system, clocks), *_check_rtc(system), *_check_clock_source(system)]


def _check_utc(system: SystemFiles, clocks: HostClocks) -> Iterator[Finding]:
    services = sorted(set(TIME_SERVICES) & system.running_programs())
    time_text = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(clocks.realtime_ns // 10**9))
    if clocks.realtime_ns < EARLIEST_VALID_NS:
        message = (
            f"the system clock shows {time_text}, which is in the past, because no program has set "
            "the clock since the start of the computer"
        )
        remedy = (
            "connect the computer to a network with a time server, or set the clock with "
            "`timedatectl set-time ...`"
        )
        yield warning(SUBJECT, "wrong_date", message, remedy)
        return
    is_synchronised = clocks.is_synchronised
    if is_synchronised is False or clocks.estimated_error_s > LARGE_ERROR_S:
        reason = (
            f"although {services[0]} runs" if services else "because no program synchronises it"
        )
        yield warning(
            SUBJECT,
            "not_synchronised",
            f"the system clock ({time_text}) is not synchronised with UTC, {reason}. Each "
            "recording is correct in itself, but recordings of several rigs or days cannot "
            "be ordered by time",
            "run `chronyc tracking` or `timedatectl timesync-status` to see the reason"
            if services
            else "install the program chrony",
        )
        return
    if is_synchronised is None:
        yield note(
            SUBJECT,
            "synchronisation_unknown",
            f"this program does not know whether the system clock ({time_text}) is "
            "synchronised with UTC, because the system denies the call adjtimex",
            "run `timedatectl` or `chronyc tracking` outside the container or sandbox",
        )
        return
    source = f" by {services[0]}" if services else ""
    yield ok(SUBJECT, "synchronised", f"the system clock is synchronised with UTC{source}")


def _check_rtc(system: SystemFiles) -> Iterator[Finding]:
    if not system.list_names("/sys/class/rtc", "rtc*"):
        yield note(
            SUBJECT,
            "no_rtc",
            "this computer has no real-time clock. After a power cut its time is wrong "
            "until a time server answers, and recordings that begin before have wrong dates "
            "in their names",
            "add a real-time clock. A Raspberry Pi 5 has one, but it needs a battery",
        )


def _check_clock_source(system: SystemFiles) -> Iterator[Finding]:
    source = system.read_text("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source in SLOW_CLOCK_SOURCES:
        message = (
            f"the kernel reads the time from {source}. Each reading takes 1 us or more, so the "
            "timestamps of samples are less accurate"
        )
        remedy = (
            "run `dmesg`, and look for the reason why the kernel does not use the processor's own "
            "counter"
        )
        yield warning(SUBJECT, "slow_clock", message, remedy)
