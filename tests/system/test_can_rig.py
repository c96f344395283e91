"""A rig with boards on CAN buses, from the bus to the calibration."""

import json
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import can
import numpy as np
import pytest

from gyrorig_protocol.documents import parse_yaml
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.calibration import CalibrationStore
from gyrorig_solver.check import compare_with_truth
from gyrorig_solver.pipeline import solve_and_store

ROOT = Path(__file__).parents[2]
GROUP = "239.74.163.11"
RIG = """
rig: can-1
site: {gravity_m_s2: 9.80665}
ptu: {port: emulated, baud: 115200}
buses:
  - {id: can0, port: emulated}
boards:
  - {id: C-1, bus: can0, node: 1}
  - {id: C-2, bus: can0, node: 2}
emulator: {seed: 5, command_time_ms: 5.0, odr_hz: 100, bandwidth_hz: 25.0}
"""
MIXED = """
rig: can-2
ptu: {port: emulated, baud: 115200}
buses:
  - {id: can0, port: emulated}
  - {id: lab, port: "udp_multicast:GROUP:PORT"}
boards:
  - {id: C-1, bus: can0, node: 1}
  - id: J-1
    bus: lab
    format: signals
    signals: {preset: j1939, source_address: 128}
    facts: {uid: J1939-128, odr_hz: 100.0}
  - id: D-1
    bus: lab
    format: signals
    signals: {dbc: imu.dbc, gyro: [Rates.X, null, null], counter: Rates.Count}
    facts: {uid: by-hand, sensor: one axis}
emulator: {odr_hz: 100}
"""
DBC = """\
BO_ 801 Rates: 8 IMU
 SG_ X : 0|16@1- (0.0625,0) [0|0] "deg/s" A
 SG_ Count : 48|8@1+ (1,0) [0|0] "" A
"""
PROGRAM = """
name: short
steps:
  - rest: {seconds: 2.0, phase: static}
  - move: {pan_deg: 10.0, speed_deg_s: 40.0}
  - rest: {seconds: 1.0, phase: static}
"""


def record(folder: Path, rig: str, program: Path, *more: str) -> Path:
    (folder / "rig.yaml").write_text(rig)
    process = subprocess.run(
        [
            *(sys.executable, "-m", "gyrorig_daemon", "record", "--json"),
            *("--config", str(folder / "rig.yaml"), "--program", str(program)),
            *("--out", str(folder / "out"), *more),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    return Path(json.loads(process.stdout)["recording"])


def test_a_board_on_a_bus_is_calibrated(tmp_path: Path) -> None:
    program = ROOT / "config" / "programs" / "quick.yaml"
    truth = tmp_path / "truth.yaml"
    path = record(tmp_path, RIG, program, "--simulated-time", "--truth", str(truth))
    recording = read_recording(path)
    hidden = parse_yaml(truth.read_bytes(), truth.name)
    assert sorted(recording.board_ids) == ["C-1", "C-2"]
    for board in recording.board_ids:
        numbers = recording.imu(board)["sequence"].astype(np.int64)
        assert set(np.diff(numbers) & 0xFFFF) == {1}
        assert recording.metadata[f"gyrorig.board.{board}"]["link"] == "can"
    board = BoardId("C-2")
    solved = solve_and_store(CalibrationStore(tmp_path / "store"), [recording], board)
    for row in compare_with_truth(solved.calibration, hidden):
        assert row.sigmas is not None, row.name
        assert abs(row.sigmas) < 3.5, (board, row)


class Sender(threading.Thread):
    """A J1939 IMU of 100 Hz, and one of a single axis, by python-can itself."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.port = port
        self.over = threading.Event()

    def run(self) -> None:
        bus = can.Bus(interface="udp_multicast", channel=GROUP, port=self.port)
        count = 0
        while not self.over.wait(0.01):
            count += 1
            rates = struct.pack("<4H", 32000 + count % 100, 32000, 32000 - count % 50, 0xFFFF)
            accel = struct.pack("<4H", 32000, 32000, 32981, 0xFFFF)
            bus.send(can.Message(arbitration_id=0x08F02D80, data=accel, is_extended_id=True))
            bus.send(can.Message(arbitration_id=0x0CF02A80, data=rates, is_extended_id=True))
            frame = struct.pack("<h4xBx", -count % 1000, count & 0xFF)
            bus.send(can.Message(arbitration_id=801, data=frame, is_extended_id=False))
        bus.shutdown()


def free_port() -> int:
    """A port on which nobody else is in the group."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((GROUP, 0))
        return int(probe.getsockname()[1])


def test_two_buses_in_real_time_one_with_third_party_imus(
    tmp_path: Path, contract_judge: Path
) -> None:
    port = free_port()
    try:
        can.Bus(interface="udp_multicast", channel=GROUP, port=port).shutdown()
    except can.CanError as fault:
        pytest.skip(f"python-can needs a network interface with multicast: {fault}")
    (tmp_path / "imu.dbc").write_text(DBC)
    program = tmp_path / "short.yaml"
    program.write_text(PROGRAM)
    sender = Sender(port)
    sender.start()
    try:
        rig = MIXED.replace("GROUP", GROUP).replace("PORT", str(port))
        path = record(tmp_path, rig, program)
    finally:
        sender.over.set()
        sender.join()
    recording = read_recording(path)
    ours, theirs = (recording.imu(BoardId(name)) for name in ("C-1", "J-1"))
    assert len(ours) > 250
    numbers = ours["sequence"].astype(np.int64)
    assert {step & 0xFFFF for step in np.diff(numbers).tolist()} == {1}
    assert len(recording.clock_pings(BoardId("C-1"))) > 5
    # python-can's sleeps are late on a busy machine: fewer samples, but each one whole
    assert len(theirs) > 60
    assert set(theirs["accel"][1:, 2].tolist()) == {981}
    assert theirs["gyro"][:, 0].min() >= 0
    assert theirs["gyro"][:, 0].max() <= 99
    metadata = recording.metadata["gyrorig.board.J-1"]
    assert metadata["sensor"] == "J1939 angular rate sensor"
    assert float(metadata["gyro_scale_rad_s"]) == pytest.approx(np.pi / 180 / 128)
    single = recording.imu(BoardId("D-1"))
    assert len(single) > 60
    assert set(single["gyro"][:, 1:].ravel().tolist()) == {0}  # axes that it does not have
    numbers = single["sequence"].astype(np.int64)
    assert (np.diff(numbers) > 0).all()
    # a recording stands alone: what its codes mean is in it
    (attached,) = (a for a in recording.attachments if a.name == "signals.D-1.dbc")
    assert attached.data.decode().strip() == DBC.strip()
    judged = subprocess.run(
        [sys.executable, str(contract_judge), str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout + judged.stderr
