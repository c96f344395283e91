"""Restarts and clock steps told apart from wraps, swaps, repeats, losses, gaps and stalls."""

import numpy as np
import pytest
from tests.support.simulated_clocks import (
    FAULTS,
    WRAP,
    fault_trial,
    is_misclassified,
    raw_ticks,
    uart_arrivals,
)

from gyrorig_solver.data.clocks import ClockFaultKind, map_clock, unwrap_ticks

TICK_HZ = 1e6


def wrong_trials(fault: str, seeds: range) -> list[int]:
    wrong = []
    for seed in seeds:
        trial = fault_trial(fault, seed)
        clock = unwrap_ticks(trial.ticks, trial.host_s, TICK_HZ, 32, trial.sequence)
        begins = tuple(result.index for result in clock.faults)
        late = np.flatnonzero(clock.late_mask)
        if is_misclassified(trial, begins, clock.steps, late) or clock.wraps != trial.wraps:
            wrong.append(seed)
    return wrong


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found_and_nothing_else(fault: str) -> None:
    """30 trials each; `make bench` runs 300."""
    assert wrong_trials(fault, range(1000, 1030)) == []


@pytest.mark.bench
@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found_300_times(fault: str) -> None:
    assert wrong_trials(fault, range(300)) == []


@pytest.mark.parametrize("fault", [name for name in FAULTS if "reset" not in name][:-1])
def test_no_false_alarm_without_a_sample_counter(fault: str) -> None:
    for seed in range(20):
        trial = fault_trial(fault, seed)
        clock = unwrap_ticks(trial.ticks, trial.host_s, TICK_HZ, 32)
        assert clock.faults == ()


def test_a_pair_swapped_across_the_wrap_of_both_counters() -> None:
    true_s = np.arange(6000) / 100.0
    ticks = raw_ticks(true_s, WRAP - 30_000_000)
    sequence = (np.arange(6000) + 65_536 - 3000) % 65_536
    for counter in (ticks, sequence):
        counter[[2999, 3000]] = counter[[3000, 2999]]
    clock = unwrap_ticks(ticks, true_s, TICK_HZ, 32, sequence)
    assert clock.faults == ()
    assert clock.wraps == 1
    assert np.flatnonzero(clock.late_mask).tolist() == [3000]
    assert np.max(np.abs(np.sort(clock.device_s) - true_s)) < 2e-6


def test_a_host_clock_that_steps_back_is_a_step() -> None:
    """A latency floor cannot fall: the device ran on, its stamps and counter agree."""
    rng = np.random.default_rng(1)
    true_s = np.arange(12_000) / 100.0
    host_s = uart_arrivals(true_s, rng, 3e-4)
    host_s[6000:] -= 0.05
    # As a recording has them: what arrived later is never stamped earlier.
    host_s = np.maximum.accumulate(host_s)
    clock = unwrap_ticks(raw_ticks(true_s), host_s, TICK_HZ, 32, np.arange(12_000) % 65_536)
    assert [result.kind for result in clock.faults] == [ClockFaultKind.STEP]
    assert abs(clock.faults[0].index - 6000) < 30


def test_every_segment_has_times_of_its_own() -> None:
    trial = fault_trial("reset", 3)
    clock = map_clock(trial.ticks, trial.host_s, TICK_HZ, 32, trial.sequence)
    assert clock.segment_count == 2
    assert clock.restarts == 1
    assert clock.latency_s[0] < 1e-3
    assert np.all(np.abs(trial.host_s - clock.time_s) < 0.25)


def test_a_queue_at_the_start_is_no_step() -> None:
    """As a real serial log begins: a few old samples, a third of a second of none, then a burst."""
    true_s = np.arange(3000) / 100.0
    host_s = np.maximum(true_s + 1e-3, 0.55)
    host_s[:12] = true_s[:12] + 0.131
    clock = unwrap_ticks(raw_ticks(true_s), host_s, TICK_HZ, 32, np.arange(3000))
    assert clock.faults == ()
