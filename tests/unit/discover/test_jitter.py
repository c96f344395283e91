"""Jitter of the samples' instants is told from other scatter, with its size."""

from collections.abc import Callable

import pytest
from tests.support.board_fits import fit_base_model
from tests.unit.discover.conftest import HiddenRecording

from gyrorig_solver.discover import explain_fit
from gyrorig_solver.discover.checks.jitter_estimate import estimate_jitter
from gyrorig_solver.estimate import NuisanceProjector

ALPHA, TESTS = 0.005, 60


def _looked(hidden: HiddenRecording) -> NuisanceProjector:
    return NuisanceProjector.at_fit(fit_base_model([hidden.recording], hidden.board))


@pytest.fixture(scope="module")
def late(hidden: Callable[..., HiddenRecording]) -> HiddenRecording:
    return hidden("sample_jitter:1e-3", program="survey-40")


@pytest.mark.long
def test_its_size_is_found(late: HiddenRecording) -> None:
    jitter_result = estimate_jitter(_looked(late), TESTS)
    assert jitter_result is not None
    assert jitter_result.is_distinct
    assert abs(jitter_result.deviation_s - 1e-3) < 3.0 * jitter_result.std_s
    assert jitter_result.std_s < 5e-5
    assert jitter_result.remaining_trend.p_value > 0.003  # no scatter of another kind is left


def test_it_is_the_sole_name(late: HiddenRecording) -> None:
    explained = explain_fit(fit_base_model([late.recording], late.board), late.board).findings
    assert [cause.candidates for cause in explained.causes] == [("sample_jitter",)]
    assert explained.verdict == "explained"
    assert explained.fitted_terms == ()  # no fit can follow it


@pytest.mark.long
def test_there_is_none_where_nothing_is_hidden(hidden: Callable[..., HiddenRecording]) -> None:
    jitter_result = estimate_jitter(_looked(hidden(program="survey-40")), TESTS)
    assert jitter_result is not None
    assert jitter_result.p_value > ALPHA / TESTS
    assert jitter_result.detectable_s < 5e-4


@pytest.mark.long
def test_a_smooth_misfit_is_no_jitter(hidden: Callable[..., HiddenRecording]) -> None:
    jitter_result = estimate_jitter(_looked(hidden("s_curve:0.05", program="survey-40")), TESTS)
    assert jitter_result is not None
    assert not jitter_result.is_distinct
