"""From true motion to bytes and back: the truth document says what the frames mean.

The judge here shares nothing with the sensor's model but the axes' angles: kinematics by
differences of rotation vectors, the low-pass by scipy's bilinear filter at 8 kHz, clocks
by their stated skew, and ordinary least squares for the gain.
"""

import math

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation
from tests.support.quick_cases import quick_cases

from gyrorig_daemon.emulator.emulated_rig import EmulatedRig
from gyrorig_daemon.emulator.emulator_settings import BoardSettings, PtuSettings, RigSettings
from gyrorig_daemon.emulator.virtual_hub import VirtualHub
from gyrorig_protocol.board import FrameEvent, FrameParser, Sample

ORIGIN = 7_000_000_000
FINE_HZ = 8000.0
MOVES = [(2.0, b"TP-500 "), (5.0, b"PP1500 "), (9.0, b"PP-1500 "), (14.0, b"TP0 "),
         (17.0, b"PP1500 "), (21.0, b"PP-1500 TP300 "), (27.0, b"TP500 "), (30.0, b"PP1500 "),
         (34.0, b"PP0 TP0 ")]  # fmt: skip
LENGTH_S = 40.0


def recorded(rig: EmulatedRig) -> tuple[np.ndarray, np.ndarray]:
    """Return unwrapped ticks and raw rates of one run."""
    hub = VirtualHub(rig)
    data = b""
    hub.write("ptu", b"PS1200 TS600 ")
    for at_s, command in [*MOVES, (LENGTH_S, b"")]:
        while (chunk := hub.read(ORIGIN + round(at_s * 1e9))) is not None:
            data += chunk.data if chunk.port == "board:B" else b""
        hub.write("ptu", command)
    events = FrameParser().feed(data, 0)
    got = [e.frame for e in events if isinstance(e, FrameEvent) and isinstance(e.frame, Sample)]
    ticks = np.unwrap([float(s.device_time or 0) for s in got], period=2.0**32)
    return ticks, np.array([s.gyro for s in got], dtype=np.float64)


def felt_rates(rig: EmulatedRig, cutoff_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times (s) and low-passed body rates (n, 3) on a fine grid."""
    count = round(LENGTH_S * FINE_HZ)
    pan = rig.stage.pan.angles_rad(0.0, 1.0 / FINE_HZ, count + 1)
    tilt = rig.stage.tilt.angles_rad(0.0, 1.0 / FINE_HZ, count + 1)
    attitude = Rotation.from_euler("ZX", np.stack([pan, tilt], axis=1))
    rates = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * FINE_HZ
    b, a = signal.butter(2, cutoff_hz, fs=FINE_HZ)
    return (np.arange(count) + 0.5) / FINE_HZ, signal.lfilter(b, a, rates, axis=0)


@pytest.mark.parametrize("seed", quick_cases([1, 2, 3], [1]))
def test_least_squares_finds_the_truth_document(seed: int) -> None:
    board = BoardSettings(name="B", full_scale_dps=500.0)
    unit = PtuSettings(base_speed_steps_s=100, echo=False, verbose=False)
    rig = EmulatedRig(RigSettings(seed=seed, ptu=unit, boards=(board,)), ORIGIN)
    ticks, counts = recorded(rig)
    truth = rig.truth_document(ORIGIN, ORIGIN + round(LENGTH_S * 1e9))["boards"]["B"]
    clock = truth["clock"]
    seconds = (ticks - clock["start_ticks"]) / clock["tick_hz"] / (1 + clock["skew_ppm"] * 1e-6)
    if seconds[0] < -60.0:  # the first stamp is a whole wrap later than the start
        seconds += 2.0**32 / clock["tick_hz"]
    time_s, rates = felt_rates(rig, truth["low_pass"]["cutoff_hz"])
    inside = seconds - truth["tau_s"] > time_s[0]
    moment = seconds[inside] - truth["tau_s"]
    omega = np.stack([np.interp(moment, time_s, rates[:, k]) for k in range(3)], axis=1)
    design = np.column_stack([omega, np.ones(len(omega))])
    y = counts[inside] * truth["gyro_scale_rad_s"]
    estimate, *_ = np.linalg.lstsq(design, y, rcond=None)
    residual = y - design @ estimate
    density = np.array(truth["noise_density_rad_s_rthz"])
    expected = density * math.sqrt(25.0 * math.pi / (2 * math.sqrt(2)))
    assert residual.std(axis=0) == pytest.approx(expected, rel=0.06)
    # Neighbours share some noise through the low-pass: white over 50 Hz, not over 35 Hz.
    spread = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    sigma = np.outer(spread, density * math.sqrt(truth["odr_hz"] / 2.0))
    error = estimate - np.vstack([np.array(truth["STM"]).T, truth["mean_bias_rad_s"]])
    assert np.abs(error[:3] / sigma[:3]).max() < 4.5
    assert np.abs(error[3]).max() < 2e-4
    assert np.abs(estimate[:3].T - np.eye(3)).max() > 0.01


def test_truth_is_s_times_t_times_m() -> None:
    rig = EmulatedRig(RigSettings(seed=9, boards=(BoardSettings(name="B"),)), 0)
    truth = rig.truth_document()["boards"]["B"]
    m = np.array(truth["M"])
    assert m @ m.T == pytest.approx(np.eye(3), abs=1e-12)
    t = np.array(truth["T"])
    assert (np.triu(t, 1) == 0).all()
    product = np.diag(truth["scale"]) @ t @ m
    assert np.array(truth["STM"]) == pytest.approx(product, abs=1e-15)
