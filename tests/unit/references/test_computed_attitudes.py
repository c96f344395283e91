"""Attitudes that a filter computed from the gyro and an accelerometer are no reference for it."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from scipy.spatial.transform import Rotation
from tests.support.attitude_filters import madgwick_attitudes, mahony_attitudes
from tests.support.reference_recordings import HandMotion, SimulatedGyro
from tests.support.simulated_attitudes import HandMotion as SteadyMotion
from tests.unit.references.test_shared_noise import REASON, refused_reasons
from tests.unit.references.test_unusable_data import record

from gyrorig_solver import cli
from gyrorig_solver.data import FloatArray

RATE_HZ = 200.0
TIME_S = np.arange(int(60 * RATE_HZ)) / RATE_HZ
FILTERS = {
    "mahony": lambda gyro, force: mahony_attitudes(gyro, force, RATE_HZ),
    "mahony_bias": lambda gyro, force: mahony_attitudes(gyro, force, RATE_HZ, kp=0.5, ki=0.02),
    "madgwick": lambda gyro, force: madgwick_attitudes(gyro, force, RATE_HZ),
    "madgwick_fast": lambda gyro, force: madgwick_attitudes(gyro, force, RATE_HZ, beta=0.1),
}


def record_filter(
    folder: Path,
    name: str,
    step: int,
    motion: HandMotion | SteadyMotion,
    noise_rad_s: float = 1e-3,
    world: Rotation | None = None,
) -> Path:
    """Write the samples, and every `step`-th attitude of a filter; `world` turns its frame."""
    rate = motion.rate_rad_s(TIME_S)
    gyro = SimulatedGyro(noise_rad_s=noise_rad_s).measure(TIME_S, rate, rate, 4)
    force = motion.attitude(TIME_S).inv().apply([0.0, 0.0, 9.81])
    force = force + 0.03 * np.random.default_rng(4).normal(size=force.shape)
    q = FILTERS[name](gyro, force)
    if world is not None:
        q = (world * Rotation.from_quat(q)).as_quat()
    data = {"t": TIME_S, "g": np.degrees(gyro), "qt": TIME_S[::step], "q": q[::step]}
    return record(folder, data)[0]


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("step", [1, 4, 20])
def test_a_filter_of_the_gyro_is_recognised(name: str, step: int, tmp_path: Path) -> None:
    """Before: a bias of -0.61 ± 0.07 deg/s for a gyro with -1.15 deg/s, and no remark."""
    noise_rad_s = 5e-3 if name == "madgwick_fast" and step == 20 else 1e-3
    path = record_filter(tmp_path, name, step, HandMotion(4), noise_rad_s)
    assert refused_reasons(path) != ()


@pytest.mark.parametrize("name", ["mahony", "mahony_bias", "madgwick"])
@pytest.mark.parametrize("step", [1, 20])
def test_a_board_that_never_rests_hides_no_filter(name: str, step: int, tmp_path: Path) -> None:
    assert REASON in refused_reasons(record_filter(tmp_path, name, step, SteadyMotion(4)))[0]


def test_the_frame_of_the_world_is_free(tmp_path: Path) -> None:
    turned = Rotation.from_rotvec([0.4, -0.9, 0.3])
    path = record_filter(tmp_path, "mahony", 1, HandMotion(4), world=turned)
    assert REASON in refused_reasons(path)[0]


def test_solve_states_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record_filter(tmp_path, "mahony", 20, HandMotion(4))
    cli.run(["solve", str(path), "--out", str(tmp_path / "out"), "--extend", "none"])
    out = capsys.readouterr().out
    assert "version 1: refused" in out
    assert f"! {REASON}" in out
    assert "record again" not in out


def noise_of(kind: str, rate_hz: float, noise_rad_s: float, count: int, seed: int) -> FloatArray:
    """Return the noise of a gyro, (count, 3)."""
    rng = np.random.default_rng(seed)
    white = noise_rad_s * rng.normal(size=(count, 3))
    if kind == "low-pass":
        return np.asarray(lfilter(*butter(2, 0.4), white, axis=0), np.float64)
    if kind == "vibration":
        shake = 0.05 * rng.normal(size=(count, 3))
        return np.asarray(white + lfilter(*butter(4, [0.3, 0.8], "band"), shake, axis=0))
    if kind == "lines":
        t = np.arange(count)[:, None] / rate_hz
        return white + sum(0.05 * np.sin(2.0 * np.pi * f * t) for f in (17.0, 34.0, 51.0, 83.0))
    if kind == "angle":  # of a gyro that counts angles: its power grows with the frequency
        angle = 1e-8 * rate_hz * rng.normal(size=(count + 1, 3))
        return np.asarray(np.diff(angle, axis=0) * rate_hz)
    return white


@pytest.mark.parametrize("kind", ["white", "low-pass", "vibration", "lines", "rounded", "angle"])
@pytest.mark.parametrize("seed", range(7))
def test_an_exact_reference_is_independent(kind: str, seed: int, tmp_path: Path) -> None:
    """An attitude without noise is the nearest that another instrument can come to the gyro's."""
    rate_hz, noise_rad_s = (200.0, 100.0, 400.0)[seed % 3], (1e-3, 5e-3, 1e-4, 5e-3)[seed % 4]
    t = np.arange(int(60 * rate_hz)) / rate_hz
    qt = np.arange(0.5, 59.5, (1.0, 2.0, 10.0, 20.0)[seed % 4] / rate_hz)
    motion = HandMotion(seed) if seed % 2 else SteadyMotion(seed)
    gyro = motion.rate_rad_s(t) @ SimulatedGyro().gain.T + [0.01, -0.02, 0.005]
    gyro = gyro + noise_of(kind, rate_hz, noise_rad_s, t.size, seed)
    if kind == "rounded":
        gyro = 1.06e-3 * np.rint(gyro / 1.06e-3)
    data = {"t": t, "g": np.degrees(gyro), "qt": qt, "q": motion.attitude(qt - 0.003).as_quat()}
    assert refused_reasons(record(tmp_path, data)[0]) == ()
