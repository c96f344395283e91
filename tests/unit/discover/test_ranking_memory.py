"""A search ranks each model once, and its limit counts all the work."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover import ranking_memory, search_limits
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.cause_ranking import RankedCause, rank_causes
from gyrorig_solver.discover.extended_fit import extend_fit
from gyrorig_solver.discover.fitted_values import value_stds
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.ranking_memory import SAME_VALUE_SIGMA, RankingMemory, is_same_fit
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.search_limits import SearchLimits
from gyrorig_solver.discover.search_memory import SearchMemory
from gyrorig_solver.discover.testable_terms import testable_terms as list_testable_terms
from gyrorig_solver.estimate import ConvergedFit, likelihood_fit
from gyrorig_solver.estimate.trust_region import minimise
from gyrorig_solver.model import find_term

HIDDEN = "backlash@tilt:0.0015"


@pytest.fixture(scope="module")
def base(hidden: Callable[..., Any]) -> ConvergedFit:
    session = hidden(HIDDEN)
    return fit_base_model([session.recording], session.board)


@pytest.fixture(scope="module")
def model(base: ConvergedFit) -> MotionFitSpace:
    """Return the fit with the backlash, at its best place."""
    space = MotionFitSpace(base)
    projector = space.projector()
    best = fit_best_place(projector, scan_catalogue(projector, [find_term("backlash")], 1))
    assert best is not None
    return extend_fit(space, best[0].extension)


def _shifted(space: MotionFitSpace, sigmas: float) -> MotionFitSpace:
    """Return the same fit with the fitted value of its cause moved."""
    (cause,) = space.fitted_terms
    values = cause.values.copy()
    values[cause.free_indices] += sigmas * value_stds(space, 0)[cause.free_indices]
    return MotionFitSpace(replace(space.solution, fitted_terms=(replace(cause, values=values),)))


def test_a_model_that_comes_again_is_not_ranked_again(
    model: MotionFitSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranked: list[MotionFitSpace] = []

    def count(space: MotionFitSpace, *more: Any) -> tuple[RankedCause, ...]:
        ranked.append(space)
        return rank_causes(space, *more)

    monkeypatch.setattr(ranking_memory, "rank_causes", count)
    terms = list_testable_terms(model.projector())
    memory = RankingMemory[MotionFitSpace](terms, len(terms), lambda: True)

    def review(space: MotionFitSpace, considered: dict[str, set[str]]) -> Sequence[RankedCause]:
        return memory.review(space, considered, lambda _: True, lambda: True)[1]

    first = review(model, {})
    assert review(_shifted(model, 0.5 * SAME_VALUE_SIGMA), {}) is first
    assert ranked == [model]
    review(_shifted(model, 2.0 * SAME_VALUE_SIGMA), {})
    review(model, {"backlash": {"tilt_sag"}})
    assert len(ranked) == 3


def test_only_the_same_causes_at_the_same_values_are_one_model(
    base: ConvergedFit, model: MotionFitSpace
) -> None:
    assert is_same_fit(model, _shifted(model, 0.0))
    assert not is_same_fit(model, MotionFitSpace(base))
    (cause,) = model.fitted_terms
    fewer = replace(cause, free_indices=cause.free_indices[:0])
    held = MotionFitSpace(replace(model.solution, fitted_terms=(fewer,)))
    assert not is_same_fit(held, model)


def test_a_refit_counts_the_evaluations_of_all_its_rounds(
    base: ConvergedFit, model: MotionFitSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds = []

    def count(*arguments: Any, **options: Any) -> Any:
        rounds.append(minimise(*arguments, **options))
        return rounds[-1]

    monkeypatch.setattr(likelihood_fit, "minimise", count)
    space = MotionFitSpace(base)
    refitted = space.refit(model.fitted_terms)
    assert refitted.convergence.evaluations == rounds[-1].evaluations
    assert space.effort.evaluations == sum(end.evaluations + 1 for end in rounds)


def test_candidates_count_by_their_signals(base: ConvergedFit) -> None:
    space = MotionFitSpace(base)
    projector = space.projector()
    before = space.effort.signal_count.signals
    fit_best_place(projector, scan_catalogue(projector, [find_term("backlash")], 1))
    assert space.effort.signal_count.signals > before + 10


def test_a_long_recording_has_fewer_evaluations(
    base: ConvergedFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = MotionFitSpace(base)
    samples = sum(series.time_s.size for each in base.sessions for series in each.series)
    affordable = search_limits.MAX_SEARCH_SAMPLES // samples
    assert SearchLimits(space.effort).max_evaluations == affordable
    monkeypatch.setattr(search_limits, "MAX_SEARCH_SAMPLES", 3 * samples)
    limits = SearchLimits(space.effort)
    assert limits.max_evaluations == search_limits.MIN_SEARCH_EVALUATIONS
    monkeypatch.setattr(search_limits, "MIN_SEARCH_EVALUATIONS", 0)
    limits, memory = SearchLimits(space.effort), SearchMemory(space)
    assert limits.max_evaluations == 3
    space.effort.refit_evaluations += 3
    assert limits.are_reached(memory)
    assert limits.may_fit_laws()
    (remark,) = limits.remarks(memory, [], was_stopped=True)
    assert remark.endswith("are none, and other causes are possible")
    space.effort.refit_evaluations += 2
    assert not limits.may_fit_laws()
    (remark,) = limits.remarks(memory, ["backlash"], was_stopped=True)
    assert "limit of 3 evaluations" in remark
    assert remark.endswith("and not all alternatives to them were fitted")


def test_a_limit_in_the_final_ranking_is_not_the_end_of_a_search(
    base: ConvergedFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = MotionFitSpace(base)
    memory = SearchMemory(space)
    assert SearchLimits(space.effort).remarks(memory, ["backlash"], was_stopped=False) == ()
    monkeypatch.setattr(search_limits, "MAX_SEARCH_EVALUATIONS", 0)
    limits = SearchLimits(space.effort)
    (remark,) = limits.remarks(memory, ["backlash"], was_stopped=False)
    assert remark.startswith("the comparison of the causes with their alternatives stopped")
    assert remark.endswith("these causes were fitted: backlash")
