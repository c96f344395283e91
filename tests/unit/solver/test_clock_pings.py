"""Two-way exchanges: the bounds hold the truth, and the times follow them where they must."""

import numpy as np
import pytest
from tests.support.simulated_clocks import PingTrial, latency_bounds_of_samples, ping_trial

from gyrorig_solver.data.clocks import ClockMap, map_clock
from gyrorig_solver.data.clocks.latency_bounds import (
    LatencyBounds,
    PingExchanges,
)

TICK_HZ = 1e6
GRAIN_S = 2e-6  # two roundings to a tick


def mapped(trial: PingTrial) -> tuple[ClockMap, LatencyBounds]:
    clock = map_clock(trial.ticks, trial.host_s, TICK_HZ, 32, np.arange(trial.ticks.size) % 65_536)
    pings = PingExchanges(trial.send_s, trial.receive_s, trial.device_receive, trial.device_send)
    floor = latency_bounds_of_samples(pings, trial.ticks, trial.host_s, clock, TICK_HZ, 32)
    assert floor is not None
    return clock, floor


@pytest.mark.parametrize("seconds", [75.0, 300.0])
@pytest.mark.parametrize("link", ["uart", "usb", "ftdi"])
def test_the_bounds_contain_the_truth(link: str, seconds: float) -> None:
    for seed in range(6):
        trial = ping_trial(link, seed, seconds)
        clock, floor = mapped(trial)
        low, high = floor.bounds_at(clock.time_s)
        latency = clock.time_s - trial.true_s
        assert np.all((low - GRAIN_S <= latency) & (latency <= high + GRAIN_S))
        assert floor.low_s <= floor.midpoint_s <= floor.high_s


def test_times_follow_the_pings_where_the_stream_beats_with_the_frames() -> None:
    """A 400 Hz timer 5 ppm off, USB frames: 108 us of drift that looks like skew."""
    for seed in range(4):
        trial = ping_trial("usb", seed, 75.0, 5e-6, 400.0)
        clock, floor = mapped(trial)
        assert floor.is_drifting
        assert float(np.std(clock.time_s - trial.true_s)) > 80e-6
        two_way_s = clock.time_s - floor.midpoint_at(clock.time_s)
        assert float(np.std(two_way_s - trial.true_s)) < 40e-6


@pytest.mark.parametrize("link", ["uart", "usb"])
def test_times_follow_the_arrivals_if_they_are_better(link: str) -> None:
    for seed in range(4):
        clock, floor = mapped(ping_trial(link, seed, 75.0, 50e-6, 400.0))
        assert not floor.is_drifting
        assert np.ptp(floor.midpoint_at(clock.time_s)) == 0.0


def test_few_pings_give_one_interval_and_fewer_none() -> None:
    trial = ping_trial("uart", 1)
    clock = map_clock(trial.ticks, trial.host_s, TICK_HZ, 32)

    def first(count: int) -> LatencyBounds | None:
        part = slice(0, count)
        pings = PingExchanges(
            trial.send_s[part], trial.receive_s[part],
            trial.device_receive[part], trial.device_send[part],
        )  # fmt: skip
        return latency_bounds_of_samples(pings, trial.ticks, trial.host_s, clock, TICK_HZ, 32)

    assert first(5) is None
    few = first(40)
    assert few is not None
    assert few.two_way is None
    assert np.ptp(few.bounds_at(clock.time_s)[0]) == 0.0
