"""The draws of a simulation as parts of one process each."""

import pytest

from gyrorig_solver.twin_check.simulation import split_draws


@pytest.mark.parametrize(
    ("draws", "is_twin", "parts"),
    [
        (range(21), True, [range(1), range(1, 11), range(11, 21)]),
        (range(7), False, [range(3), range(3, 7)]),
        (range(2), True, [range(1), range(1, 2)]),
        (range(5, 8), True, [range(5, 6), range(6, 8)]),
    ],
)
def test_draw_0_of_a_twin_is_alone(draws: range, is_twin: bool, parts: list[range]) -> None:
    """`gyrorigd record --sessions` counts up from each draw except 0."""
    assert split_draws(draws, 2, is_twin) == parts
