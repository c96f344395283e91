"""What stands between a program and a serial port, without opening it.

What to use when: `examine_port` for one port of the configuration. It says whether the
name will hold, who may open it, who has it now, and what the driver does to the bytes.
"""

import grp
import os
import pwd
import re
import stat
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system import System
from gyrorig_daemon.links.holder import Holder, lock_holder, open_holders
from gyrorig_daemon.links.serial_port import candidates

SERVICE_USER = "gyrorig"  # systemd/sysusers.d
RULES = "70-gyrorig.rules"
_UNSTABLE = re.compile(r"/dev/tty(USB|ACM)\d+")


@dataclass(frozen=True, slots=True)
class PortState:
    """Whether a port can be opened now, and by whom it is held if not."""

    can_open: bool
    holder: Holder | None


def examine_port(subject: str, path: str, system: System) -> tuple[list[Finding], PortState]:
    """Return what is to be said of the port at `path`, and whether it can be opened."""
    closed = PortState(False, None)
    try:
        node = Path(path).stat()
    except OSError:
        return [_missing(subject, path, system)], closed
    if not stat.S_ISCHR(node.st_mode):
        why = f"{path} is no device"
        return [fault(subject, "no_device", why, "name a port; see /dev/serial/by-id")], closed
    found = [*_name(subject, path, system), *_rights(subject, path, node)]
    found += [*_latency(subject, path, system), *_others(subject, path, system)]
    found += _flaws(subject, path, system)
    held = lock_holder(path) or next(iter(open_holders(path)), None)
    if held is not None:
        found.append(_held(subject, path, held))
    may = os.access(path, os.R_OK | os.W_OK)
    return found, PortState(may and held is None, held)


def _missing(subject: str, path: str, system: System) -> Finding:
    there = ", ".join(candidates()) or "none"
    if system.names("/sys/bus/usb/devices", "[0-9]*-*") or there != "none":
        remedy = f"check cable and name; ports here: {there}"
    else:
        remedy = "check the cable; this computer shows no serial port and no USB device"
    return fault(subject, "missing", f"there is no {path}", remedy)


def _name(subject: str, path: str, system: System) -> list[Finding]:
    if not _UNSTABLE.fullmatch(path):
        return []
    real = os.path.realpath(path)
    better = [
        f"{folder}/{name}"
        for folder in ("/dev/serial/by-id", "/dev/gyrorig", "/dev/serial/by-path")
        for name in system.names(folder)
        if os.path.realpath(system.path(f"{folder}/{name}")) == real
    ]
    remedy = f"name it {better[0]}" if better else "name it by /dev/serial/by-id"
    why = f"{path} is another device when the cables are plugged in another order"
    remedy += "; ptu.serial and facts: uid keep another device from being taken for it"
    return [warning(subject, "unstable_name", why, remedy)]


def _rights(subject: str, path: str, node: os.stat_result) -> list[Finding]:
    group = _group_name(node.st_gid)
    remedy = f"sudo usermod -aG {group} USER, and log in again"
    if not os.access(path, os.R_OK | os.W_OK):
        me = pwd.getpwuid(os.geteuid()).pw_name if _known(os.geteuid()) else str(os.geteuid())
        return [fault(subject, "denied", f"{me} may not open {path}", remedy.replace("USER", me))]
    try:
        service = pwd.getpwnam(SERVICE_USER)
    except KeyError:
        return []
    if _may(node, service):
        return []
    why = f"the service's user {SERVICE_USER} may not open {path} (group {group})"
    return [warning(subject, "denied_to_service", why, remedy.replace("USER", SERVICE_USER))]


def _may(node: os.stat_result, user: pwd.struct_passwd) -> bool:
    groups = os.getgrouplist(user.pw_name, user.pw_gid)
    if node.st_uid == user.pw_uid:
        return node.st_mode & 0o600 == 0o600
    if node.st_gid in groups:
        return node.st_mode & 0o060 == 0o060
    return node.st_mode & 0o006 == 0o006


def _latency(subject: str, path: str, system: System) -> list[Finding]:
    name = Path(os.path.realpath(path)).name
    waits_ms = system.number(f"/sys/bus/usb-serial/devices/{name}/latency_timer")
    if waits_ms is None:
        return []  # no FTDI adapter: no such timer
    if waits_ms <= 1:
        return [ok(subject, "latency_timer", "its adapter hands bytes on within 1 ms")]
    return [
        warning(
            subject,
            "latency_timer",
            f"its adapter gathers bytes for {waits_ms} ms: stamps are that late, and uneven",
            f"install systemd/udev/{RULES} (sudo make install-service) and plug it in again",
        )
    ]


def _others(subject: str, path: str, system: System) -> list[Finding]:
    """Return what is to be said of programs that open any new port by themselves."""
    if "ModemManager" not in system.programs():
        return []
    name = Path(os.path.realpath(path)).name
    if not name.startswith(("ttyUSB", "ttyACM")):
        return []  # it looks at no others
    folders = ("/etc/udev/rules.d", "/lib/udev/rules.d", "/usr/lib/udev/rules.d")
    if any(RULES in system.names(folder) for folder in folders):
        return []
    why = "ModemManager runs and talks to new serial ports as to modems: it can move a unit"
    remedy = f"install systemd/udev/{RULES} (sudo make install-service), or remove ModemManager"
    return [warning(subject, "modem_manager", why, remedy)]


def _flaws(subject: str, path: str, system: System) -> list[Finding]:
    """Return what the kernel itself does with the port."""
    name = Path(os.path.realpath(path)).name
    consoles = re.findall(r"console=(?:/dev/)?(\w+)", system.text("/proc/cmdline") or "")
    aliases = {Path(os.path.realpath(system.path(f"/dev/{console}"))).name for console in consoles}
    if name in {*consoles, *aliases}:
        return [
            fault(
                subject,
                "console",
                f"{path} is the kernel's console: it writes into it",
                "take console=... out of /boot/firmware/cmdline.txt (raspi-config, Serial Port)",
            )
        ]
    if name == "ttyS0" and "raspberry" in (system.text("/proc/device-tree/model") or "").lower():
        return [
            warning(
                subject,
                "mini_uart",
                f"{path} is the Pi's mini UART: its rate changes with the processor's clock",
                "use ttyAMA0: dtoverlay=disable-bt in /boot/firmware/config.txt",
            )
        ]
    return []


def _held(subject: str, path: str, holder: Holder) -> Finding:
    if holder.is_ours:
        return note(
            subject, "in_use", f"{path} is in use by {holder}", "for what it sees: gyrorigd status"
        )
    return fault(subject, "held", f"{path} is held by {holder}", "end that program")


def _group_name(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _known(uid: int) -> bool:
    try:
        pwd.getpwuid(uid)
    except KeyError:
        return False
    return True
