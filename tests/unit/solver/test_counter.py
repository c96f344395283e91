"""The controller's counter placed on the capture clock, against instants that are known."""

import numpy as np
import pytest

from gyrorig_solver.reference.unit.controller_counter import counter_instants

HZ = 90e6


def exchanges(
    seed: int, seconds: float = 75.0, skew: float = 40e-6, start: int = 2**32 - 10**9
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return true instants, earliest and latest ones, and a 32-bit counter that wraps."""
    rng = np.random.default_rng(seed)
    lo = np.arange(0.0, seconds, 0.02) + rng.exponential(1e-3, int(np.ceil(seconds / 0.02)))
    before = 0.0025 + rng.exponential(2e-4, lo.size)
    after = 0.0025 + rng.exponential(4e-4, lo.size)
    after[rng.integers(0, lo.size, 5)] += 0.15  # stalls of the host
    at = lo + before
    ticks = (start + np.floor(at * (1.0 + skew) * HZ).astype(np.int64)) % 2**32
    return at, lo, at + after, ticks


@pytest.mark.parametrize("seed", range(5))
def test_sampling_times_are_right_up_to_one_constant(seed: int) -> None:
    at, lo, hi, ticks = exchanges(seed)
    result = counter_instants(ticks, lo, hi, HZ)
    assert result is not None
    error = result.at_s - at
    # Two hulls of 3750 points with mean delays of 0.2 and 0.4 ms: some microseconds.
    assert np.std(error) < 3e-6
    assert np.abs(error).max() < result.width_s / 2.0
    assert result.width_s == pytest.approx(0.005, abs=1e-4)
    assert result.skew_ppm == pytest.approx(40.0, abs=0.2)


def test_long_recordings_follow_a_wandering_clock() -> None:
    at, lo, hi, _ = exchanges(9, seconds=600.0)
    wander = 5e-4 * np.sin(2.0 * np.pi * at / 600.0)
    ticks = np.floor((at + wander + 1.0) * HZ).astype(np.int64) % 2**32
    result = counter_instants(ticks, lo, hi, HZ)
    assert result is not None
    assert np.std(result.at_s - at) < 2e-5


def test_a_wrong_nominal_rate_does_not_matter() -> None:
    at, lo, hi, ticks = exchanges(1)
    result = counter_instants(ticks, lo, hi, HZ * 1.01)
    assert result is not None
    assert np.std(result.at_s - at) < 3e-6


def test_an_irregular_counter_is_not_used() -> None:
    _, lo, hi, ticks = exchanges(1)
    assert counter_instants(np.zeros_like(ticks), lo, hi, HZ) is None
    assert counter_instants(ticks[:20], lo[:20], hi[:20], HZ) is None
    again = ticks.copy()
    again[2000:] = again[2000:] - again[2000]
    assert counter_instants(again, lo, hi, HZ) is None
    noise = np.random.default_rng(0).integers(0, 2**32, ticks.size)
    assert counter_instants(noise, lo, hi, HZ) is None
