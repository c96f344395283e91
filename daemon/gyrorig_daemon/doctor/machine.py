"""This computer: processor, power, heat, memory, load, and whether anything starts the daemon.

What to use when: `examine_machine`. What is not there to be read is passed over: a laptop
has no undervoltage alarm, a container no thermal zone.
"""

import contextlib
import os
import re

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system import System

SUBJECT = "computer"
UNIT = "gyrorigd.service"
HOT_C = 80.0  # a Raspberry Pi slows its clock down from 80 degC on
LITTLE_MEMORY_MB = 200  # the daemon takes 60 to 120 MB
# x86-64-v2 (System V ABI for x86-64, 3.1.1), less what every x86-64 has, as /proc/cpuinfo
# spells it. NumPy's wheels are built for it, and nothing that imports them starts without.
X86_64_V2 = ("cx16", "lahf_lm", "popcnt", "pni", "sse4_1", "sse4_2", "ssse3")


def examine_machine(system: System) -> list[Finding]:
    """Return what is to be said of the computer itself."""
    found = [*_processor(system), *_power(system), *_heat(system), *_memory(system)]
    found += [*_load(system), *_service(system), *_reboots(system)]
    if not any(finding.level for finding in found):
        found.insert(0, ok(SUBJECT, "computer", "power, heat, memory and load are fine"))
    return found


def _processor(system: System) -> list[Finding]:
    told = re.search(r"^flags\s*:(.*)", system.text("/proc/cpuinfo") or "", re.MULTILINE)
    flags = set(told[1].split()) if told else set()
    missing = [flag for flag in X86_64_V2 if flag not in flags]
    if "lm" not in flags or not missing:  # no x86-64 at all: an ARM has no such line
        return []
    return [
        fault(
            SUBJECT,
            "processor",
            f"this processor lacks {', '.join(missing)}: NumPy's wheels are for x86-64-v2, "
            "and neither the daemon nor the solver starts without NumPy",
            "use a computer with an x86-64-v2 processor (most since 2009); "
            "give a virtual machine its host's (qemu: -cpu host)",
        )
    ]


def _power(system: System) -> list[Finding]:
    for name in system.names("/sys/class/hwmon"):
        folder = f"/sys/class/hwmon/{name}"
        # the firmware's alarm on a Raspberry Pi (driver raspberrypi-hwmon)
        if system.text(f"{folder}/name") == "rpi_volt" and system.number(
            f"{folder}/in0_lcrit_alarm"
        ):
            return [
                warning(
                    SUBJECT,
                    "undervoltage",
                    "the supply has been too low since the start: USB adapters drop out first",
                    "use the maker's supply, and a hub with its own for the adapters",
                )
            ]
    return []


def _heat(system: System) -> list[Finding]:
    hottest = max(
        (
            system.number(f"/sys/class/thermal/{name}/temp") or 0
            for name in system.names("/sys/class/thermal", "thermal_zone*")
        ),
        default=0,
    )
    if hottest * 1e-3 < HOT_C:
        return []
    return [
        warning(
            SUBJECT,
            "hot",
            f"it is {hottest * 1e-3:.0f} degC: it slows itself down",
            "give it air or a heat sink",
        )
    ]


def _memory(system: System) -> list[Finding]:
    free = re.search(r"^MemAvailable:\s+(\d+) kB", system.text("/proc/meminfo") or "", re.M)
    if free is None or int(free[1]) >= LITTLE_MEMORY_MB * 1024:
        return []
    return [
        warning(
            SUBJECT,
            "memory",
            f"only {int(free[1]) // 1024} MB of memory are free",
            "end what else runs here; the kernel ends programs when none is left",
        )
    ]


def _load(system: System) -> list[Finding]:
    words = (system.text("/proc/loadavg") or "").split()
    cores = os.cpu_count() or 1
    with contextlib.suppress(ValueError, IndexError):
        load = float(words[1])  # of five minutes
        if load > 1.5 * cores:
            return [
                warning(
                    SUBJECT,
                    "load",
                    f"{load:.1f} programs want to run on {cores} cores: stamps come late",
                    "find it with top, and end it or give it nice 19",
                )
            ]
    return []


def _service(system: System) -> list[Finding]:
    wanted = [
        f"{folder}/{target}.wants/{UNIT}"
        for folder in ("/etc/systemd/system", "/lib/systemd/system", "/usr/lib/systemd/system")
        for target in ("multi-user.target", "default.target")
    ]
    if any(system.path(name).is_symlink() or system.path(name).exists() for name in wanted):
        return [ok(SUBJECT, "service", f"{UNIT} starts with the computer")]
    installed = system.path(f"/etc/systemd/system/{UNIT}").exists()
    remedy = f"systemctl enable --now {UNIT}" if installed else "sudo make install-service"
    return [note(SUBJECT, "service", "nothing starts the daemon with the computer", remedy)]


def _reboots(system: System) -> list[Finding]:
    settings = "\n".join(
        system.text(f"/etc/apt/apt.conf.d/{name}") or ""
        for name in system.names("/etc/apt/apt.conf.d")
    )
    lines = (line.split("//")[0] for line in settings.splitlines())
    told = re.findall(r'Unattended-Upgrade::Automatic-Reboot\s+"(\w+)"', "\n".join(lines))
    if not told or told[-1].lower() not in ("true", "1", "yes"):
        return []
    return [
        warning(
            SUBJECT,
            "reboots",
            "unattended upgrades may restart it at night, in the middle of a session",
            'set Unattended-Upgrade::Automatic-Reboot "false", or a time without sessions',
        )
    ]
