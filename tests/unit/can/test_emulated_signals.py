"""Emulated IMUs of other makers on a CAN bus: their frames, a session, and its calibration."""

from pathlib import Path

import numpy as np
import pytest

from gyrorig_daemon.cli import run
from gyrorig_daemon.config import RigConfig, load_rig
from gyrorig_daemon.emulator.board.protocols.emulated_signals import _put_raw
from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.session.emulator_process import emulated_rig_settings
from gyrorig_protocol.board import FrameEvent, Sample
from gyrorig_protocol.board_protocols import find_can_protocol
from gyrorig_protocol.can import parse_dbc, unpack_frames
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.pipeline import solve_recordings

ROOT = Path(__file__).resolve().parents[3]
DBC = """\
BO_ 100 Rates: 8 IMU
 SG_ X : 7|16@0- (0.0078125,0) [0|0] "deg/s" A
 SG_ Y : 23|16@0- (0.0078125,0) [0|0] "deg/s" A
 SG_ Z : 39|16@0- (0.0078125,0) [0|0] "deg/s" A
 SG_ N : 48|16@1+ (1,0) [0|0] "" A
BO_ 99 Clock: 8 IMU
 SG_ T : 0|32@1+ (0.00001,0) [0|0] "s" A
"""
MAP = "{dbc: imu.dbc, gyro: [Rates.X, Rates.Y, Rates.Z], time: Clock.T, counter: Rates.N}"


def rig_file(folder: Path, signals: str, facts: str = "") -> Path:
    """Write a rig file with one emulated IMU on an emulated bus."""
    (folder / "imu.dbc").write_text(DBC)
    path = folder / "rig.yaml"
    path.write_text(
        "rig: can\nptu: {port: emulated}\nbuses: [{id: can0, port: emulated}]\nboards:\n"
        f"- id: M-1\n  bus: can0\n  format: signals\n  signals: {signals}\n"
        f"  facts: {{uid: by-hand, sensor: L3G4200D{facts}}}\n"
    )
    return path


def samples_of(config: RigConfig, seconds: float) -> tuple[EmulatedRig, list[Sample]]:
    """Return an emulated rig, and what the daemon reads from its bus."""
    rig = EmulatedRig(emulated_rig_settings(config, 3), 0)
    parser = find_can_protocol("signals").make_parser(config.boards[0])
    samples = []
    for _, data in rig.buses["can0"].take_output(round(seconds * 1e9)):
        for frame in unpack_frames(data, 0):
            assert parser.wants(frame.key)
            events = [e for e in parser.feed(frame) if isinstance(e, FrameEvent)]
            samples += [e.frame for e in events if isinstance(e.frame, Sample)]
    assert not any(parser.faults.values())
    return rig, samples


@pytest.mark.parametrize(
    "signals",
    ["{preset: j1939, source_address: 128}", "{preset: mm5.10}", "{preset: racelogic}", MAP],
)
def test_the_daemon_reads_the_rates_that_the_imu_measures(tmp_path: Path, signals: str) -> None:
    config = load_rig(rig_file(tmp_path, signals))
    rig, samples = samples_of(config, 2.0)
    scale = find_can_protocol("signals").scales(config.boards[0])["gyro_scale_rad_s"]
    assert isinstance(scale, float)
    rates = np.array([sample.gyro for sample in samples]) * scale
    assert len(rates) > 150
    bias = rig.truth.boards["M-1"].imu.bias_rad_s
    has_axis = np.any(rates != 0.0, axis=0)
    assert has_axis.sum() >= 2
    np.testing.assert_allclose(rates.mean(axis=0)[has_axis], bias[has_axis], atol=2e-3)
    accel = [sample.accel for sample in samples if sample.accel is not None]
    assert not accel or max(map(abs, accel[-1])) > 0


def test_numbers_and_times_are_those_of_the_imu(tmp_path: Path) -> None:
    _, samples = samples_of(load_rig(rig_file(tmp_path, MAP)), 2.0)
    assert np.all(np.diff([sample.sequence for sample in samples]) == 1)
    ticks = np.diff([sample.device_time or 0 for sample in samples])
    assert np.median(ticks) == pytest.approx(1000, rel=0.06)  # 0.01 s in 10 us


@pytest.mark.parametrize("path", ["Rates.X", "Rates.N", "Clock.T"])
def test_bits_are_written_as_they_are_read(path: str) -> None:
    message, name = path.split(".")
    signal = parse_dbc(DBC, "imu.dbc")[message].signals[name]
    for raw in (0, 1, 12_345, *((-1, -32_768) if signal.is_signed else (65_535,))):
        data = bytearray(8)
        _put_raw(data, signal, raw)
        assert signal.raw_value(bytes(data)) == raw


def test_a_session_with_such_an_imu_is_solved(tmp_path: Path) -> None:
    facts = ", odr_hz: 100.0, bandwidth_hz: 25.0, gyro_full_scale_dps: 250.0"
    words = ["record", "--config", str(rig_file(tmp_path, MAP, facts)), "--simulated-time"]
    words += ["--program", str(ROOT / "config" / "programs" / "quick.yaml")]
    assert run([*words, "--out", str(tmp_path / "out")]) == 0
    (path,) = (tmp_path / "out").glob("*.mcap")
    fit = solve_recordings([read_recording(path)], "M-1")
    truth = EmulatedRig(emulated_rig_settings(load_rig(tmp_path / "rig.yaml")), 0).truth
    error = (fit.gain - truth.boards["M-1"].imu.gain) / fit.gain_std
    assert np.nanmax(np.abs(error)) < 5.0


def test_the_noise_free_rates_of_a_session_are_those_of_its_samples(tmp_path: Path) -> None:
    """Before: "an emulated board does not speak the protocol signals"."""
    rig_path, program = rig_file(tmp_path, MAP), tmp_path / "p.yaml"
    program.write_text(
        "schema: gyrorig/program/1\nname: p\nsteps:\n  - rest: {seconds: 1.0}\n"
        "  - move: {pan_deg: 30.0, speed_deg_s: 40.0}\n"
    )
    arguments = ["record", "--config", str(rig_path), "--program", str(program),
                 "--out", str(tmp_path), "--simulated-time", "--rates", str(tmp_path / "rates.npz"),
                 "--truth", str(tmp_path / "truth.yaml")]  # fmt: skip
    assert run(arguments) == 0
    recording = read_recording(next(tmp_path.glob("*.mcap")))
    columns = recording.imu_columns(recording.board_ids[0])
    scale = float(recording.metadata["gyrorig.board.M-1"]["gyro_scale_rad_s"])
    with np.load(tmp_path / "rates.npz") as arrays:
        noise_free = arrays["M-1.hidden_rad_s"][columns.sequence]
    assert np.ptp(noise_free[:, 2]) > 0.5
    assert (columns.gyro * scale - noise_free).std(axis=0).max() < 0.006
