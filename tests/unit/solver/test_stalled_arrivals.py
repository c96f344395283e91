"""Boards without timestamps: the samples that wait for a stall of the host arrive together."""

import numpy as np

from gyrorig_solver.data.clocks.stalled_arrivals import STALL_FACTOR, times_without_stalls

PERIOD_S, JITTER_S = 0.01, 0.3e-3
COUNT = 70_000  # a counter of 16 bits starts again at zero
STALLS_S = ((20.0, 0.2), (55.0, 0.05), (350.0, 0.15), (690.0, 1.5))  # begin and length
RESTART, OUTAGE_S = 40_000, 5.0


def arrivals(number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return true times and arrival times of samples, with stalls of the host."""
    true_s = number * PERIOD_S
    host_s = true_s + np.random.default_rng(2).exponential(JITTER_S, number.size)
    for begin_s, length_s in STALLS_S:
        waits = (host_s > begin_s) & (host_s < begin_s + length_s)
        host_s[waits] = begin_s + length_s
    return true_s, np.maximum.accumulate(host_s)


def test_samples_that_waited_have_the_times_at_which_they_were_taken() -> None:
    """Before, all samples of a stall had the time of its end."""
    number = np.delete(np.arange(COUNT), np.r_[5510:5513, 30_000:30_040])
    true_s, host_s = arrivals(number)
    times_s = times_without_stalls((number % 2**16).astype(np.uint32), host_s)
    assert np.abs(host_s - true_s).max() > 1.4
    assert np.all(np.diff(times_s) >= 0.0)
    assert np.abs(times_s - true_s).max() < 1.1 * STALL_FACTOR * JITTER_S
    assert np.mean(times_s == host_s) > 0.99


def test_a_restart_of_the_counter_changes_no_times() -> None:
    number = np.arange(COUNT)
    true_s, host_s = arrivals(number)
    true_s[RESTART:] += OUTAGE_S
    host_s[RESTART:] += OUTAGE_S
    counter = np.where(number < RESTART, number, number - RESTART).astype(np.uint32)
    times_s = times_without_stalls(counter, host_s)
    assert np.abs(times_s - true_s).max() < 1.1 * STALL_FACTOR * JITTER_S


def test_samples_that_always_arrive_together_keep_their_arrival_times() -> None:
    number = np.arange(4000)
    host_s = np.asarray((number // 8 + 1) * 8.0 * PERIOD_S, dtype=np.float64)
    assert np.all(times_without_stalls(number.astype(np.uint32), host_s) == host_s)


def test_samples_without_a_counter_keep_their_arrival_times() -> None:
    _, host_s = arrivals(np.arange(4000))
    assert np.all(times_without_stalls(np.zeros(4000, np.uint32), host_s) == host_s)
