"""Buses in a rig's document: what is taken, and what is refused with a place."""

from pathlib import Path

import pytest

from gyrorig_daemon.config import load_rig, parse_rig
from gyrorig_daemon.session.record_modes import make_port_settings
from gyrorig_protocol.errors import UsageError

ROOT = Path(__file__).resolve().parents[3]
GOOD = """
rig: desk
ptu: {port: /dev/ptu, baud: 115200}
buses:
  - {id: can0, port: "socketcan:can0", bitrate: 500000}
  - {id: lab, port: "udp_multicast:239.74.163.2:43113"}
boards:
  - {id: A-1, port: /dev/ttyUSB0}
  - {id: C-1, bus: can0, node: 1}
  - {id: C-2, bus: can0, node: 2}
  - id: M-1
    bus: lab
    format: signals
    signals: {preset: j1939, source_address: 128}
    facts: {uid: MTLT-7}
"""
DBC = """\
BO_ 100 Rates: 8 IMU
 SG_ X : 0|16@1- (0.0625,0) [0|0] "°/s" A
"""


def test_the_shipped_rig_configuration_is_valid() -> None:
    rig = load_rig(ROOT / "config" / "rig-can.yaml")
    assert [board.bus for board in rig.boards] == ["can0"] * 3


def test_ports_and_settings_of_a_rig_with_buses() -> None:
    rig = parse_rig(GOOD, "rig.yaml")
    assert rig.ports() == {
        "ptu": "/dev/ptu",
        "board:A-1": "/dev/ttyUSB0",
        "bus:can0": "socketcan:can0",
        "bus:lab": "udp_multicast:239.74.163.2:43113",
    }
    settings = make_port_settings(rig, rig.ports())
    assert [settings[port].kind for port in rig.ports()] == ["serial", "serial", "can", "can"]
    assert [board.hub_port for board in rig.boards[1:]] == ["bus:can0", "bus:can0", "bus:lab"]
    assert [board.id for board in rig.serial_boards] == ["A-1"]
    assert not rig.is_emulated


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('"socketcan:can0"', '"can0"'), "Write the port as socketcan"),
        (('"socketcan:can0"', '"socketcan:../x"'), "Write the port as socketcan"),
        (("id: lab", "id: can0"), "bus can0 twice"),
        (("id: lab", "id: ../lab"), "board name"),
        (("bus: can0, node: 1", "bus: can9, node: 1"), "'can9'"),
        (("bus: can0, node: 1", "bus: can0"), "no node"),
        (("node: 2", "node: 1"), "on bus can0 both have the node number 1"),
        (("node: 2", "node: 128"), "node"),
        (
            ("bus: can0, node: 2", "bus: can0, node: 2, port: /dev/x"),
            "the key `port` and the key `bus`",
        ),
        (
            ("bus: can0, node: 2", "bus: can0, node: 2, format: text"),
            "which a CAN bus does not support",
        ),
        (("port: /dev/ttyUSB0", "node: 4"), "not the key `bus`"),
        (("port: /dev/ttyUSB0", "baud: 115200"), "neither a port nor a CAN bus"),
        (("    signals: {preset: j1939, source_address: 128}\n", ""), "but not the key `signals`"),
        (("preset: j1939, source_address: 128", "preset: j1939"), "source_address"),
        (("facts: {uid: MTLT-7}", "facts: {}"), "uid"),
        (("bitrate: 500000", "bitrate: 5000000"), "bitrate"),
    ],
)
def test_configuration_errors_are_named(change: tuple[str, str], words: str) -> None:
    text = GOOD.replace(*change)
    assert text != GOOD
    with pytest.raises(UsageError, match=r"rig\.yaml|board M-1") as caught:
        parse_rig(text, "rig.yaml")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_emulated_bus_must_carry_its_boards() -> None:
    text = GOOD.replace('"socketcan:can0"', "emulated").replace("500000", "125000")
    assert parse_rig(text, "rig.yaml").buses[0].port == "emulated"
    with pytest.raises(UsageError, match=r"of bus .*above 70%"):
        parse_rig(text + "emulator: {odr_hz: 400}\n", "rig.yaml")
    signals = text.replace('"udp_multicast:239.74.163.2:43113"', "emulated")
    assert parse_rig(signals, "rig.yaml").buses[1].port == "emulated"


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_a_dbc_file_is_read_next_to_the_configuration(tmp_path: Path, encoding: str) -> None:
    signals = "{dbc: imu.dbc, gyro: [Rates.X, null, null]}"
    text = GOOD.replace("{preset: j1939, source_address: 128}", signals)
    with pytest.raises(UsageError, match=r"has no `sensor` under `facts`\. Add the type"):
        parse_rig(text, "rig.yaml")
    text = text.replace("{uid: MTLT-7}", "{uid: MTLT-7, sensor: MTLT}")
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(UsageError, match=r"imu\.dbc"):
        load_rig(tmp_path / "rig.yaml")
    (tmp_path / "imu.dbc").write_bytes(DBC.encode(encoding))
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.boards[3].signals is not None
    assert "SG_ X" in (rig.boards[3].signals.dbc or "")
    (tmp_path / "imu.dbc").write_text(DBC.replace("SG_ X", "SG_ Q"))
    with pytest.raises(UsageError, match="no signal X"):
        load_rig(tmp_path / "rig.yaml")
