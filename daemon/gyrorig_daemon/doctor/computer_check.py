"""Checks of the computer: processor, power, temperature, memory, load, start of the service.

What to use when: `check_computer`. A value that does not exist is skipped: a laptop has no
undervoltage alarm, and a container has no thermal zone.
"""

import contextlib
import os
import re
from collections.abc import Iterator

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system_files import SystemFiles

SUBJECT = "computer"
SERVICE_UNIT = "gyrorigd.service"
HIGH_TEMPERATURE_C = 80.0  # a Raspberry Pi reduces its clock rate from 80 degC on
LOW_MEMORY_MB = 200  # the daemon needs 60 to 120 MB
# x86-64-v2 (System V ABI for x86-64, 3.1.1), except what every x86-64 has, as spelled in
# /proc/cpuinfo. NumPy's wheels are built for it, and nothing that imports them starts without.
X86_64_V2 = ("cx16", "lahf_lm", "popcnt", "pni", "sse4_1", "sse4_2", "ssse3")


def check_computer(system: SystemFiles) -> list[Finding]:
    """Return the findings about the computer itself."""
    checks = (
        _check_processor,
        _check_power,
        _check_temperature,
        _check_memory,
        _check_load,
        _check_service,
        _check_reboots,
    )
    findings = [finding for check in checks for finding in check(system)]
    if not any(finding.level for finding in findings):
        findings.insert(
            0,
            ok(
                SUBJECT,
                "computer",
                "the power supply, the temperature, the memory and the load are in order",
            ),
        )
    return findings


def _check_processor(system: SystemFiles) -> Iterator[Finding]:
    match = re.search(r"^flags\s*:(.*)", system.read_text("/proc/cpuinfo") or "", re.MULTILINE)
    flags = set(match[1].split()) if match else set()
    missing = [flag for flag in X86_64_V2 if flag not in flags]
    if "lm" in flags and missing:  # other processors, for example ARM, have no such flag
        yield fault(
            SUBJECT,
            "processor",
            f"the processor lacks the instructions {', '.join(missing)}. NumPy needs them "
            "(x86-64-v2), and the daemon and the solver need NumPy",
            "use a computer with an x86-64-v2 processor. In a virtual machine, use the "
            "processor of the host (qemu: -cpu host)",
        )


def _check_power(system: SystemFiles) -> Iterator[Finding]:
    for name in system.list_names("/sys/class/hwmon"):
        folder = f"/sys/class/hwmon/{name}"
        # the firmware's alarm on a Raspberry Pi (driver raspberrypi-hwmon)
        if system.read_text(f"{folder}/name") == "rpi_volt" and system.read_number(
            f"{folder}/in0_lcrit_alarm"
        ):
            yield warning(
                SUBJECT,
                "undervoltage",
                "the supply voltage of the computer was too low at least once since its "
                "start, which can make USB adapters fail",
                "use the power supply of the manufacturer, and connect the adapters to a "
                "powered USB hub",
            )
            return


def _check_temperature(system: SystemFiles) -> Iterator[Finding]:
    temperatures_c = [
        (system.read_number(f"/sys/class/thermal/{name}/temp") or 0) * 1e-3
        for name in system.list_names("/sys/class/thermal", "thermal_zone*")
    ]
    hottest_c = max(temperatures_c, default=0.0)
    if hottest_c >= HIGH_TEMPERATURE_C:
        message = (
            f"the temperature of the computer is {hottest_c:.0f} degC, so the processor reduces "
            "its speed"
        )
        yield warning(
            SUBJECT, "hot", message, "improve the ventilation of the computer, or add a heat sink"
        )


def _check_memory(system: SystemFiles) -> Iterator[Finding]:
    match = re.search(r"^MemAvailable:\s+(\d+) kB", system.read_text("/proc/meminfo") or "", re.M)
    if match is not None and int(match[1]) < LOW_MEMORY_MB * 1024:
        message = f"the computer has only {int(match[1]) // 1024} MB of free memory"
        remedy = "stop other programs, because the kernel ends programs when no memory is free"
        yield warning(SUBJECT, "memory", message, remedy)


def _check_load(system: SystemFiles) -> Iterator[Finding]:
    fields = (system.read_text("/proc/loadavg") or "").split()
    cores = os.cpu_count() or 1
    with contextlib.suppress(ValueError, IndexError):
        load = float(fields[1])  # over five minutes
        if load > 1.5 * cores:
            message = (
                f"the computer is overloaded (load {load:.1f} on {cores} cores), so timestamps "
                "are late"
            )
            remedy = (
                "find the program that causes the load with `top`, and end it, or lower its "
                "priority with `renice 19`"
            )
            yield warning(SUBJECT, "load", message, remedy)


def _check_service(system: SystemFiles) -> Iterator[Finding]:
    enabled_links = [
        f"{folder}/{target}.wants/{SERVICE_UNIT}"
        for folder in ("/etc/systemd/system", "/lib/systemd/system", "/usr/lib/systemd/system")
        for target in ("multi-user.target", "default.target")
    ]
    if any(system.path(name).is_symlink() or system.path(name).exists() for name in enabled_links):
        yield ok(SUBJECT, "service", f"the daemon ({SERVICE_UNIT}) starts with the computer")
        return
    is_installed = system.path(f"/etc/systemd/system/{SERVICE_UNIT}").exists()
    remedy = (
        f"run `systemctl enable --now {SERVICE_UNIT}`"
        if is_installed
        else "run `sudo make install-service`"
    )
    yield note(SUBJECT, "service", "the daemon does not start with the computer", remedy)


def _check_reboots(system: SystemFiles) -> Iterator[Finding]:
    settings = "\n".join(
        system.read_text(f"/etc/apt/apt.conf.d/{name}") or ""
        for name in system.list_names("/etc/apt/apt.conf.d")
    )
    lines = (line.split("//")[0] for line in settings.splitlines())
    values = re.findall(r'Unattended-Upgrade::Automatic-Reboot\s+"(\w+)"', "\n".join(lines))
    if values and values[-1].lower() in ("true", "1", "yes"):
        yield warning(
            SUBJECT,
            "reboots",
            "unattended upgrades of the system can restart the computer at night, even "
            "during a session",
            'set Unattended-Upgrade::Automatic-Reboot "false", or choose a restart time '
            "without sessions",
        )
