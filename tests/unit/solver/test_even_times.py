"""Boards without timestamps: their sample times do not contain the jitter of the arrivals."""

import numpy as np
import pytest

from gyrorig_solver.data.clocks.even_times import evenly_spaced

PERIOD_S, JITTER_S = 0.01, 0.3e-3
COUNT = 40_000
GOOD_S = 1e-4  # a third of the jitter


def arrivals(number: np.ndarray, period_s: float = PERIOD_S) -> tuple[np.ndarray, np.ndarray]:
    """Return true times and arrival times of samples; the clock of the sensor is 200 ppm fast."""
    true_s = number * period_s * (1.0 - 200e-6)
    host_s = true_s + np.random.default_rng(2).exponential(JITTER_S, number.size)
    return true_s, np.maximum.accumulate(host_s)


def errors_s(times_s: np.ndarray, true_s: np.ndarray) -> np.ndarray:
    """Return the errors of the times, without the mean latency."""
    return np.asarray(times_s - true_s - np.median(times_s - true_s), dtype=np.float64)


@pytest.mark.parametrize("period_s", [0.01, 0.001])
def test_the_times_do_not_contain_the_jitter_of_the_arrivals(period_s: float) -> None:
    number = np.delete(np.arange(COUNT), np.r_[5510:5513, 30_000:30_040])  # counted losses
    true_s, host_s = arrivals(number, period_s)
    times_s = evenly_spaced((number % 2**16).astype(np.uint32), host_s)
    assert np.abs(errors_s(host_s, true_s)).max() > 2e-3
    assert np.abs(errors_s(times_s, true_s)).max() < GOOD_S


def test_samples_that_are_lost_without_a_gap_delay_the_later_ones() -> None:
    number = np.delete(np.arange(COUNT), [9000, 9010, 9011, 9012, 20_000])
    true_s, host_s = arrivals(number)
    times_s = evenly_spaced(np.arange(number.size).astype(np.uint32), host_s)
    assert np.abs(errors_s(times_s, true_s)).max() < GOOD_S


@pytest.mark.parametrize("lost_share", [0.003, 0.01])
def test_many_samples_are_lost_without_a_gap(lost_share: float) -> None:
    """Before, the times had an error of 1.2 ms at 0.3 %, and were the arrivals at 1 %."""
    is_lost = np.random.default_rng(5).uniform(size=COUNT) < lost_share
    true_s, host_s = arrivals(np.flatnonzero(~is_lost))
    times_s = evenly_spaced(np.arange(true_s.size).astype(np.uint32), host_s)
    assert errors_s(times_s, true_s).std() < JITTER_S / 3.0


def test_a_restart_of_the_counter_changes_no_times() -> None:
    number, restart = np.arange(COUNT), 15_000
    true_s, host_s = arrivals(number)
    true_s[restart:] += 5.0037
    host_s[restart:] += 5.0037
    counter = np.where(number < restart, number, number - restart).astype(np.uint32)
    times_s = evenly_spaced(counter, host_s)
    assert np.abs(errors_s(times_s, true_s)).max() < GOOD_S


def test_samples_without_a_counter_keep_their_times() -> None:
    _, host_s = arrivals(np.arange(4000))
    assert np.all(evenly_spaced(np.zeros(4000, np.uint32), host_s) == host_s)


def test_samples_that_are_not_even_keep_their_times() -> None:
    rng = np.random.default_rng(3)
    host_s = np.cumsum(PERIOD_S * rng.uniform(0.2, 1.8, 4000))
    assert np.all(evenly_spaced(np.arange(4000, dtype=np.uint32), host_s) == host_s)


def test_a_rate_that_drifts_with_the_temperature_is_followed() -> None:
    """500 ppm in 130 s: one straight line is up to 8 ms off."""
    count = 13_000
    period_s = PERIOD_S * (1.0 + 500e-6 * np.arange(count) / count)
    true_s = np.cumsum(period_s)
    host_s = np.maximum.accumulate(true_s + np.random.default_rng(4).exponential(JITTER_S, count))
    line_s = np.polyval(np.polyfit(np.arange(count), true_s, 1), np.arange(count))
    assert np.abs(errors_s(line_s, true_s)).max() > 5e-3
    times_s = evenly_spaced(np.arange(count, dtype=np.uint32), host_s)
    assert np.abs(errors_s(times_s, true_s)).max() < JITTER_S
    assert errors_s(times_s, true_s).std() < JITTER_S / 5.0
