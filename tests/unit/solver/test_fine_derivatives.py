"""The derivatives on the fine grid are those of the prediction."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.unit.solver.made import reference_of, samples_of

from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.motion_fit import create_session
from gyrorig_solver.estimate.reference_prediction import predict_derivatives, predict_rate

SHIFT_S = 1e-4

Simulate = Callable[..., Any]


@pytest.fixture(scope="module")
def board(simulate: Simulate) -> BoardFit:
    rig = simulate(3)
    session = create_session(samples_of(rig.time_s, rig.rate_rad_s), reference_of(rig), None)
    return BoardFit.started([session], ())


def test_derivatives_on_the_fine_grid_are_those_of_the_prediction(board: BoardFit) -> None:
    (session,) = board.sessions
    (series,) = session.series
    (blocks,) = series.part_slices()

    def means(lag_s: float) -> np.ndarray:
        sampled = predict_rate(series, blocks, session.reference, lag_s)
        return series.block_means(sampled.rate, sampled.known)

    difference = (means(-SHIFT_S) - means(SHIFT_S)) / (2.0 * SHIFT_S)
    errors = [
        np.linalg.norm(
            predict_derivatives(series, blocks, session.reference, 0.0, fine).time_derivative.T
            - difference
        )
        for fine in (False, True)
    ]
    assert errors[1] < 2e-3 * np.linalg.norm(difference)
    assert errors[1] < 0.1 * errors[0]


def test_new_derivatives_become_finer_once(board: BoardFit) -> None:
    assert board.renew_derivatives()
    assert not board.renew_derivatives()
