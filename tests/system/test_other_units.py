"""Other units than a PTU-E46 from end to end: recorded, solved, halted, examined."""

import os
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from gyrorig_daemon.cli import run as gyrorigd
from gyrorig_daemon.config import PtuPort, parse_rig
from gyrorig_daemon.doctor.unit_check import check_unit
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.pty_server import PtyServer, raw_now_ns
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.cli import run as gyrorig

TABLE = """
rig: table
ptu: {port: emulated, driver: scpi_table, baud: 115200}
boards: [{id: B-1, port: emulated, baud: 460800}]
emulator: {command_time_ms: 5.0}
"""
D48E = TABLE.replace("driver: scpi_table, ", "").replace("command", "dialect: d48e, command")
D46 = D48E.replace("d48e, command_time_ms: 5.0", "d46, command_time_ms: 100.0")
PAN_ONLY = """
name: pan-only
settings: {acceleration_deg_s2: 80.0, base_speed_deg_s: 3.0}
steps:
  - rest: {seconds: 4.0}
  - move: {pan_deg: 150.0, speed_deg_s: 40.0}
  - rest: {seconds: 1.0}
  - move: {pan_deg: -150.0, speed_deg_s: 60.0}
  - rest: {seconds: 1.0}
  - move: {pan_deg: 90.0, speed_deg_s: 25.0}
  - home: {}
  - rest: {seconds: 3.0}
"""
QUICK = (Path(__file__).parents[2] / "config/programs/quick.yaml").read_text(encoding="utf-8")
SLOW = QUICK.replace("speed_deg_s: 110.0", "speed_deg_s: 95.0")  # a D48E turns at 100 deg/s


def solved(folder: Path, rig: str, program: str, status: int) -> tuple[Any, Any, Path]:
    (folder / "rig.yaml").write_text(rig, encoding="utf-8")
    (folder / "program.yaml").write_text(program, encoding="utf-8")
    record = ["record", "--config", str(folder / "rig.yaml"), "--seed", "7"]
    record += ["--program", str(folder / "program.yaml"), "--simulated-time"]
    record += ["--truth", str(folder / "truth.yaml"), "--out", str(folder)]
    assert gyrorigd(record) == 0
    (recording,) = folder.glob("*.mcap")
    assert gyrorig(["solve", str(recording), "--extend", "none", "--out", str(folder)]) == status
    calibration = yaml.safe_load((folder / "B-1/v0001.yaml").read_text(encoding="utf-8"))
    truth = yaml.safe_load((folder / "truth.yaml").read_text(encoding="utf-8"))["boards"]["B-1"]
    return calibration, truth, recording


@pytest.mark.parametrize(
    ("rig", "program", "dialect"), [(D48E, SLOW, "e46"), (D46, QUICK, "d46")], ids=["d48e", "d46"]
)
def test_units_of_one_family(tmp_path: Path, rig: str, program: str, dialect: str) -> None:
    calibration, truth, recording = solved(tmp_path, rig, program, 0)
    metadata = read_recording(recording).metadata["gyrorig.ptu"]
    assert (metadata["driver"], metadata["dialect"]) == ("directed_perception", dialect)
    assert calibration["observability"]["unobservable"] == []
    error = np.array(calibration["matrices"]["STM"]) - np.array(truth["STM"])
    assert np.abs(error).max() < 2e-3


def test_a_rate_table_determines_what_pan_alone_can(tmp_path: Path) -> None:
    calibration, truth, recording = solved(tmp_path, TABLE, PAN_ONLY, 4)
    metadata = read_recording(recording).metadata["gyrorig.ptu"]
    assert (metadata["driver"], metadata["axes"]) == ("scpi_table", "pan")
    assert "dialect" not in metadata
    column = np.array([row[2] for row in calibration["matrices"]["STM"]], dtype=np.float64)
    assert np.abs(column - np.array(truth["STM"])[:, 2]).max() < 1e-3
    assert calibration["observability"]["rank"] == 6
    bias = calibration["parameters"]["bias"]
    z_scores = (np.array(bias["value"]) - truth["mean_bias_rad_s"]) / np.array(bias["std"])
    assert np.abs(z_scores).max() < 5.0


@contextmanager
def table_on_pty() -> Iterator[tuple[EmulatedRig, str]]:
    rig = EmulatedRig(emulated_rig_settings(parse_rig(TABLE, "rig.yaml"), 3), raw_now_ns())
    server, ended = PtyServer(rig), threading.Event()
    thread = threading.Thread(target=server.run, args=(ended.is_set,))
    thread.start()
    try:
        yield rig, server.paths["ptu"]
    finally:
        ended.set()
        thread.join()
        server.close()


def turns(rig: EmulatedRig) -> bool:
    return rig.stage.pan.is_moving((raw_now_ns() - rig.origin_ns) * 1e-9)


def test_a_turning_table_is_halted_without_the_daemon(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with table_on_pty() as (rig, port):
        assert rig.ptu is not None
        rig.ptu.receive(b"VEL 10\nPOS 300\n", raw_now_ns())
        while not turns(rig):
            time.sleep(0.01)
        config = tmp_path / "rig.yaml"
        config.write_text(TABLE.replace("ptu: {port: emulated", f"ptu: {{port: {port}"))
        begun_s = (raw_now_ns() - rig.origin_ns) * 1e-9
        assert gyrorigd(["halt", "--config", str(config)]) == 0
        assert not turns(rig)
        halts = [order[1] for order in rig.stage.pan.commands if order[0] == "halt"]
    assert halts[0] - begun_s < 0.5
    assert "has stopped at pan" in capsys.readouterr().out


def test_the_doctor_examines_a_table_without_moving_it() -> None:
    with table_on_pty() as (rig, port):
        findings = check_unit(PtuPort(port=port, driver="scpi_table", baud=115200))
        assert [finding.code for finding in findings] == ["identity"]
        wrong = PtuPort(port=port, driver="scpi_table", baud=115200, serial="other")
        assert [finding.code for finding in check_unit(wrong)] == ["identity", "wrong_unit"]
        mute = PtuPort(port=port, driver="scpi_table", commands={"identify": "WHO?"})
        assert "scpi_table" in check_unit(mute)[0].what
        assert not rig.stage.pan.commands


OWN_DRIVER = """
from gyrorig_daemon.motion import DriverEntry

DRIVER = DriverEntry("a unit without words", lambda port: None{halt_bytes})
"""


def write_own_driver(folder: Path, name: str, halt_bytes: bytes | None) -> None:
    module = folder / f"gyrorig_extensions/units/{name}.py"
    module.parent.mkdir(parents=True)
    stated = "" if halt_bytes is None else f", halt_bytes={halt_bytes!r}"
    module.write_text(OWN_DRIVER.format(halt_bytes=stated), encoding="utf-8")


@pytest.mark.parametrize("halt_bytes", [b"\xaa\x00STOP", None], ids=["stated", "not stated"])
def test_a_unit_without_words_never_gets_those_of_another_maker(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    halt_bytes: bytes | None,
) -> None:
    name = "own_with_bytes" if halt_bytes else "own_without_bytes"
    write_own_driver(tmp_path, name, halt_bytes)
    monkeypatch.syspath_prepend(str(tmp_path))
    unit_end, port_end = os.openpty()
    try:
        os.set_blocking(unit_end, False)
        tty.setraw(port_end)
        port = os.ttyname(port_end)
        status = gyrorigd(["halt", "--port", port, "--driver", name])
        message = capsys.readouterr().err
        if halt_bytes is None:
            assert status == 2
            assert "nothing was sent" in message
            with pytest.raises(BlockingIOError):
                os.read(unit_end, 100)
        else:
            assert status == 1
            assert "cannot confirm" in message
            received = os.read(unit_end, 1000)
            assert received == halt_bytes * (len(received) // len(halt_bytes))
        (finding,) = check_unit(PtuPort(port=port, driver=name))
        assert finding.code == "not_asked"
        with pytest.raises(BlockingIOError):
            os.read(unit_end, 100)
    finally:
        os.close(unit_end)
        os.close(port_end)
