"""Findings of the doctor about a CAN bus, from data of the kernel."""

from pathlib import Path
from typing import Any

import pytest

from gyrorig_daemon.config import load_rig
from gyrorig_daemon.config.bus_config import BusPort
from gyrorig_daemon.doctor.can_bus_check import check_bus, query_interface
from gyrorig_daemon.doctor.doctor_command import CheckRequest, check_rig
from gyrorig_daemon.doctor.finding import Level
from gyrorig_daemon.doctor.system_files import SystemFiles

BUS = BusPort("can0", "socketcan:can0")
STATISTICS = "/sys/class/net/can0/statistics"


def link_details(**data: Any) -> dict[str, Any]:
    """What `ip -json -details` says of an mcp251xfd."""
    usual = {"state": "ERROR-ACTIVE", "restart_ms": 100, "bittiming": {"bitrate": 1_000_000}}
    return {"ifname": "can0", "linkinfo": {"info_kind": "can", "info_data": usual | data}}


@pytest.fixture
def system(tmp_path: Path) -> SystemFiles:
    shown = SystemFiles(tmp_path)
    put(shown, "/sys/class/net/can0/type", "280")
    put(shown, "/sys/class/net/can0/operstate", "up")
    put(shown, "/proc/sys/net/core/rmem_max", "8388608")
    return shown


def put(system: SystemFiles, name: str, text: str) -> None:
    path = system.path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def codes(system: SystemFiles, bus: BusPort = BUS, **data: Any) -> list[str]:
    findings = check_bus(bus, system, lambda _: link_details(**data))
    assert all(finding.remedy for finding in findings if finding.level >= Level.WARNING)
    return [finding.code for finding in findings]


def test_a_sound_bus(system: SystemFiles) -> None:
    assert codes(system) == ["controller"]
    assert check_bus(BUS, system, lambda _: {}) == []  # a virtual interface


@pytest.mark.parametrize(
    ("data", "code"),
    [
        ({"state": "BUS-OFF"}, "bus_off"),
        ({"state": "ERROR-PASSIVE"}, "errors"),
        ({"restart_ms": 0}, "no_restart"),
        ({"bittiming": {"bitrate": 500_000}}, "wrong_bitrate"),
    ],
)
def test_a_bus_with_a_flaw(system: SystemFiles, data: dict[str, Any], code: str) -> None:
    assert codes(system, **data) == [code]


def test_losses_and_a_small_buffer(system: SystemFiles) -> None:
    put(system, f"{STATISTICS}/rx_over_errors", "17")
    put(system, "/proc/sys/net/core/rmem_max", "212992")
    assert codes(system) == ["controller", "frames_lost", "small_buffer"]
    (small,) = (f for f in check_bus(BUS, system, lambda _: {}) if f.code == "small_buffer")
    assert "0.16 s" in small.what


def test_a_bus_that_is_not_there(system: SystemFiles) -> None:
    put(system, "/sys/class/net/can0/operstate", "down")
    assert codes(system) == ["down"]
    (finding,) = check_bus(BusPort("can1", "socketcan:can1"), system)
    assert finding.code == "missing"
    assert "can0" in finding.remedy
    assert codes(system, BusPort("b", "udp_multicast:239.0.0.1:4000")) == ["no_interface"]
    assert codes(system, BusPort("b", "emulated")) == ["emulated"]


def test_ip_is_asked_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    assert query_interface("no-such-device") == {}
    monkeypatch.setenv("PATH", "")
    assert query_interface("lo") == {}


def test_a_rig_with_a_bus(system: SystemFiles, tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(
        "rig: r\nptu: {port: emulated}\nbuses: [{id: can0, port: emulated}]\n"
        "boards: [{id: B-1, bus: can0, node: 1}, {id: B-2, bus: can0, node: 2}]\n"
    )
    findings = check_rig(CheckRequest(load_rig(path), tmp_path, system=system), lambda _: None)
    assert "bus can0" in {finding.subject for finding in findings}
    tonight = next(finding for finding in findings if finding.subject == "tonight")
    # 100 positions and 2 x 100 samples a second, 64 bytes each
    assert "69.1 MB of disk space per hour" in tonight.what
