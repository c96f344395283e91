"""A name that a free function of what is left makes needless is not said."""

from collections.abc import Callable

from tests.unit.discover.conftest import Hidden

from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.finder import FILLS
from gyrorig_solver.discover.name_tests import fillers
from gyrorig_solver.discover.outdone import outdone
from gyrorig_solver.discover.result import Signature
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import Found, best_fit, standing_of
from gyrorig_solver.estimate.likelihood import solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.on_unit import unit_solution

TESTS = 60
OF_RATES = Signature("own_rate", "on the rates about the axes", 200.0, 24, 0.0)


def _named(hidden: Hidden, cause: str) -> Found:
    """Return where a search ends that knows this cause alone."""
    base = unit_solution([hidden.recording], hidden.board)
    term = catalogue()[cause]
    beside = Projection.of(base)
    best = best_fit(beside, sights(beside, [term], TESTS, all_rows(beside, term)))
    assert best is not None
    solution = solve_again(base, [best[0].extension])
    standing = standing_of(solution, 0, [term], TESTS)
    return Found(solution, (standing,), Projection.of(solution), ())


def test_a_slip_is_not_said_for_what_hangs_on_the_rates(hidden: Callable[..., Hidden]) -> None:
    found = _named(hidden("scale_asymmetry:0.01"), "board_slip")
    assert found.standings[0].best.won > 20.0  # nats
    assert fillers(found, [OF_RATES], FILLS) == [False]  # the rest is none of its own kind
    assert outdone(found, [OF_RATES], TESTS, FILLS) == [True]


def test_a_right_name_beside_what_hangs_on_the_rates_is_said(
    hidden: Callable[..., Hidden],
) -> None:
    found = _named(hidden("eccentricity@pan:0.002", "scale_quadratic:0.003"), "eccentricity")
    assert outdone(found, [OF_RATES], TESTS, FILLS) == [False]
