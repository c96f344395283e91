"""Bounds that spare fits of candidates that change the motion law, against these fits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import fit_base_model

from gyrorig_solver.discover.cause_ranking import IRRELEVANT_SHARE, rank_against_alternatives
from gyrorig_solver.discover.cause_search import search_causes
from gyrorig_solver.discover.law_candidates import fit_law_cause, largest_evidence
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.testable_terms import count_tests, select_testable
from gyrorig_solver.model import find_term, term_label

TWO_CAUSES = ("acceleration_error@pan:0.01", "eccentricity@pan:0.002")
HIDDEN = (
    ("clock_skew:2e-4",),
    pytest.param(("backlash@tilt:0.0015",), marks=pytest.mark.long),
    ("s_curve:0.02",),
    pytest.param(TWO_CAUSES, marks=pytest.mark.long),
)
LAW_CAUSES = ("base_speed_jump", "acceleration_error", "s_curve")


@pytest.fixture(scope="module", params=HIDDEN, ids="+".join)
def base(request: pytest.FixtureRequest, hidden: Callable[..., Any]) -> MotionFitSpace:
    session = hidden(*request.param)
    return MotionFitSpace(fit_base_model([session.recording], session.board))


@pytest.mark.long
@pytest.mark.parametrize("cause", LAW_CAUSES)
def test_no_place_has_more_evidence_than_the_bound(base: MotionFitSpace, cause: str) -> None:
    term = find_term(cause)
    judged = fit_law_cause(base, term, needed_nats=np.inf)
    best = fit_law_cause(base, term)
    if best.candidate is None:
        assert judged.candidate is None
        return
    assert judged.candidate is not None
    bound = largest_evidence(judged.candidate, judged.space.outliers, 0.0)
    assert best.candidate.log_evidence <= bound


@pytest.mark.long
def test_a_law_that_is_not_fitted_is_no_rival(base: MotionFitSpace) -> None:
    result = search_causes(base)
    space = result.space
    terms = select_testable(base.terms.values(), result.projector)
    tests = count_tests(terms)
    for k, fitted_term in enumerate(space.fitted_terms):
        if not fitted_term.free_indices.size or space.changes_law(fitted_term.term):
            continue
        same_cause = [term for term in terms if term_label(term) == term_label(fitted_term.term)]
        candidates = [*same_cause, *(find_term(cause) for cause in LAW_CAUSES)]
        spared = rank_against_alternatives(space, k, candidates, tests, lambda _: False)
        fitted = rank_against_alternatives(space, k, candidates, tests)
        left_out = {c.extension.term.cause for c, _ in fitted.rivals} - {
            c.extension.term.cause for c, _ in spared.rivals
        }
        shares = [share for c, share in fitted.rivals if c.extension.term.cause in left_out]
        assert all(share < IRRELEVANT_SHARE for share in shares)
