"""Jitter of the samples' instants is told from other scatter, with its size."""

from collections.abc import Callable

import pytest
from tests.unit.discover.conftest import Hidden

from gyrorig_solver.discover.finder import explain_fit
from gyrorig_solver.discover.jitter import find_jitter
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.on_unit import unit_solution

ALPHA, TESTS = 0.005, 60


def _looked(hidden: Hidden) -> Projection:
    return Projection.of(unit_solution([hidden.recording], hidden.board))


@pytest.fixture(scope="module")
def late(hidden: Callable[..., Hidden]) -> Hidden:
    return hidden("sample_jitter:1e-3", program="survey-40")


def test_its_size_is_found(late: Hidden) -> None:
    found = find_jitter(_looked(late), TESTS, ALPHA, 0.8)
    assert found is not None
    assert found.named
    assert abs(found.deviation_s - 1e-3) < 3.0 * found.std_s
    assert found.std_s < 5e-5
    assert found.beside.p_value > 0.003  # no scatter of another kind is left


def test_it_is_the_sole_name(late: Hidden) -> None:
    explained = explain_fit(unit_solution([late.recording], late.board), late.board).findings
    assert [one.candidates for one in explained.causes] == [("sample_jitter",)]
    assert explained.verdict == "explained"
    assert explained.extensions == ()  # no fit can follow it


def test_there_is_none_where_nothing_is_hidden(hidden: Callable[..., Hidden]) -> None:
    found = find_jitter(_looked(hidden(program="survey-40")), TESTS, ALPHA, 0.8)
    assert found is not None
    assert found.p_value > ALPHA / TESTS
    assert found.detectable_s < 5e-4


@pytest.mark.long
def test_a_smooth_misfit_is_no_jitter(hidden: Callable[..., Hidden]) -> None:
    found = find_jitter(_looked(hidden("s_curve:0.05", program="survey-40")), TESTS, ALPHA, 0.8)
    assert found is not None
    assert not found.named
