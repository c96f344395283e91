"""Ramps that are not as steep as told, against what the emulated unit was made to do."""

from collections.abc import Callable
from typing import Any

import pytest

from gyrorig_solver.discover.cause_search import FALSE_ALARM_RATE
from gyrorig_solver.discover.checks.ramp_acceleration import detect_ramp_error
from gyrorig_solver.pipeline.prepare_board import fit_base_model

TESTS = 45


def test_ramps_that_are_not_as_told_have_a_name(hidden: Callable[..., Any]) -> None:
    session = hidden("acceleration_error@tilt:-0.01", seed=7)
    ramps = detect_ramp_error(
        fit_base_model([session.recording], session.board), TESTS, FALSE_ALARM_RATE
    )
    assert ramps.named is not None
    assert ramps.named.where == ("tilt",)
    tilt = ramps.named.values[1]
    assert tilt.value == pytest.approx(-0.01, abs=4.0 * tilt.std)
    assert tilt.std < 1e-3
    assert not ramps.named.extension.free_indices.size  # the base model has them: nothing to fit


def test_ramps_as_told_have_none_and_a_limit(hidden: Callable[..., Any]) -> None:
    session = hidden(seed=7)
    ramps = detect_ramp_error(
        fit_base_model([session.recording], session.board), TESTS, FALSE_ALARM_RATE
    )
    assert ramps.named is None
    assert [detection_limit.where for detection_limit in ramps.detection_limits] == ["pan", "tilt"]
    assert all(1e-5 < detection_limit.size < 1e-2 for detection_limit in ramps.detection_limits)
