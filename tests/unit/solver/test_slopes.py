"""Derivatives carried from order to order against differences of the whole course."""

import numpy as np
import pytest

from gyrorig_solver.reference.unit.profile_derivatives import differentiate_move
from gyrorig_solver.reference.unit.unit_moves import MotionCommand, Move

CLASSES = 3
# A start that changes nothing: carried terms of some 2500 steps/s cancel to 1e-5 of them.
TINY = 0.025
TIME_S = np.linspace(-0.5, 12.0, 1500)


def made(seed: int) -> Move:
    """A move of two to seven orders; some are dated before the one ahead of them."""
    rng = np.random.default_rng(seed)
    at_s, orders = 0.0, []
    for k in range(int(rng.integers(2, 8))):
        kind = "to" if k == 0 else str(rng.choice(["to", "keep", "stop"]))
        steps, speed = float(rng.integers(-3000, 3000)), float(rng.uniform(50.0, 2500.0))
        orders.append(MotionCommand(at_s, at_s, kind, steps, speed, int(rng.integers(0, CLASSES))))  # type: ignore[arg-type]
        at_s += float(rng.uniform(0.0, 1.0)) if rng.random() < 0.9 else -0.01
    base = float(rng.choice([0.0, 100.0, 700.0]))
    return Move(0, 0, 0, tuple(orders), float(rng.uniform(500.0, 8000.0)), base)


def difference(move: Move, at: int, step: float) -> np.ndarray:
    """Return the change with one of starts, log speeds and log acceleration, by courses."""
    ends = []
    for sign in (1.0, -1.0):
        change = np.zeros(len(move.commands) + CLASSES + 1)
        change[at] = sign * step
        starts_s, rest = (
            move.start_times_s + change[: len(move.commands)],
            change[len(move.commands) :],
        )
        ends.append(move.profile(starts_s, rest[:-1], float(rest[-1])).position_steps(TIME_S))
    return np.asarray((ends[0] - ends[1]) / (2.0 * step))


@pytest.mark.parametrize("seed", range(40))
def test_slopes_are_the_differences_of_the_whole_course(seed: int) -> None:
    move = made(seed)
    orders = len(move.commands)
    result = differentiate_move(move, move.start_times_s, np.zeros(CLASSES), 0.0, TIME_S)
    assert result.speeds.shape == (len(move.speed_classes), TIME_S.size)
    output = [
        *((result.starts[k], difference(move, k, 1e-5)) for k in range(orders)),
        *(
            (result.speeds[row], difference(move, orders + c, 1e-5))
            for row, c in enumerate(move.speed_classes)
        ),
        (result.acceleration, difference(move, orders + CLASSES, 1e-5)),
    ]
    for slope, expected in output:
        off = np.abs(slope - expected) > 2e-3 * np.abs(expected).max() + TINY
        # A difference smears what jumps at a leg's begin.
        assert off.mean() < 0.02


def test_many_orders_cost_no_more_than_their_number() -> None:
    """The last of a hundred orders: later ones only move with the state that it leaves."""
    orders = tuple(
        MotionCommand(0.2 * k, 0.2 * k, "to", 1500.0 * float(np.sin(0.14 * k)) + 1.0, 900.0, 0)
        for k in range(100)
    )
    move = Move(0, 0, 0, orders, 4000.0, 100.0)
    time_s = np.linspace(0.0, 25.0, 2000)
    result = differentiate_move(move, move.start_times_s, np.zeros(1), 0.0, time_s)
    # All starts together shift the course.
    course = move.profile(move.start_times_s, np.zeros(1), 0.0)
    together = result.starts.sum(axis=0) + course.speed_steps_s(time_s)
    assert np.mean(np.abs(together) > 1.0) < 0.02
