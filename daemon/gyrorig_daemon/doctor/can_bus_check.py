"""Checks of a CAN bus: interface, bit rate, controller state, losses, receive buffer.

What to use when: `check_bus`. Nothing is sent. The data come from the kernel (`ip`) and from
/sys. A bus of python-can's UDP kind has no interface.
"""

import contextlib
import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

from gyrorig_daemon.config.bus_config import EMULATED, BusPort
from gyrorig_daemon.doctor.finding import Finding, fault, note, ok, warning
from gyrorig_daemon.doctor.system_files import SystemFiles
from gyrorig_daemon.links.can.can_socket import BUFFER_BYTES

ARPHRD_CAN = 280  # <linux/if_arp.h>
NETWORK_FILE = "systemd/network/80-gyrorig-can0.network (sudo make install-service ARGS=--can)"
BYTES_PER_S = 1.3e6  # in the receive buffer, of a fully loaded bus with 1 Mbit/s
InterfaceQuery = Callable[[str], dict[str, Any]]


def query_interface(name: str) -> dict[str, Any]:
    """Return what `ip` reports about an interface, an empty dict if it fails."""
    program = shutil.which("ip")
    if program is None:
        return {}
    with contextlib.suppress(OSError, ValueError, IndexError, subprocess.TimeoutExpired):
        completed = subprocess.run(  # noqa: S603 - the configuration validates the name
            [program, "-json", "-details", "-statistics", "link", "show", "dev", name],
            capture_output=True,
            check=False,
            timeout=5.0,
        )
        interface: dict[str, Any] = json.loads(completed.stdout)[0]
        return interface
    return {}


def check_bus(
    bus: BusPort, system: SystemFiles, query: InterfaceQuery = query_interface
) -> list[Finding]:
    """Return the findings about a bus."""
    subject = f"bus {bus.id}"
    kind, _, name = bus.port.partition(":")
    if kind == EMULATED:
        return [
            note(subject, "emulated", "the CAN bus is emulated, so it has no interface to check")
        ]
    buffer_findings = list(_check_buffer(subject, system))
    if kind != "socketcan":
        message = f"the port {bus.port} is not a CAN interface, so there is no interface to check"
        return [note(subject, "no_interface", message), *buffer_findings]
    if not _is_can(system, name):
        interfaces = [i for i in system.list_names("/sys/class/net") if _is_can(system, i)]
        message = f"this computer has no CAN interface {name}"
        remedy = (
            "check the CAN adapter and its device-tree overlay. The CAN interfaces of this "
            f"computer: {', '.join(interfaces) or 'none'}"
        )
        return [fault(subject, "missing", message, remedy)]
    if (system.read_text(f"/sys/class/net/{name}/operstate") or "") == "down":
        remedy = f"run `ip link set {name} up`, or install {NETWORK_FILE}"
        return [fault(subject, "down", f"the CAN interface {name} is down", remedy)]
    return [
        *_check_controller(subject, bus, name, query(name)),
        *_check_losses(subject, name, system),
        *buffer_findings,
    ]


def _is_can(system: SystemFiles, name: str) -> bool:
    return system.read_number(f"/sys/class/net/{name}/type") == ARPHRD_CAN


def _check_controller(
    subject: str, bus: BusPort, name: str, interface: dict[str, Any]
) -> list[Finding]:
    data = interface.get("linkinfo", {}).get("info_data", {})
    if not data:
        return []  # no `ip`, or a virtual interface, which has neither rate nor state
    state = str(data.get("state", "")).upper()
    bitrate = data.get("bittiming", {}).get("bitrate")
    findings = []
    if isinstance(bitrate, int) and bitrate != bus.bitrate:
        message = (
            f"the CAN interface {name} runs at {bitrate} bit/s, but the rig file has "
            f"{bus.bitrate} bit/s"
        )
        remedy = f"change one of the two rates. {NETWORK_FILE} sets the rate of the interface"
        findings.append(fault(subject, "wrong_bitrate", message, remedy))
    if state in ("BUS-OFF", "STOPPED"):
        message = (
            f"the CAN interface {name} is in the state {state.lower()}, so it neither sends nor "
            "receives"
        )
        findings.append(
            fault(subject, "bus_off", message, "check the terminations and the bit rate of the bus")
        )
    elif state in ("ERROR-PASSIVE", "ERROR-WARNING"):
        message = (
            f"the CAN interface {name} is in the state {state.lower()}, because frames are "
            "damaged or not acknowledged"
        )
        findings.append(
            warning(
                subject,
                "errors",
                message,
                "check the terminations, the wires and the bit rate of the bus",
            )
        )
    if not data.get("restart_ms"):
        message = f"the CAN interface {name} does not restart after the state bus-off"
        remedy = (
            f"run `ip link set {name} type can restart-ms 100` while the interface is down, "
            f"or install {NETWORK_FILE}"
        )
        findings.append(warning(subject, "no_restart", message, remedy))
    return findings or [ok(subject, "controller", f"{name}: {state.lower()}, {bitrate} bit/s")]


def _check_losses(subject: str, name: str, system: SystemFiles) -> Iterator[Finding]:
    counts = {
        counter: system.read_number(f"/sys/class/net/{name}/statistics/{counter}") or 0
        for counter in ("rx_over_errors", "rx_fifo_errors", "rx_dropped", "tx_dropped")
    }
    losses = ", ".join(f"{counter} {count}" for counter, count in counts.items() if count)
    if losses:
        message = f"the CAN interface {name} has lost frames since its start: {losses}"
        remedy = (
            "connect fewer boards to the bus. If its controller is an mcp2515, which buffers only "
            "two frames, use an mcp251xfd"
        )
        yield warning(subject, "frames_lost", message, remedy)


def _check_buffer(subject: str, system: SystemFiles) -> Iterator[Finding]:
    allowed = system.read_number("/proc/sys/net/core/rmem_max")
    if allowed is not None and allowed < BUFFER_BYTES:
        message = (
            f"the kernel setting net.core.rmem_max is {allowed}, so a fully loaded bus loses "
            f"frames if the daemon pauses for {allowed / BYTES_PER_S:.2f} s"
        )
        remedy = "install systemd/sysctl.d/80-gyrorig.conf (sudo make install-service ARGS=--can)"
        yield warning(subject, "small_buffer", message, remedy)
