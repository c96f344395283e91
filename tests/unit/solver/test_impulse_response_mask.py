"""Pulses of the rig told from glitches, made with another's low-pass (scipy's)."""

from functools import cache

import numpy as np
import pytest
from scipy import signal

from gyrorig_solver.estimate.noise.impulse_response_mask import axis_motions, impulse_response_mask
from gyrorig_solver.estimate.noise.outliers import find_outliers

N, RATE_HZ, BANDWIDTH_HZ, SIGMA = 600, 100.0, 25.0, 0.0027
JITTER_DRAWS = 100
TIME_S = np.arange(N) / RATE_HZ
PAN = np.clip(TIME_S - 1.0, 0.0, 3.0)  # turns from 1 to 4 s, starts and stops at once
TILT = np.full(N, 0.4)
GAIN = np.array([[1.01, 0.02, -0.01], [0.0, 0.98, 0.03], [0.01, -0.02, 1.0]])
PAN_SHOWS = GAIN @ [0.0, np.sin(0.4), np.cos(0.4)]


@cache
def fine_response(twice: bool) -> tuple[np.ndarray, np.ndarray]:
    """The times and values of a second-order Butterworth's response to one pulse, or to two."""
    b, a = signal.butter(2, 2 * np.pi * BANDWIDTH_HZ, analog=True)
    fine = np.arange(0.0, 0.3, 1e-5)
    step = signal.step((b, a), T=fine)[1]
    return fine, np.gradient(np.gradient(step, fine) if twice else step, fine)


def response(at_s: float, twice: bool = False, jitter_s: float = 0.0, seed: int = 0) -> np.ndarray:
    """A pulse of 1 rad (or two opposite ones) behind a low-pass, in samples with jitter, (n,)."""
    taken_s = TIME_S + jitter_s * np.random.default_rng(seed).standard_normal(N)
    times_s, values = fine_response(twice)
    return np.asarray(np.interp(taken_s - at_s, times_s, values, left=0.0, right=0.0))


def usable_rows(left: np.ndarray) -> np.ndarray:
    """Which rows would be set aside but are not."""
    noise = np.random.default_rng(1).standard_normal((N, 3)) * SIGMA
    odd = find_outliers(left + noise, np.ones(N, dtype=np.bool_), 1e-4)
    assert odd.any()
    axes = axis_motions(np.stack([PAN, TILT]), GAIN)
    deviation = np.full(3, SIGMA)
    return odd & impulse_response_mask(left + noise, odd, TIME_S, axes, BANDWIDTH_HZ, deviation)


@pytest.mark.parametrize("at_s", [1.5003, 2.2571, 3.1])
@pytest.mark.parametrize("lost", [9e-4, -0.0072])
def test_lost_step_is_kept(at_s: float, lost: float) -> None:
    assert usable_rows(lost * np.outer(response(at_s), PAN_SHOWS)).any()


def test_lost_steps_in_samples_with_jitter_are_kept() -> None:
    """The jitter leaves up to 0.018 of the energy of a pulse."""
    times_s = np.random.default_rng(5).uniform(1.4, 2.9, JITTER_DRAWS)
    is_kept = [
        usable_rows(0.0072 * np.outer(response(at_s, jitter_s=9e-4, seed=k), PAN_SHOWS)).any()
        for k, at_s in enumerate(times_s)
    ]
    assert all(is_kept)


def test_base_compliance_pulse_is_kept() -> None:
    assert usable_rows(2e-5 * np.outer(response(1.0002, twice=True), PAN_SHOWS)).any()


def test_pulse_at_rest_is_a_glitch() -> None:
    assert not usable_rows(9e-4 * np.outer(response(5.2), PAN_SHOWS)).any()


def test_pulse_about_another_axis_is_a_glitch() -> None:
    assert not usable_rows(9e-4 * np.outer(response(2.2), [1.0, 0.0, 0.0])).any()


@pytest.mark.parametrize("sigmas", [10.0, 60.0, 400.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_corrupt_word_is_a_glitch(sigmas: float, axis: int) -> None:
    left = np.zeros((N, 3))
    left[[160, 250, 333], axis] = sigmas * SIGMA
    assert not usable_rows(left).any()
