"""Significance tests of a fit's residual: every cause of the catalogue, and smooth functions.

The tests show whether a residual contains more than noise. They do not name a cause, because the
cause with the largest score may not be the cause that acts.

What to use when: `criticise_fit` for a fit to rates; `findings_without_rates` if the reference
does not give the rate at every time, so that no cause can be tested.
"""

import math
from dataclasses import dataclass

from gyrorig_solver.discover.cause_findings import CauseFindings, DependenceTest, UntestableCause
from gyrorig_solver.discover.checks.model_check import DEPENDENCE_FALSE_ALARM_RATE
from gyrorig_solver.discover.fit_space import FitSpace
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, CandidateScore, scan_catalogue
from gyrorig_solver.discover.testable_terms import count_tests, select_testable, terms_not_fitted
from gyrorig_solver.estimate import GyroFit, NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue

LISTED_CAUSES = 3


@dataclass(frozen=True, slots=True, eq=False)
class FitCriticism:
    """The significant tests of a fit's residual, those with the smallest p-value first."""

    scores: tuple[CandidateScore, ...] = ()  # of causes that are not in the fit
    dependences: tuple[DependenceTest, ...] = ()
    test_count: int = 0  # 0 if the reference allows no test

    @property
    def is_adequate(self) -> bool:
        """Whether the residual shows only noise."""
        return not self.scores and not self.dependences

    @property
    def leading_causes(self) -> tuple[str, ...]:
        """The ids of the causes with the smallest p-values, at most `LISTED_CAUSES`."""
        causes = dict.fromkeys(score.term.cause for score in self.scores)
        return tuple(causes)[:LISTED_CAUSES]


def criticise_fit(space: FitSpace) -> FitCriticism:
    """Test a fit's residual for every cause that the fit does not contain.

    Args:
        space: the fit, with the contexts of its recordings.
    """
    scores, tests = scan_other_causes(space, space.projector(typical=True))
    residual_tests = space.dependence_tests(space.projector())
    return FitCriticism(
        tuple(
            score
            for score in scores
            if score.p_value < FALSE_ALARM_RATE and not score.term.nameless_description
        ),
        tuple(test for test in residual_tests if test.p_value < DEPENDENCE_FALSE_ALARM_RATE),
        tests + len(residual_tests),
    )


def scan_other_causes(
    space: FitSpace, projector: NuisanceProjector
) -> tuple[list[CandidateScore], int]:
    """Return the scores of all causes that a fit does not contain, and the number of tests."""
    terms = select_testable(space.terms.values(), projector)
    others = terms_not_fitted(terms, space.labels)
    return scan_catalogue(projector, others, count_tests(terms)), count_tests(terms)


def findings_without_rates(fit: GyroFit) -> CauseFindings:
    """Return the findings of a fit that cannot be searched: no cause is testable.

    References of known turns, and of gravity between rests, give the total rotation of a motion,
    but not the rate at each time.
    """
    compared = fit.reference.partition(";")[0] or "a quantity of the board"
    why = (
        f"the reference ({compared}) does not give the rate at every time; record the board with "
        "reference attitudes"
    )
    return CauseFindings(
        verdict="adequate",
        causes=(),
        unexplained=None,
        dependence_tests=(),
        detection_limits=(),
        untestable=tuple(
            UntestableCause(term.cause, None, why)
            for term in catalogue().values()
            if term.kind in ("effect", "gauge", "stochastic")
            and not term.is_configuration_error
            and not term.is_of_unit
        ),
        base_terms=fit.terms,
        base_reduced_chi2=fit.reduced_chi2,
        base_whiteness_p=math.nan,
        gain=None,
        changes=(),
        duration_s=0.0,
    )
