"""What causes are worth on data that was held out: each alone, and all together."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.support.board_fits import explain_recordings

from gyrorig_solver.discover import FitExplanation
from gyrorig_solver.discover.held_out_gain import cross_validate_causes
from gyrorig_solver.estimate import NuisanceProjector

pytestmark = pytest.mark.long

TWO = ("backlash@tilt:0.0012", "scale_quadratic:0.004")


@pytest.fixture(scope="module")
def two(hidden: Callable[..., Any]) -> FitExplanation:
    """A session with two causes, explained."""
    session = hidden(*TWO)
    return explain_recordings([session.recording], session.board)


def test_each_cause_has_its_own_gain(two: FitExplanation) -> None:
    findings = two.findings
    assert {cause.cause for cause in findings.causes} == {"backlash", "scale_quadratic"}
    assert findings.gain is not None
    for cause in findings.causes:
        assert cause.gain is not None
        assert cause.gain.log_likelihood.low > 0.0
        assert cause.gain.log_likelihood.value < findings.gain.log_likelihood.value
        # All else stays: after is after, for each.
        assert cause.gain.rms_after == findings.gain.rms_after
        assert cause.gain.rms_before < findings.gain.rms_before


def test_a_model_without_a_cause_is_that_of_a_fit_that_has_none(two: FitExplanation) -> None:
    """The space with a cause's rows struck out is the space made without it.

    Not to the last digit: other causes act on what the one that is gone had made.
    """
    solution = two.solution_extended
    whole = NuisanceProjector.at_fit(solution)
    windows = np.arange(whole.residual.size) // 997 % 5
    for k, fitted_term in enumerate(solution.fitted_terms):
        if not fitted_term.free_indices.size:
            continue
        others = [other for other in solution.fitted_terms if other is not fitted_term]
        apart = NuisanceProjector.at_fit(
            solution, followed_terms=others, restored_terms=[fitted_term]
        )
        (struck,) = whole.held_out_residuals(windows, [whole.drop_terms([k])])
        (made,) = apart.held_out_residuals(windows, [apart.drop_terms([])])
        assert struck == pytest.approx(made, abs=0.01 * float(np.abs(made).max()))


def test_no_cause_has_no_gain(two: FitExplanation) -> None:
    assert cross_validate_causes(NuisanceProjector.at_fit(two.solution_extended), []) is None
