"""The order of a fit's parameters: blocks of boards, recordings and unit-wide causes."""

import numpy as np
import pytest

from gyrorig_solver.estimate import ParameterLayout, free_term
from gyrorig_solver.estimate.fitted_term import fixed_term
from gyrorig_solver.estimate.parameter_layout import eliminate_parameters
from gyrorig_solver.model import find_term

UNIT_CAUSE, BOARD_CAUSE = "axis_nonorthogonality", "scale_quadratic"


def test_one_board_and_recording_has_the_order_of_its_equations() -> None:
    layout = ParameterLayout.of([[free_term(find_term(BOARD_CAUSE))]], 1)
    assert layout.index(0).tolist() == list(range(layout.size))
    assert layout.parameter_names[:13] == (
        *(f"gain.{row}{column}" for row in "xyz" for column in "xyz"),
        *("bias.x", "bias.y", "bias.z", "time_offset"),
    )
    assert layout.prior_std.shape == (layout.size,)


def test_each_recording_has_a_bias_and_a_time_offset() -> None:
    layout = ParameterLayout.of([[free_term(find_term(BOARD_CAUSE))]], 3)
    columns = [set(layout.index(k).tolist()) for k in range(3)]
    terms = set(layout.term_index().tolist())
    common = columns[0] & columns[1] & columns[2]
    assert common == {*range(9), *terms}
    assert set().union(*columns) == set(range(layout.size))
    assert set(layout.session_index().tolist()) == set(range(9, 21))
    assert layout.index(2, offset_recording=0)[12] == layout.index(0)[12]
    assert layout.parameter_names[9] == "bias.x of recording 1"


def test_boards_share_a_unit_wide_cause_only() -> None:
    terms = [free_term(find_term(UNIT_CAUSE)), free_term(find_term(BOARD_CAUSE))]
    layout = ParameterLayout.of([terms, terms], 2, [UNIT_CAUSE])
    first, second = (set(layout.board_index(k).tolist()) for k in range(2))
    shared = layout.term_blocks(0)[0]
    assert shared is layout.term_blocks(1)[0]
    assert (shared.scope, shared.board) == ("unit", None)
    assert first & second == set(shared.positions)
    assert first | second == set(range(layout.size))
    for board in range(2):
        for recording in range(2):
            assert set(layout.index(recording, board)) <= set(layout.board_index(board).tolist())
    assert layout.parameter_names[shared.start].startswith(UNIT_CAUSE)
    assert layout.parameter_names[0].endswith("of board 1")


def test_a_cause_that_one_board_holds_is_not_shared() -> None:
    free, held = free_term(find_term(UNIT_CAUSE)), fixed_term(find_term(UNIT_CAUSE))
    layout = ParameterLayout.of([[free], [held]], 1, [UNIT_CAUSE])
    assert layout.term_blocks(1)[0].size == 0
    assert not layout.is_shared(layout.board_index(1)).any()


@pytest.mark.parametrize("keep", [[0, 2], [1], [3, 0, 1]])
def test_elimination_is_the_inverse_of_a_part_of_the_covariance(keep: list[int]) -> None:
    factor = np.random.default_rng(3).normal(size=(4, 9))
    information = factor @ factor.T
    index = np.array(keep)
    reduced = eliminate_parameters(information, index, np.full(4, 1e6))
    wanted = np.linalg.inv(np.linalg.inv(information)[np.ix_(index, index)])
    assert reduced == pytest.approx(wanted, rel=1e-9)
