"""The choice of a floor, its two methods against each other, and what it says of itself."""

from collections.abc import Callable

import numpy as np
import pytest
from tests.support import simulated_clocks as sim

from gyrorig_solver.data.clocks import map_clock
from gyrorig_solver.data.clocks.clock_smoother import (
    DelayWindows,
    _rts_smoother,
    least_delays,
    smooth_clock,
)
from gyrorig_solver.data.clocks.latency_floor import (
    LatencyFloor,
    find_latency_floor,
    wander_bound_s,
)
from gyrorig_solver.data.clocks.lower_envelope import Envelope, hull_line

MEAN_S = 3e-4


def crystal(
    seconds: float, rate_hz: float, seed: int, walk: float = 1e-8
) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    true_s = np.arange(int(seconds * rate_hz)) / rate_hz
    return true_s, sim.device_clock(true_s, rng, 50e-6, walk), rng


def wander_s(floor: LatencyFloor | Envelope, x: np.ndarray, true_s: np.ndarray) -> float:
    envelope = floor.envelope if isinstance(floor, LatencyFloor) else floor
    return float(np.std(x + envelope.delay_at(x) - true_s))


@pytest.mark.parametrize("walk", [1e-8, 1e-7])
def test_both_methods_reach_their_accuracy_limits(walk: float) -> None:
    """Section 10: envelope <= 0.8 e*, smoother <= 2 e*; here in 10 min instead of 30."""
    true_s, x, rng = crystal(600.0, 100.0, 5, walk)
    y = sim.uart_arrivals(true_s, rng, MEAN_S) - x
    best_s = wander_bound_s(MEAN_S, 0.01, walk)
    floor = find_latency_floor(x, y)
    second = smooth_clock(x, y, hull_line(x, y), MEAN_S)
    assert floor.method == "envelope"
    assert floor.structure_reason == ""
    assert wander_s(floor, x, true_s) < 0.8 * best_s
    assert second is not None
    assert wander_s(second.floor, x, true_s) < 2.0 * best_s
    assert walk / 5.0 < second.walk_per_sqrt_s < walk * 5.0
    assert floor.sigma_s < 3.0 * wander_s(floor, x, true_s)


def test_the_smoother_is_used_for_delays_rarely_near_the_floor() -> None:
    true_s, x, rng = crystal(600.0, 400.0, 6)
    floor = find_latency_floor(x, sim.add_stalls(true_s + rng.gamma(3, 1e-4, true_s.size), rng) - x)
    assert floor.method == "smoother"
    assert floor.structure_reason == ""
    assert wander_s(floor, x, true_s) < 3e-6


def plain(true_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return sim.uart_arrivals(true_s, rng, MEAN_S)


@pytest.mark.parametrize(
    ("seconds", "skew", "link", "structured"),
    [
        (75.0, 50e-6, sim.usb_arrivals, True),
        (600.0, 50e-6, sim.usb_arrivals, True),
        (900.0, 5e-6, sim.usb_arrivals, True),
        (75.0, 50e-6, plain, False),
        (600.0, 50e-6, plain, False),
    ],
)
def test_a_beat_with_usb_frames_is_structured_latency(
    seconds: float,
    skew: float,
    link: Callable[[np.ndarray, np.random.Generator], np.ndarray],
    structured: bool,
) -> None:
    """A 400 Hz timer against 1 ms frames: a sawtooth of 1 ms / skew."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        true_s = np.arange(int(seconds * 400.0)) / 400.0 / (1.0 + skew)
        x = sim.device_clock(true_s, rng, skew, 1e-8)
        floor = find_latency_floor(x, link(true_s, rng) - x)
        assert bool(floor.structure_reason) is structured
        assert wander_s(floor, x, true_s) < 20e-6


def test_the_smoother_is_the_least_squares_solution() -> None:
    """Against one dense system of all states, solved by numpy."""
    rng = np.random.default_rng(2)
    at_s = np.cumsum(rng.uniform(0.5, 3.0, 40))
    value, excess = rng.normal(0.0, 1e-5, 40), np.full(40, 2e-6)
    walk = 3e-6
    result, sigma_s = _rts_smoother(
        DelayWindows(at_s, value, excess, 0.0), walk, np.ones(40, np.bool_)
    )
    weight = np.zeros((80, 80))
    right = np.zeros(80)
    weight[0, 0], weight[1, 1] = 1.0, 1e6  # the filter's first state: 1 s, 1e-3
    right[0] = value[0]
    for k in range(40):
        weight[2 * k, 2 * k] += 1.0 / excess[k] ** 2
        right[2 * k] += value[k] / excess[k] ** 2
    for k, dt in enumerate(np.diff(at_s)):
        noise = walk**2 * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
        step = np.hstack([-np.array([[1.0, dt], [0.0, 1.0]]), np.eye(2)])
        weight[2 * k : 2 * k + 4, 2 * k : 2 * k + 4] += step.T @ np.linalg.solve(noise, step)
    state = np.linalg.solve(weight, right)
    assert np.allclose(result.delay_s, state[::2], rtol=0.0, atol=1e-10)
    assert np.allclose(sigma_s, np.sqrt(np.diag(np.linalg.inv(weight))[::2]), rtol=1e-3)


def test_least_delays_of_windows_with_gaps() -> None:
    x = np.concatenate([np.arange(0.0, 3.0, 0.1), np.arange(10.0, 12.0, 0.1)])
    flat = Envelope(np.array([0.0, 12.0]), np.zeros(2))
    windows = least_delays(x, np.where(x > 5.0, 2.0, 1.0), flat, 1.0, 0.0)
    assert windows.at_s.tolist() == [0.5, 1.5, 2.5, 10.5, 11.5]
    assert windows.least_s.tolist() == [1.0, 1.0, 1.0, 2.0, 2.0]


def test_a_gap_of_hours_keeps_both_sides() -> None:
    rng = np.random.default_rng(9)
    true_s = np.arange(60_000) / 100.0
    true_s[30_000:] += 7000.0
    sequence = np.round(true_s * 100.0).astype(np.int64) % 65_536
    x = sim.device_clock(true_s, rng, 20e-6, 1e-8)
    clock = map_clock(sim.raw_ticks(x), sim.uart_arrivals(true_s, rng, MEAN_S), 1e6, 32, sequence)
    assert clock.faults == ()
    assert clock.wraps == 1
    for side in (slice(0, 30_000), slice(30_000, None)):
        assert float(np.std(clock.time_s[side] - true_s[side])) < 2e-6


def test_stamps_that_are_the_arrivals_themselves() -> None:
    host_s = np.cumsum(np.random.default_rng(1).uniform(0.005, 0.015, 30_000))
    ticks = np.rint(host_s * 1e9).astype(np.int64)
    clock = map_clock(ticks, host_s, 1e9, 64, np.arange(30_000))
    assert clock.faults == ()
    assert clock.structure_reason == ""
    assert np.max(np.abs(clock.time_s - host_s)) < 2e-9
