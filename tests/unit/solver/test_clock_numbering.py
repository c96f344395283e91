"""Numbering against a plain second formulation that holds everything at once."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support import simulated_clocks as sim
from tests.support.simulated_clocks import unwrap_counter

from gyrorig_solver.data.clocks import map_clock, sample_numbering, tick_unwrapping
from gyrorig_solver.data.clocks.lower_envelope import lower_hull
from gyrorig_solver.data.clocks.sample_numbering import number_samples


def plainly(
    sequence: np.ndarray, time_s: np.ndarray, segment: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return numbers and which to keep: first of its number, and above all before it."""
    number, keep, lost = np.zeros(sequence.size, np.int64), np.ones(sequence.size, np.bool_), 0
    for k in np.unique(segment):
        inside = np.flatnonzero(segment == k)
        period = float(np.median(np.diff(time_s[inside]))) if inside.size > 1 else 1.0
        expected = (time_s[inside] - time_s[inside[0]]) / max(period, 1e-9)
        if inside.size > 1 and not np.any(np.diff(sequence[inside].astype(np.int64))):
            number[inside] = np.arange(inside.size)
            continue
        count = unwrap_counter(sequence[inside], expected)
        _, first = np.unique(count, return_index=True)
        alone = np.zeros(inside.size, dtype=np.bool_)
        alone[first] = True
        is_increasing = alone & (
            count >= np.maximum.accumulate(np.where(alone, count, count.min()))
        )
        keep[inside[~is_increasing]] = False
        number[inside] = count - count.min()
        lost += int(count.max() - count.min() + 1 - first.size)
    return number, keep, lost


def agree(sequence: np.ndarray, time_s: np.ndarray, segment: np.ndarray) -> None:
    number, keep, lost = plainly(sequence, time_s, segment)
    for overwrite in (False, True):
        result = number_samples(sequence.copy(), time_s, segment, overwrite=overwrite)
        assert np.array_equal(result.numbers, number)
        assert result.lost == lost
        assert np.array_equal(
            np.ones_like(keep) if result.keep_mask is None else result.keep_mask, keep
        )


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sample_numbering, "PIECE_SAMPLES", 7)


@pytest.mark.usefixtures("small_pieces")
@pytest.mark.parametrize("dtype", [np.uint32, np.int64])
@pytest.mark.parametrize("modulus", [2**16, 2**32])
@pytest.mark.parametrize("seed", range(12))
def test_streams_with_every_fault(seed: int, modulus: int, dtype: type) -> None:
    rng = np.random.default_rng(seed)
    true = np.arange(400)
    true = np.delete(true, rng.choice(400, 20, replace=False))  # lost
    true[rng.integers(200, 380) :] += rng.choice([0, 150_000])  # a long gap
    order = np.arange(true.size)
    for at in rng.choice(np.arange(10, true.size - 10, 5), 6, replace=False):
        order[at : at + 2] = order[at + 1], order[at]  # swapped
    order = np.sort(np.append(order, rng.choice(order[5:-5], 4))) if seed % 3 == 0 else order
    true = true[order]
    time_s = true * 1e-3 + rng.uniform(-1e-5, 1e-5, true.size)
    restart = int(rng.integers(100, 200)) if seed % 2 else true.size
    segment = (np.arange(true.size) >= restart).astype(np.int64)
    sequence: Any = ((true + modulus - 100) % modulus).astype(dtype)
    sequence[restart:] = (true[restart:] - true[restart:].min(initial=400)).astype(dtype)
    agree(sequence, time_s, segment)


@pytest.mark.usefixtures("small_pieces")
@pytest.mark.parametrize("first", [0, 65_500, 2**32 - 50])
@pytest.mark.parametrize("step", [0, 1])
def test_a_regular_counter_and_a_constant_counter(first: int, step: int) -> None:
    modulus = 2**16 if first < 2**16 else 2**32
    sequence = ((first + step * np.arange(300)) % modulus).astype(np.uint32)
    agree(sequence, np.arange(300) * 1e-3, np.zeros(300, np.int64))


def test_numbers_beyond_31_bits_are_not_folded() -> None:
    true = np.array([0, 1, 2, 3 * 10**9, 3 * 10**9 + 1])
    agree(true.astype(np.uint32), true * 1e-3, np.zeros(5, np.int64))


def test_numbers_take_the_memory_of_the_counter() -> None:
    sequence = np.arange(100, 200, dtype=np.uint32)
    time_s = np.asarray(np.arange(100) * 1e-3, np.float64)
    result = number_samples(sequence, time_s, np.zeros(100, np.int64), overwrite=True)
    assert np.shares_memory(result.numbers, sequence)
    assert result.keep_mask is None


@pytest.mark.parametrize("fault", ["none", "wrap", "reset", "clock step", "swapped"])
def test_a_map_in_place_is_the_same_map(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = sim.fault_trial(fault, 3)
    wanted = map_clock(trial.ticks, trial.host_s, sim.TICK_HZ, 32, trial.sequence)
    monkeypatch.setattr(tick_unwrapping, "PIECE_SAMPLES", 1000)
    ticks, host_s = trial.ticks.copy(), trial.host_s.copy()
    result = map_clock(
        ticks, host_s, sim.TICK_HZ, 32, trial.sequence.astype(np.uint32), overwrite=True
    )
    assert np.array_equal(result.time_s, wanted.time_s)
    assert np.array_equal(result.segment, wanted.segment)
    assert result.faults == wanted.faults
    assert np.shares_memory(result.time_s, ticks)
    assert np.max(np.abs(host_s - trial.host_s)) < 1e-10


@given(st.integers(0, 2**32 - 1))
def test_hull_of_pieces_is_the_hull_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.integers(0, 3, 300)).astype(np.float64)
    y = np.round(rng.exponential(3.0, 300) + 0.01 * (x - 100.0) ** 2 * rng.integers(0, 2))
    whole = lower_hull(x, y)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gyrorig_solver.data.clocks.lower_envelope._PIECE_POINTS", 50)
        pieces = lower_hull(x, y)
    assert np.array_equal(x[whole], x[pieces])
    assert np.array_equal(y[whole], y[pieces])


def test_a_counter_of_known_width_has_no_wraps_in_a_long_gap() -> None:
    """200 samples per s, and 600 s without samples: 120000 periods, which are two wraps."""
    sequence = np.arange(2000, dtype=np.uint32)
    time_s = sequence / 200.0 + np.where(sequence < 1000, 0.0, 600.0)
    segment = np.zeros(2000, np.int64)
    sequence[500:] += 1  # a lost sample: the order is not the number
    assert number_samples(sequence, time_s, segment).lost == 2 * 2**16 + 1
    assert number_samples(sequence, time_s, segment, sequence_bits=32).lost == 1
