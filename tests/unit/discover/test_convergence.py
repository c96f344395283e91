"""The search goes on without candidates whose fit does not converge; the best model is kept."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover import explain_fit, motion_space, search_limits
from gyrorig_solver.discover.cause_search import search_causes
from gyrorig_solver.discover.model_evidence import best_model
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.estimate import (
    ConvergedFit,
    Convergence,
    FittedTerm,
    confirm_fit,
    refit_with_terms,
)
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.likelihood_fit import CONFIRMED_NATS, CONFIRMED_SIGMA, LikelihoodFit

HIDDEN = "backlash@tilt:0.0015"
WITHOUT = Convergence(False, 40, 9.0, "backlash.gap.tilt", 2.0)


def _refit_without_backlash(
    previous: ConvergedFit, fitted_terms: Sequence[FittedTerm], *limits: int
) -> ConvergedFit:
    """Refit; a fit of backlash does not converge."""
    refitted = refit_with_terms(previous, fitted_terms, *limits)
    has_backlash = any(fitted_term.term.cause == "backlash" for fitted_term in fitted_terms)
    return replace(refitted, convergence=WITHOUT) if has_backlash else refitted


@pytest.fixture(scope="module")
def base(hidden: Callable[..., Any]) -> ConvergedFit:
    session = hidden(HIDDEN)
    return fit_base_model([session.recording], session.board)


@pytest.fixture(scope="module")
def named(base: ConvergedFit) -> ConvergedFit:
    return search_causes(MotionFitSpace(base)).space.solution


@pytest.mark.long
def test_the_cause_is_named_where_its_fit_converges(named: ConvergedFit) -> None:
    assert [fitted_term.term.cause for fitted_term in named.fitted_terms] == ["backlash"]
    assert named.converged


@pytest.mark.long
def test_a_candidate_whose_fit_does_not_converge_is_left_out(
    base: ConvergedFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_space, "refit_with_terms", _refit_without_backlash)
    explanation = explain_fit(base, "GY80-1")
    assert "backlash" not in [cause.term.cause for cause in explanation.findings.causes]
    assert explanation.solution_extended.converged
    assert any(
        text.startswith("the cause backlash was left out") and "backlash.gap.tilt" in text
        for text in explanation.remarks
    )


@pytest.mark.long
def test_a_search_stops_at_its_limit_and_says_so(
    base: ConvergedFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = MotionFitSpace(base)
    assert not any("limit" in text for text in search_causes(whole).remarks)
    assert 0 < whole.effort.evaluations < search_limits.MAX_SEARCH_EVALUATIONS / 10
    monkeypatch.setattr(search_limits, "MAX_SEARCH_EVALUATIONS", 1)
    limited = search_causes(MotionFitSpace(base))
    assert limited.space.convergence.converged
    (remark,) = (text for text in limited.remarks if "limit" in text)
    assert "stopped at its limit of 1 evaluations" in remark
    assert "the causes that it had found are backlash" in remark
    monkeypatch.setattr(search_limits, "MAX_SEARCH_EVALUATIONS", 0)
    (remark,) = search_causes(MotionFitSpace(base)).remarks
    assert "had found are none" in remark


@pytest.mark.long
def test_a_search_stops_when_too_many_fits_fail(
    base: ConvergedFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(motion_space, "refit_with_terms", _refit_without_backlash)
    whole = MotionFitSpace(base)
    assert not any("limit" in text for text in search_causes(whole).remarks)
    monkeypatch.setattr(search_limits, "MAX_FAILED_FITS", 1)
    limited = MotionFitSpace(base)
    (remark,) = (text for text in search_causes(limited).remarks if "limit" in text)
    assert "stopped at its limit of 1 fits without convergence" in remark
    assert limited.effort.evaluations < whole.effort.evaluations


@pytest.mark.long
def test_the_best_visited_model_is_the_answer(base: ConvergedFit, named: ConvergedFit) -> None:
    plain, better = MotionFitSpace(base), MotionFitSpace(named)
    assert best_model(plain, [plain, better]) is better
    assert best_model(better, [plain]) is better
    assert best_model(plain, [MotionFitSpace(replace(named, convergence=WITHOUT))]) is plain


def test_a_cause_of_no_effect_does_not_lead(base: ConvergedFit, named: ConvergedFit) -> None:
    backlash = named.fitted_terms[0]
    idle = replace(backlash, values=0.0 * backlash.values)
    same = replace(named, fitted_terms=(idle,), sessions=base.sessions, estimate=base.estimate)
    plain = MotionFitSpace(base)
    assert best_model(plain, [MotionFitSpace(same)]) is plain


def test_a_fit_that_is_not_at_its_optimum_is_continued(named: ConvergedFit) -> None:
    std = np.sqrt(np.diag(named.observability.covariance)[: named.estimate.size])
    shifted = replace(named, estimate=named.estimate + 2.0 * std)
    assert _next_nats(shifted) > 1.0
    confirmed = confirm_fit(shifted)
    assert confirmed.converged
    assert _next_nats(confirmed) < CONFIRMED_NATS
    assert np.abs((confirmed.estimate - named.estimate) / std).max() < CONFIRMED_SIGMA


def test_a_fit_that_did_not_converge_is_not_confirmed(named: ConvergedFit) -> None:
    assert not confirm_fit(replace(named, convergence=WITHOUT)).converged


def _next_nats(solution: ConvergedFit) -> float:
    """Return the predicted decrease of the next step, with new derivatives."""
    board = BoardFit.resumed(solution, solution.fitted_terms)
    return LikelihoodFit([board]).propose(0.0).predicted_decrease
