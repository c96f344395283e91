"""A CAN bus: whether the interface is there and up, at which rate, and what it has lost.

What to use when: `examine_bus`. Nothing is sent; what is known comes from the kernel (`ip`)
and from /sys. A bus of python-can's UDP kind has no interface to look at.
"""

import contextlib
import json
import shutil
import subprocess
from collections.abc import Callable
from typing import Any

from gyrorig_daemon.config.buses import EMULATED, BusPort
from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system import System
from gyrorig_daemon.links.can_socket import BUFFER_BYTES

ARPHRD_CAN = 280  # <linux/if_arp.h>
NETWORK_FILE = "systemd/network/80-gyrorig-can0.network (sudo make install-service ARGS=--can)"
Describe = Callable[[str], dict[str, Any]]


def from_ip(name: str) -> dict[str, Any]:
    """Return what `ip` says of an interface, nothing where it cannot be asked."""
    program = shutil.which("ip")
    if program is None:
        return {}
    with contextlib.suppress(OSError, ValueError, IndexError, subprocess.TimeoutExpired):
        told = subprocess.run(  # noqa: S603 - the name is checked by the configuration
            [program, "-json", "-details", "-statistics", "link", "show", "dev", name],
            capture_output=True,
            check=False,
            timeout=5.0,
        )
        found: dict[str, Any] = json.loads(told.stdout)[0]
        return found
    return {}


def examine_bus(bus: BusPort, system: System, describe: Describe = from_ip) -> list[Finding]:
    """Return what is to be said of a bus."""
    subject = f"bus {bus.id}"
    kind, _, name = bus.port.partition(":")
    if kind == EMULATED:
        return [note(subject, "emulated", "it is emulated: there is no interface to look at")]
    found = _buffer(subject, system)
    if kind != "socketcan":
        return [note(subject, "no_interface", f"{bus.port} is no CAN interface"), *found]
    if system.number(f"/sys/class/net/{name}/type") != ARPHRD_CAN:
        there = [
            other
            for other in system.names("/sys/class/net")
            if system.number(f"/sys/class/net/{other}/type") == ARPHRD_CAN
        ]
        what = f"there is no CAN interface {name}"
        remedy = f"check the adapter and its overlay; here: {', '.join(there) or 'none'}"
        return [fault(subject, "missing", what, remedy)]
    if (system.text(f"/sys/class/net/{name}/operstate") or "") == "down":
        what = f"{name} is down"
        return [fault(subject, "down", what, f"ip link set {name} up, or {NETWORK_FILE}")]
    return [
        *_controller(subject, bus, name, describe(name)),
        *_losses(subject, name, system),
        *found,
    ]


def _controller(subject: str, bus: BusPort, name: str, told: dict[str, Any]) -> list[Finding]:
    data = told.get("linkinfo", {}).get("info_data", {})
    if not data:
        return []  # no `ip` here, or a virtual interface, which has neither rate nor state
    state = str(data.get("state", "")).upper()
    bitrate = data.get("bittiming", {}).get("bitrate")
    found = []
    if isinstance(bitrate, int) and bitrate != bus.bitrate:
        what = f"{name} runs at {bitrate} bit/s, and the configuration says {bus.bitrate}"
        found.append(
            fault(subject, "wrong_bitrate", what, f"change one of them; see {NETWORK_FILE}")
        )
    if state in ("BUS-OFF", "STOPPED"):
        what = f"{name} is {state.lower()}: nothing is sent or received"
        found.append(fault(subject, "bus_off", what, "check both terminations and the bit rate"))
    elif state in ("ERROR-PASSIVE", "ERROR-WARNING"):
        what = f"{name} is {state.lower()}: many frames are damaged, or nobody acknowledges"
        found.append(warning(subject, "errors", what, "check terminations, wires and the bit rate"))
    if not data.get("restart_ms"):
        what = f"{name} does not come back by itself after bus-off"
        remedy = f"ip link set {name} type can restart-ms 100, while it is down, or {NETWORK_FILE}"
        found.append(warning(subject, "no_restart", what, remedy))
    return found or [ok(subject, "controller", f"{name}: {state.lower()}, {bitrate} bit/s")]


def _losses(subject: str, name: str, system: System) -> list[Finding]:
    folder = f"/sys/class/net/{name}/statistics"
    counts = {
        what: system.number(f"{folder}/{what}") or 0
        for what in ("rx_over_errors", "rx_fifo_errors", "rx_dropped", "tx_dropped")
    }
    lost = ", ".join(f"{what} {count}" for what, count in counts.items() if count)
    if not lost:
        return []
    what = f"since it is up {name} has lost frames: {lost}"
    remedy = "put fewer boards on the bus, or use an mcp251xfd (an mcp2515 has room for two frames)"
    return [warning(subject, "frames_lost", what, remedy)]


def _buffer(subject: str, system: System) -> list[Finding]:
    allowed = system.number("/proc/sys/net/core/rmem_max")
    if allowed is None or allowed >= BUFFER_BYTES:
        return []
    what = (
        f"net.core.rmem_max is {allowed}: of a bus in full use {allowed / 1.3e6:.2f} s fit, and a "
        "daemon that stands still for longer loses frames"
    )
    remedy = "install systemd/sysctl.d/80-gyrorig.conf (sudo make install-service ARGS=--can)"
    return [warning(subject, "small_buffer", what, remedy)]
