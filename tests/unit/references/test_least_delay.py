"""The error of a line through the least delays has the stated mean and standard deviation."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from gyrorig_solver.data.clocks.latency_floor import find_latency_floor
from gyrorig_solver.reference.least_delay import line_error

COUNT, RATE_HZ, RUNS = 6000, 100.0, 200
WITHIN_95 = 1.96
# 95 % less 4 standard deviations of a share of 200 runs.
LEAST_SHARE = 0.95 - 4.0 * math.sqrt(0.95 * 0.05 / RUNS)
DELAYS: dict[str, Callable[[np.random.Generator], np.ndarray]] = {
    "half-normal": lambda rng: np.abs(rng.normal(size=COUNT)),
    "exponential": lambda rng: rng.exponential(size=COUNT),
    "uniform": lambda rng: rng.uniform(size=COUNT),
    "two paths": lambda rng: rng.exponential(size=COUNT) + 3.0 * (rng.uniform(size=COUNT) > 0.8),
    "two stages": lambda rng: rng.gamma(2.0, size=COUNT),
    "three stages": lambda rng: rng.gamma(3.0, size=COUNT),
}


def errors(name: str) -> tuple[np.ndarray, np.ndarray]:
    """The errors of the mean of the line, and the same in stated standard deviations."""
    rng = np.random.default_rng(11)
    time_s = np.arange(COUNT) / RATE_HZ
    raw_s, relative = [], []
    for _ in range(RUNS):
        delay_s = 2e-3 * DELAYS[name](rng)
        line_s = find_latency_floor(time_s, delay_s).envelope.delay_at(time_s)
        stated = line_error(delay_s - line_s, 0.0)
        raw_s.append(float(np.mean(line_s)))
        relative.append((raw_s[-1] - stated.mean_s) / stated.std_s)
    return np.array(raw_s), np.array(relative)


@pytest.mark.parametrize("name", DELAYS)
def test_the_intervals_hold(name: str) -> None:
    raw_s, relative = errors(name)
    assert np.mean(np.abs(relative) < WITHIN_95) > LEAST_SHARE
    assert np.all(raw_s > -1e-12)  # the line is not earlier than a delay of zero
    assert abs(np.mean(relative)) < 0.5  # the mean error is corrected


def test_a_clock_that_wanders_adds_to_the_uncertainty() -> None:
    delay_s = np.random.default_rng(1).exponential(1e-3, COUNT)
    short, long = line_error(delay_s, 0.0), line_error(delay_s, 100.0)
    assert math.sqrt(long.std_s**2 - short.std_s**2) == pytest.approx(1e-8 * 1e3 / 120**0.5)
    assert short.mean_s == long.mean_s


def test_few_stamps_have_the_uncertainty_of_their_mean_delay() -> None:
    delay_s = np.random.default_rng(2).exponential(1e-3, 60)
    assert line_error(delay_s, 0.0).std_s == pytest.approx(float(np.mean(delay_s)))
