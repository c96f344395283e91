"""Ramps that are not as steep as told, against what the emulated unit was made to do."""

from collections.abc import Callable
from typing import Any

import pytest

from gyrorig_solver.discover.ramps import look_for_ramps
from gyrorig_solver.discover.search import ALPHA
from gyrorig_solver.on_unit import unit_solution

TESTS = 45


def test_ramps_that_are_not_as_told_have_a_name(hidden: Callable[..., Any]) -> None:
    session = hidden("acceleration_error@tilt:-0.01", seed=7)
    found = look_for_ramps(unit_solution([session.recording], session.board), TESTS, ALPHA)
    assert found.named is not None
    assert found.named.where == ("tilt",)
    tilt = found.named.values[1]
    assert tilt.value == pytest.approx(-0.01, abs=4.0 * tilt.std)
    assert tilt.std < 1e-3
    assert not found.named.extension.free.size  # the base model has them: nothing to fit


def test_ramps_as_told_have_none_and_a_limit(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    found = look_for_ramps(unit_solution([session.recording], session.board), TESTS, ALPHA)
    assert found.named is None
    assert [one.where for one in found.absent] == ["pan", "tilt"]
    assert all(1e-5 < one.size < 1e-2 for one in found.absent)


def test_answers_are_believed_less_beside_another_law(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    reference: Any = unit_solution([session.recording], session.board).sessions[0].reference
    value, std = reference.log_acceleration
    doubted, wide = reference.by_own_law(True).log_acceleration
    assert doubted == pytest.approx(value)
    assert (wide > 5.0 * std).all()
    assert reference.by_own_law(False) is reference
