"""Boards of a bus made one time by its edges: against clocks whose truth is known."""

import numpy as np
import pytest

from gyrorig_solver.data.clocks.shared_time_base import (
    MIN_COMMON_EDGES,
    ClockExchanges,
    TimeCorrection,
    fit_shared_time,
)

ORIGIN_NS = 1_790_000_000_000_000_000
LATCH_S = 5e-6  # mean delay of an interrupt
# Simulated reference: 0.42 us between boards with these delays, at 5 Hz and
# 75 s. Room for what is drawn, said before the first run: half as much again over 20 trials.
APART_S = 0.63e-6


class Bus:
    """Boards whose maps are wrong by a line each, and edges that all of them latch."""

    def __init__(self, seed: int, seconds: float = 75.0, boards: int = 6, hz: float = 5.0) -> None:
        rng = np.random.default_rng([51, seed])
        count = int(seconds * hz)
        self.edges_s = np.sort(rng.uniform(0.0, seconds, count))
        # What the host's stamp says is a millisecond off: nothing may hang on it.
        stamps = ORIGIN_NS + np.rint(1e9 * (self.edges_s + rng.exponential(1e-3, count)))
        self.asked_ns = np.unique(stamps.astype(np.int64))
        assert self.asked_ns.size == count
        self.offset_s = rng.normal(scale=5e-6, size=boards)
        self.slope = rng.normal(scale=2e-8, size=boards)
        self.late_ns = np.rint(rng.uniform(0.0, 1e9, boards)).astype(np.int64)  # own origins
        self.rng = rng

    def error_s(self, k: int, at_s: np.ndarray) -> np.ndarray:
        """How late a board's map is."""
        return np.asarray(self.offset_s[k] + self.slope[k] * at_s)

    def seen(self, k: int, keep: np.ndarray | None = None) -> ClockExchanges:
        """What one board has of the edges."""
        latched_s = self.edges_s + self.rng.exponential(LATCH_S, self.edges_s.size)
        time_s = latched_s + self.error_s(k, self.edges_s) - self.late_ns[k] * 1e-9
        use = slice(None) if keep is None else keep
        return ClockExchanges(self.asked_ns[use], time_s[use], ORIGIN_NS + int(self.late_ns[k]))

    def apart_s(self, moved: dict[str, TimeCorrection]) -> float:
        """How far the boards' times are from each other afterwards, rms."""
        at_s = np.linspace(self.edges_s[0], self.edges_s[-1], 400)
        left = []
        for name, shift in moved.items():
            k = int(name)
            own_s = at_s - self.late_ns[k] * 1e-9
            before_s = own_s.copy()
            shift.apply(own_s)
            left.append(self.error_s(k, at_s) + own_s - before_s)
        return float(np.sqrt(np.mean((np.array(left) - np.mean(left, axis=0)) ** 2)))


def test_boards_share_one_time_up_to_the_interrupt_delay() -> None:
    apart = []
    for seed in range(20):
        bus = Bus(seed)
        moved = fit_shared_time({str(k): bus.seen(k) for k in range(6)})
        assert len(moved) == 6
        apart.append(bus.apart_s(moved))
        assert all(shift.board_count == 6 for shift in moved.values())
    assert np.sqrt(np.mean(np.square(apart))) < APART_S


def test_the_time_that_all_share_is_the_mean_of_their_own() -> None:
    bus = Bus(3)
    moved = fit_shared_time({str(k): bus.seen(k) for k in range(6)})
    at_s = np.linspace(5.0, 70.0, 50)
    late = [
        shift.late.delay_at(at_s - bus.late_ns[int(name)] * 1e-9) for name, shift in moved.items()
    ]
    assert np.mean(late, axis=0) == pytest.approx(np.zeros(50), abs=1e-9)


def test_edges_that_a_board_missed_are_the_others() -> None:
    bus = Bus(4)
    boards = {}
    for k in range(6):
        keep = bus.rng.random(bus.edges_s.size) < 0.7
        boards[str(k)] = bus.seen(k, keep)
    moved = fit_shared_time(boards)
    assert len(moved) == 6
    assert bus.apart_s(moved) < 2.0 * APART_S


def test_a_late_interrupt_does_not_move_the_time() -> None:
    """One in twenty a millisecond late: a hundred times as far as the rest."""
    for seed in range(5):
        bus = Bus(40 + seed)
        boards = {str(k): bus.seen(k) for k in range(6)}
        for board in boards.values():
            board.time_s[bus.rng.random(board.time_s.size) < 0.05] += 1e-3
        assert bus.apart_s(fit_shared_time(boards)) < 3.0 * APART_S


def test_hours_are_followed_by_a_chain_of_lines() -> None:
    """Maps that wander by tens of microseconds over two hours."""
    bus = Bus(6, seconds=7200.0, boards=4)
    boards = {}
    for k in range(4):
        seen = bus.seen(k)
        seen.time_s[:] += 20e-6 * np.sin(bus.edges_s / 900.0 + k)
        boards[str(k)] = seen
    moved = fit_shared_time(boards)
    at_s = np.linspace(60.0, 7100.0, 500)
    left = [
        bus.error_s(k, at_s)
        + 20e-6 * np.sin(at_s / 900.0 + k)
        - moved[str(k)].late.delay_at(at_s - bus.late_ns[k] * 1e-9)
        for k in range(4)
    ]
    apart = np.array(left) - np.mean(left, axis=0)
    assert np.sqrt(np.mean(apart**2)) < 1.5e-6


def test_a_board_absent_for_long_keeps_its_time() -> None:
    bus = Bus(11, seconds=600.0, boards=4)
    boards = {str(k): bus.seen(k) for k in range(3)}
    boards["3"] = bus.seen(3, bus.edges_s < 250.0)
    moved = fit_shared_time(boards)
    assert set(moved) == {"0", "1", "2"}
    assert bus.apart_s(moved) < 2.0 * APART_S


def test_boards_without_common_edges_keep_their_time() -> None:
    bus, other = Bus(7), Bus(8)
    assert fit_shared_time({"0": bus.seen(0)}) == {}
    assert fit_shared_time({"0": bus.seen(0), "1": other.seen(1)}) == {}
    few = np.arange(bus.edges_s.size) < MIN_COMMON_EDGES - 1
    assert fit_shared_time({"0": bus.seen(0), "1": bus.seen(1, few)}) == {}
    three = {"0": bus.seen(0), "1": bus.seen(1), "far": other.seen(2)}
    assert set(fit_shared_time(three)) == {"0", "1"}


def test_each_bus_has_a_time_of_its_own() -> None:
    first, two = Bus(9), Bus(10)
    boards = {f"a{k}": first.seen(k) for k in range(3)} | {f"b{k}": two.seen(k) for k in range(2)}
    both = fit_shared_time(boards)
    assert {name: result.board_count for name, result in both.items()} == {
        "a0": 3, "a1": 3, "a2": 3, "b0": 2, "b1": 2,
    }  # fmt: skip
    apart = fit_shared_time({name: seen for name, seen in boards.items() if name.startswith("a")})
    for name, result in apart.items():
        assert both[name].late.delay_s == pytest.approx(result.late.delay_s, abs=1e-15)
