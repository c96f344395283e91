"""Unwrapping and envelopes against brute force and against simulated clocks."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from tests.support.simulated_clocks import latency_bounds_of_samples, unwrap_counter

from gyrorig_solver.data.clocks import map_clock, unwrap_ticks
from gyrorig_solver.data.clocks.latency_bounds import PingExchanges
from gyrorig_solver.data.clocks.lower_envelope import hull_line, lower_hull, piecewise_envelope

WRAP = 2**32


def simulated_clock(
    seconds: float, rate_hz: float, mean_s: float, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True time, ticks (1 MHz, wrapping) and arrivals with stalls, as in the notes."""
    rng = np.random.default_rng(seed)
    n = int(seconds * rate_hz)
    true = np.arange(n) / rate_hz
    skew = 50e-6 + np.cumsum(rng.normal(size=n)) * 1e-8 / np.sqrt(rate_hz)
    device = true + np.cumsum(skew) / rate_hz
    host = true + rng.exponential(mean_s, n)
    for at in np.cumsum(rng.exponential(20.0, int(seconds / 10.0) + 5)):
        length = rng.uniform(0.005, 0.2)
        stalled = (host > at) & (host < at + length)
        host[stalled] = at + length
    ticks = (np.floor(device * 1e6).astype(np.int64) + WRAP - 5_000_000) % WRAP
    return true, ticks, np.maximum.accumulate(host)


@settings(deadline=None, max_examples=60)
@given(
    points=st.lists(
        st.tuples(st.integers(0, 400), st.floats(0.0, 10.0, width=32)), min_size=3, max_size=900
    )
)
def test_lower_hull_lies_below_every_point(points: list[tuple[int, float]]) -> None:
    x, y = np.array(sorted(points), dtype=float).T
    corners = lower_hull(x, y)
    assert np.all(y - np.interp(x, x[corners], y[corners]) > -1e-9)


def test_lower_hull_agrees_with_qhull() -> None:
    rng = np.random.default_rng(3)
    x, y = np.sort(rng.uniform(0.0, 1.0, 5000)), rng.exponential(1.0, 5000)
    y += x
    corners = lower_hull(x, y)
    hull = set(ConvexHull(np.column_stack([x, y])).vertices.tolist())
    assert set(corners.tolist()) <= hull


def test_hull_line_is_the_linear_programme_of_moon() -> None:
    """Moon, Skelly and Towsley 1999: the line under all points with least distances."""
    rng = np.random.default_rng(4)
    x = np.sort(rng.uniform(0.0, 75.0, 300))
    y = 2.0 + 3e-5 * x + rng.exponential(1e-3, 300)
    exact: Any = linprog(
        [-float(x.sum()), -300.0],
        A_ub=np.column_stack([x, np.ones(300)]),
        b_ub=y,
        bounds=[(None, None)] * 2,
    )
    ends = np.array([x[0], x[-1]])
    assert np.allclose(hull_line(x, y).delay_at(ends), exact.x[0] * ends + exact.x[1], atol=1e-9)


@pytest.mark.parametrize(("seconds", "rate_hz"), [(75.0, 400.0), (75.0, 100.0), (600.0, 100.0)])
@pytest.mark.parametrize("seed", [0, 1])
def test_mapping_wanders_little(seconds: float, rate_hz: float, seed: int) -> None:
    """A line under n exponential delays errs by at most 3 mu/n; ticks are 1 us."""
    true, ticks, host = simulated_clock(seconds, rate_hz, 0.3e-3, seed)
    clock = map_clock(ticks, host, 1e6, 32)
    wander_s = float(np.std(clock.time_s - true))
    assert wander_s < 3.0 * 0.3e-3 / (min(seconds, 120.0) * rate_hz) + 1e-6
    assert clock.wraps == 1
    assert clock.restarts == 0
    assert clock.skew_ppm == pytest.approx(50.0, abs=1.0)


def test_a_swapped_pair_is_not_a_wrap() -> None:
    _, ticks, host = simulated_clock(60.0, 100.0, 0.3e-3, 2)
    ticks[[2000, 2001]] = ticks[[2001, 2000]]
    clock = unwrap_ticks(ticks, host, 1e6, 32)
    assert clock.restarts == 0
    assert clock.late_mask.nonzero()[0].tolist() == [2001]


@pytest.mark.parametrize("gap_s", [1.0, 600.0, 4000.0, 10_800.0])
def test_gaps_with_wraps_are_not_restarts(gap_s: float) -> None:
    _, ticks, host = simulated_clock(60.0, 100.0, 0.3e-3, 5)
    later = np.arange(6000) >= 3000
    ticks = np.where(later, (ticks + round(gap_s * 1e6)) % WRAP, ticks)
    clock = unwrap_ticks(ticks, np.where(later, host + gap_s, host), 1e6, 32)
    assert clock.restarts == 0
    assert clock.device_s[-1] == pytest.approx(gap_s + 60.0, abs=0.1)


@pytest.mark.parametrize("uptime_s", [30.0, 100.0, 5000.0])
def test_a_restart_is_found(uptime_s: float) -> None:
    rng = np.random.default_rng(8)
    t = np.arange(6000) / 100.0
    ticks = np.where(t < 30.0, (t + uptime_s) * 1e6, (t - 29.0) * 1e6).astype(np.int64) % WRAP
    clock = unwrap_ticks(ticks, t + rng.exponential(3e-4, t.size), 1e6, 32)
    assert clock.restarts == 1
    assert int(np.flatnonzero(np.diff(clock.segment))[0]) == 2999


@given(start=st.integers(0, 65535), lost=st.integers(0, 200_000))
def test_sequence_numbers_unwrap_over_gaps(start: int, lost: int) -> None:
    true = np.concatenate([np.arange(50), 50 + lost + np.arange(50)])
    result = unwrap_counter((start + true) % 65536, true * 1.001)
    assert np.array_equal(result, true)


def test_piecewise_envelope_stays_below_and_follows_a_bend() -> None:
    rng = np.random.default_rng(6)
    x = np.arange(0.0, 300.0, 0.01)
    floor = np.where(x < 150.0, 1e-6 * x, 150e-6 + 3e-6 * (x - 150.0))
    y = floor + rng.exponential(3e-4, x.size)
    envelope = piecewise_envelope(x, y, 10.0, 1e3)
    assert np.all(y - envelope.delay_at(x) > -1e-9)
    assert float(np.std(envelope.delay_at(x) - floor)) < 2e-6


@pytest.mark.parametrize("seed", range(5))
def test_pings_hold_the_least_latency_between_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    floor_s, up_s = 0.7e-3, 0.5e-3
    true = np.arange(6000) / 100.0
    ticks = np.floor(true * 1e6 * (1.0 + 40e-6)).astype(np.int64) % WRAP
    host = np.maximum.accumulate(true + floor_s + rng.exponential(3e-4, true.size))
    clock = map_clock(ticks, host, 1e6, 32)
    sent = np.sort(rng.uniform(1.0, 59.0, 300))
    received = sent + up_s + rng.exponential(3e-4, 300)
    answered = received + 1e-4
    pings = PingExchanges(
        sent,
        answered + floor_s + rng.exponential(3e-4, 300),
        np.floor(received * 1e6 * (1.0 + 40e-6)).astype(np.int64),
        np.floor(answered * 1e6 * (1.0 + 40e-6)).astype(np.int64),
    )
    bounds = latency_bounds_of_samples(pings, ticks, host, clock, 1e6, 32)
    assert bounds is not None
    shift = float(np.mean(clock.time_s - true))
    assert bounds.low_s - 2e-6 < shift < bounds.high_s + 2e-6
    assert bounds.midpoint_s == pytest.approx(
        (floor_s - up_s) / 2.0 + (floor_s + up_s) / 2.0, abs=2e-4
    )
