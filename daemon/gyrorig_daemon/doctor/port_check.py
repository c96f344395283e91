"""Checks of a serial port without opening it: name, permissions, other users, driver settings.

What to use when: `check_port` for one port of the configuration.
"""

import grp
import os
import pwd
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system_files import SystemFiles
from gyrorig_daemon.links.ports.port_holder import PortHolder, lock_holder, open_holders
from gyrorig_daemon.links.ports.serial_port import list_serial_ports

SERVICE_USER = "gyrorig"  # systemd/sysusers.d
UDEV_RULES = "70-gyrorig.rules"
INSTALL_RULES = f"install systemd/udev/{UDEV_RULES} (sudo make install-service)"
_UNSTABLE = re.compile(r"/dev/tty(USB|ACM)\d+")


@dataclass(frozen=True, slots=True)
class PortState:
    """Whether a port can be opened now, and which program uses it if not."""

    can_open: bool
    holder: PortHolder | None


def check_port(subject: str, path: str, system: SystemFiles) -> tuple[list[Finding], PortState]:
    """Return the findings about the port at `path`, and whether it can be opened."""
    closed = PortState(False, None)
    try:
        status = Path(path).stat()
    except OSError:
        return [_report_missing(subject, path, system)], closed
    if not stat.S_ISCHR(status.st_mode):
        message = f"the port {path} is not a serial device"
        return [
            fault(
                subject,
                "no_device",
                message,
                "give a serial port in the rig file. The folder /dev/serial/by-id lists the "
                "connected ports",
            )
        ], closed
    findings = [
        *_check_name(subject, path, system),
        *_check_permissions(subject, path, status),
        *_check_latency_timer(subject, path, system),
        *_check_modem_manager(subject, path, system),
        *_check_kernel_use(subject, path, system),
    ]
    holder = lock_holder(path) or next(iter(open_holders(path)), None)
    if holder is not None:
        findings.append(_report_holder(subject, path, holder))
    is_permitted = os.access(path, os.R_OK | os.W_OK)
    return findings, PortState(is_permitted and holder is None, holder)


def _report_missing(subject: str, path: str, system: SystemFiles) -> Finding:
    ports = ", ".join(list_serial_ports()) or "none"
    if system.list_names("/sys/bus/usb/devices", "[0-9]*-*") or ports != "none":
        remedy = f"check the cable and the name of the port. The ports of this computer: {ports}"
    else:
        remedy = "check the cable, because this computer has no serial port and no USB device"
    return fault(subject, "missing", f"the port {path} does not exist", remedy)


def _check_name(subject: str, path: str, system: SystemFiles) -> Iterator[Finding]:
    if not _UNSTABLE.fullmatch(path):
        return
    real = os.path.realpath(path)
    stable_names = [
        f"{folder}/{name}"
        for folder in ("/dev/serial/by-id", "/dev/gyrorig", "/dev/serial/by-path")
        for name in system.list_names(folder)
        if os.path.realpath(system.path(f"{folder}/{name}")) == real
    ]
    name = stable_names[0] if stable_names else "a name in /dev/serial/by-id"
    message = (
        f"the name {path} can refer to another device when the cables are connected in another "
        "order"
    )
    remedy = (
        f"use {name} as the port. Also set ptu.serial, or `uid` under `facts` of the board, "
        "so that Gyrorig notices a different device"
    )
    yield warning(subject, "unstable_name", message, remedy)


def _check_permissions(subject: str, path: str, status: os.stat_result) -> Iterator[Finding]:
    group = _group_name(status.st_gid)
    remedy = f"run `sudo usermod -aG {group} USER`, and log in again"
    if not os.access(path, os.R_OK | os.W_OK):
        user = _user_name(os.geteuid())
        message = f"the user {user} has no permission to open the port {path}"
        yield fault(subject, "denied", message, remedy.replace("USER", user))
        return
    try:
        service = pwd.getpwnam(SERVICE_USER)
    except KeyError:
        return
    if not _may_open(status, service):
        message = (
            f"the user {SERVICE_USER} of the service has no permission to open the port {path} "
            f"(group {group})"
        )
        yield warning(subject, "denied_to_service", message, remedy.replace("USER", SERVICE_USER))


def _may_open(status: os.stat_result, user: pwd.struct_passwd) -> bool:
    if status.st_uid == user.pw_uid:
        return status.st_mode & 0o600 == 0o600
    if status.st_gid in os.getgrouplist(user.pw_name, user.pw_gid):
        return status.st_mode & 0o060 == 0o060
    return status.st_mode & 0o006 == 0o006


def _check_latency_timer(subject: str, path: str, system: SystemFiles) -> Iterator[Finding]:
    name = Path(os.path.realpath(path)).name
    latency_ms = system.read_number(f"/sys/bus/usb-serial/devices/{name}/latency_timer")
    if latency_ms is None:
        return  # only FTDI adapters have this timer
    if latency_ms <= 1:
        yield ok(subject, "latency_timer", "the latency timer of the USB adapter is 1 ms")
        return
    message = (
        f"the USB adapter of the port buffers bytes for {latency_ms} ms, so timestamps are late"
    )
    remedy = f"{INSTALL_RULES}, and connect the adapter again"
    yield warning(subject, "latency_timer", message, remedy)


def _check_modem_manager(subject: str, path: str, system: SystemFiles) -> Iterator[Finding]:
    if "ModemManager" not in system.running_programs():
        return
    if not Path(os.path.realpath(path)).name.startswith(("ttyUSB", "ttyACM")):
        return  # it uses no other ports
    folders = ("/etc/udev/rules.d", "/lib/udev/rules.d", "/usr/lib/udev/rules.d")
    if not any(UDEV_RULES in system.list_names(folder) for folder in folders):
        message = (
            "the program ModemManager sends modem commands to new serial ports, which can move "
            "a pan-tilt unit"
        )
        yield warning(subject, "modem_manager", message, f"{INSTALL_RULES}, or remove ModemManager")


def _check_kernel_use(subject: str, path: str, system: SystemFiles) -> Iterator[Finding]:
    name = Path(os.path.realpath(path)).name
    consoles = re.findall(r"console=(?:/dev/)?(\w+)", system.read_text("/proc/cmdline") or "")
    aliases = {Path(os.path.realpath(system.path(f"/dev/{console}"))).name for console in consoles}
    model = (system.read_text("/proc/device-tree/model") or "").lower()
    if name in {*consoles, *aliases}:
        message = (
            f"the port {path} is the console of the kernel, so the kernel writes its messages to it"
        )
        remedy = (
            "remove console=... from /boot/firmware/cmdline.txt, or use raspi-config (Serial Port)"
        )
        yield fault(subject, "console", message, remedy)
    elif name == "ttyS0" and "raspberry" in model:
        message = (
            f"the port {path} is the mini UART of the Raspberry Pi, whose baud rate changes with "
            "the processor's clock"
        )
        remedy = (
            "use the port /dev/ttyAMA0, and add dtoverlay=disable-bt to /boot/firmware/config.txt"
        )
        yield warning(subject, "mini_uart", message, remedy)


def _report_holder(subject: str, path: str, holder: PortHolder) -> Finding:
    if holder.is_ours:
        message = f"Gyrorig already uses the port {path} ({holder})"
        remedy = "run `gyrorigd status` to see what the daemon does with the device"
        return note(subject, "in_use", message, remedy)
    return fault(
        subject,
        "held",
        f"the port {path} is in use by {holder}",
        "end the program that uses the port",
    )


def _group_name(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _user_name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)
