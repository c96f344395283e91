"""Recordings with lost samples: their density is that of the received samples."""

from pathlib import Path

import numpy as np
import pytest
from scipy.fft import dct, idct
from scipy.stats import multivariate_normal
from tests.unit.twin_check.test_predicted_rates import MOVES, PROGRAM

from gyrorig_daemon.cli import run as run_daemon
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_solver.commands.project_files import project_file
from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import NoiseModel, Sampling, nominal_levels
from gyrorig_solver.twin_check.check_wording import difference_text, differences
from gyrorig_solver.twin_check.received_noise import (
    ReceivedDensity,
    ReceivedNoise,
    SimulatedNoise,
    constant_signals,
    estimate_noise,
)
from gyrorig_solver.twin_check.recording_check import check_board
from gyrorig_solver.twin_check.simulation import SimulatedRun

WHITE, COUNT = 2.5e-7, 1500
SAMPLING = Sampling(100.0, 1, 25.0, 1e-9, differentiated=False)
LEVELS = np.tile([WHITE, 40.0 * nominal_levels(WHITE)[1], 0.0, 0.0], (3, 1))
NOISE = SimulatedNoise(NoiseModel(LEVELS, SAMPLING), np.full(3, 1e-4))
MAX_ERROR_NATS = 10.0  # of 3 x 1000 received blocks; before, 250 per axis


def draw_used(share: float, burst: int) -> BoolArray:
    rng = np.random.default_rng(4)
    used = np.ones(COUNT, dtype=np.bool_)
    for first in np.flatnonzero(rng.random(COUNT) < share / burst):
        used[first : first + burst] = False
    used[[0, -1]] = True
    return used


def draw_noise(seed: int) -> FloatArray:
    """Return noise of all blocks, and a constant, (n, 3)."""
    rng = np.random.default_rng(seed)
    spectrum = rng.normal(size=(COUNT, 3)) * np.sqrt(NOISE.model.dct_variance(COUNT))
    offset = rng.normal(size=3) * NOISE.bias_std_rad_s
    return np.asarray(idct(spectrum, axis=0, norm="ortho") + offset)


@pytest.mark.parametrize(("share", "burst"), [(0.1, 1), (0.3, 1), (0.3, 25)])
def test_the_density_is_that_of_the_received_blocks(share: float, burst: int) -> None:
    used = draw_used(share, burst)
    noise = np.where(used[:, None], draw_noise(5), 0.0)
    received = ReceivedNoise.of(NOISE, used[:, None])
    density = ReceivedDensity.of(received, constant_signals(used), NOISE.bias_std_rad_s)
    basis = idct(np.eye(COUNT), axis=0, norm="ortho")
    covariance = (basis * NOISE.model.dct_variance(COUNT)[:, 0]) @ basis.T
    covariance += NOISE.bias_std_rad_s[0] ** 2
    exact = multivariate_normal(cov=covariance[np.ix_(used, used)]).logpdf(noise[used].T).sum()
    assert abs(density.mean + density.excess(noise.T) - exact) < MAX_ERROR_NATS


def test_the_noise_of_sessions_with_lost_samples_is_that_of_all_samples() -> None:
    """Before, the white noise was too low by the share of the lost samples, here 30 %."""
    used = draw_used(0.3, 1)
    noises = [draw_noise(seed) for seed in range(30)]
    complete = estimate_noise(noises, [np.ones((COUNT, 1), dtype=np.bool_)] * 30, SAMPLING)
    masked = [np.where(used[:, None], noise, 0.0) for noise in noises]
    estimated = estimate_noise(masked, [used[:, None]] * 30, SAMPLING)
    assert estimated.model.levels[:, 0] == pytest.approx(complete.model.levels[:, 0], rel=0.03)
    assert estimated.bias_std_rad_s == pytest.approx(complete.bias_std_rad_s, rel=0.2)


def test_a_residual_is_completed_to_the_power_of_all_samples() -> None:
    used = draw_used(0.3, 1)
    received = ReceivedNoise.of(NOISE, used[:, None])
    power = np.zeros((COUNT, 3))
    for seed in range(200):
        noise = draw_noise(seed)
        residual = np.where(used[:, None], noise - noise[used].mean(axis=0), 0.0)
        power += dct(received.completed(residual), axis=0, norm="ortho") ** 2
    ratio = (power / 200.0 / NOISE.model.dct_variance(COUNT))[1:1491].reshape(10, -1, 3)
    assert ratio.mean(axis=1) == pytest.approx(1.0, abs=0.06)


def record(folder: Path, seed: int, *options: str) -> SimulatedRun:
    rates = folder / f"{seed}.npz"
    arguments = [
        *("record", "--simulated-time", "--config", str(project_file("rig.yaml"))),
        *("--program", str(folder / "moves.yaml"), "--out", str(folder / str(seed))),
        *("--seed", "3", "--session-seed", str(seed), "--rates", str(rates), *options),
    ]
    assert run_daemon(arguments) == 0
    recording = read_recording(next((folder / str(seed)).glob("*.mcap")))
    return SimulatedRun(seed, recording, dict(np.load(rates)))


def test_a_right_simulation_predicts_a_recording_with_lost_samples(tmp_path: Path) -> None:
    """Before, the p-value was 0, and the limit was 180 nats per second above the measurement."""
    (tmp_path / "moves.yaml").write_text(PROGRAM + 2 * MOVES, encoding="utf-8")
    measured = record(tmp_path, 1, "--hide", "lost_samples:0.1").recording
    runs = [record(tmp_path, seed) for seed in range(2, 10)]
    stage = check_board(measured, "GY80-1", False, runs, [], runs).after
    assert stage.density_p_value > 0.01
    distance = stage.nats_per_s - stage.ceiling_nats_per_s
    assert abs(distance) < 5.0 * stage.ceiling_std_nats_per_s
    p_values = {family.family.key: family.p_value for family in stage.comparisons}
    assert min(p_values["spectrum"], p_values["allan"], p_values["jitter"]) > 0.01
    (text,) = [difference_text(difference) for difference in differences(stage)]
    assert text.startswith("lost samples since the start: "), "before, the arrivals differed"
