"""Recursive filters, against scipy.signal."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.model.recursive_filters import (
    filter_from_rest,
    filter_from_steady,
    ramp_invariant,
    step_invariant,
)

BUTTERWORTH = float(np.sqrt(0.5))


def _signal(*shape: int) -> np.ndarray:
    return np.random.default_rng(7).standard_normal(shape) + 3.0


@pytest.mark.parametrize(("hz", "rate_hz"), [(25.0, 104.0), (25.0, 520.0), (110.0, 4000.0)])
def test_a_second_order_filter(hz: float, rate_hz: float) -> None:
    b, a = ramp_invariant(2.0 * np.pi * hz, BUTTERWORTH, 1.0 / rate_hz)
    signal = _signal(2, 3, 900)
    assert filter_from_rest(b, a, signal) == pytest.approx(lfilter(b, a, signal), abs=1e-11)
    begun = lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[..., :1])[0]
    assert filter_from_steady(b, a, signal) == pytest.approx(begun, abs=1e-11)


@pytest.mark.parametrize("length", [1, 31, 32, 33, 400])
def test_a_filter_of_first_order(length: int) -> None:
    signal = _signal(length)
    wanted = lfilter([1.0], [1.0, -0.8], signal)
    assert filter_from_rest(np.ones(1), np.array([1.0, -0.8]), signal) == pytest.approx(wanted)


@pytest.mark.parametrize("damping", [0.0, 0.003, 0.3])
def test_a_resonance_rings_on_over_many_blocks(damping: float) -> None:
    b, a = step_invariant(2.0 * np.pi * 17.0, damping, 0.004)
    signal = _signal(2, 20_000)
    wanted = lfilter(b, a, signal)
    size = float(np.max(np.abs(wanted)))
    assert filter_from_rest(b, a, signal) == pytest.approx(wanted, abs=1e-11 * size)


def test_input_is_not_changed() -> None:
    b, a = ramp_invariant(100.0, BUTTERWORTH, 0.01)
    signal = _signal(3, 50)
    before = signal.copy()
    (
        filter_from_rest(b, a, signal),
        filter_from_steady(b, a, signal),
        filter_from_steady(b, a, signal, 5, 2),
    )
    filter_from_rest(np.ones(1), np.array([1.0, -0.8]), signal)
    assert np.array_equal(signal, before)


@pytest.mark.parametrize("step", [1, 3, 5, 9])
@pytest.mark.parametrize("blocks", [1, 2, 300])
@pytest.mark.parametrize("longer", [(1.0,), (-0.125, 1.25, -0.125)])
def test_decimated_outputs_match_the_full_filter(
    step: int, blocks: int, longer: tuple[float, ...]
) -> None:
    b, a = ramp_invariant(2.0 * np.pi * 25.0, BUTTERWORTH, 1.0 / (100.0 * step))
    b = np.convolve(b, longer)
    signal = _signal(2, 3, step * blocks)
    every = filter_from_steady(b, a, signal)
    for at in {0, step // 2, step - 1}:
        decimated = filter_from_steady(b, a, signal, step, at)
        assert decimated == pytest.approx(every[..., at::step], abs=1e-11)


@pytest.mark.parametrize("hz", [5.0, 25.0, 300.0])
def test_ramp_invariant_matches_scipy(hz: float) -> None:
    w = 2.0 * np.pi * hz
    analogue = (np.array([w**2]), np.array([1.0, np.sqrt(2.0) * w, w**2]))
    numerator, denominator, _ = cont2discrete(analogue, 0.004, method="foh")
    b, a = ramp_invariant(w, BUTTERWORTH, 0.004)
    assert b == pytest.approx(numerator.ravel(), rel=1e-9)
    assert a == pytest.approx(denominator, rel=1e-12)


@pytest.mark.parametrize("damping", [0.0, 0.03, 0.25, 0.9])
def test_step_invariant_matches_scipy(damping: float) -> None:
    w = 2.0 * np.pi * 17.0
    analogue = (np.array([1.0]), np.array([1.0, 2.0 * damping * w, w * w]))
    numerator, denominator, _ = cont2discrete(analogue, 0.004)
    b, a = step_invariant(w, damping, 0.004)
    assert b * w**2 == pytest.approx(numerator.ravel() * w**2, abs=1e-10)
    assert a == pytest.approx(denominator, abs=1e-12)


@pytest.mark.parametrize(
    ("bandwidth_hz", "rate_hz", "length", "blocks"),
    [(110.0, 500.0, 5, 300), (25.0, 500.0, 5, 100), (12.5, 400.0, 4, 400), (110.0, 800.0, 8, 1)],
)
def test_block_means_of_a_filter_are_those_of_its_outputs(
    bandwidth_hz: float, rate_hz: float, length: int, blocks: int
) -> None:
    means = np.cumsum(np.random.default_rng(1).standard_normal((2, 3, length * blocks)), axis=-1)
    low_pass = LowPass(bandwidth_hz, rate_hz)
    expected = low_pass.apply_to_means(means).reshape(2, 3, blocks, length).mean(axis=-1)
    assert low_pass.apply_to_blocks(means, length) == pytest.approx(expected, rel=1e-11, abs=1e-11)
