"""How well the time of something that happened once is known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.refit import Weighed
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import best_fit
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import term
from gyrorig_solver.on_unit import unit_solution


@pytest.fixture(scope="module")
def weighed(hidden: Callable[..., Any]) -> Callable[[str], Weighed]:
    """Return a function that fits the cause that a session hides."""

    def fit(hide: str) -> Weighed:
        session = hidden(hide)
        projection = Projection.of(unit_solution([session.recording], session.board))
        one = term(hide.partition(":")[0].partition("@")[0])
        found = best_fit(projection, sights(projection, [one], 1, all_rows(projection, one)))
        assert found is not None
        return found[0]

    return fit


def test_a_loss_in_a_move_is_timed_as_finely_as_its_pulse(
    weighed: Callable[[str], Weighed],
) -> None:
    one = weighed("lost_steps@pan:8")
    assert one.event_std is not None
    assert 1e-6 < one.event_std < 0.01


def test_a_slip_is_timed_no_finer_than_the_noise_lets_it(
    weighed: Callable[[str], Weighed],
) -> None:
    """A turn of 0.7 deg shows 1 % of a rate elsewhere: the noise hides a good while of it."""
    one = weighed("board_slip:0.012")
    assert one.event_std is not None
    assert 0.01 < one.event_std < 5.0


def test_a_smaller_step_is_timed_worse(weighed: Callable[[str], Weighed]) -> None:
    large, small = weighed("bias_step:0.01"), weighed("bias_step:0.002")
    assert large.event_std is not None
    assert small.event_std is not None
    assert large.event_std < small.event_std


def test_what_is_always_there_has_no_time(weighed: Callable[[str], Weighed]) -> None:
    one = weighed("backlash@tilt:0.0012")
    assert one.event_std is None
    assert np.isfinite(one.std).all()
