"""Significance tests of a fit's residual: every cause of the catalogue, and smooth functions.

The tests say whether a fit leaves more than noise. They name nothing: the cause with the largest
score need not be the one that acts.

What to use when: `criticise_fit` for a fit to rates; `criticise_residual` where the reference
has no rate at each moment; `explain_fit` to search for the causes and to fit them.
"""

from dataclasses import dataclass

from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_search import FALSE_ALARM_RATE, count_tests, testable_terms
from gyrorig_solver.discover.checks.fit_residual import findings_from_fit
from gyrorig_solver.discover.checks.typical_noise import build_projector
from gyrorig_solver.discover.fit_explanation import DEPENDENCE_FALSE_ALARM_RATE, dependence_tests
from gyrorig_solver.discover.score_tests import CandidateScore, scan_catalogue
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.gyro_fit import GyroFit
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.model.recording_scope import term_label

LISTED_CAUSES = 3


@dataclass(frozen=True, slots=True, eq=False)
class FitCriticism:
    """The significant tests of a fit's residual, those with the smallest p-value first."""

    scores: tuple[CandidateScore, ...]  # of causes that are not in the fit
    dependences: tuple[DependenceTest, ...]
    test_count: int  # 0 where the reference allows no test

    @property
    def is_adequate(self) -> bool:
        """Whether the fit leaves nothing but noise."""
        return not self.scores and not self.dependences

    @property
    def leading_causes(self) -> tuple[str, ...]:
        """The ids of the causes with the smallest p-values, at most three."""
        causes = dict.fromkeys(score.term.cause for score in self.scores)
        return tuple(causes)[:LISTED_CAUSES]


def criticise_fit(solution: ConvergedFit) -> FitCriticism:
    """Test a fit's residual for every cause that the fit does not contain.

    Args:
        solution: with the contexts of its recordings.
    """
    projector = build_projector(solution)
    terms = testable_terms(projector)
    tests = count_tests(terms)
    fitted = {term_label(fitted_term.term) for fitted_term in solution.fitted_terms}
    scores = scan_catalogue(
        projector, [term for term in terms if term_label(term) not in fitted], tests
    )
    residual_tests = dependence_tests(solution, NuisanceProjector.at_fit(solution))
    return FitCriticism(
        tuple(score for score in scores if score.p_value < FALSE_ALARM_RATE),
        tuple(test for test in residual_tests if test.p_value < DEPENDENCE_FALSE_ALARM_RATE),
        tests + len(residual_tests),
    )


def criticise_residual(fit: GyroFit) -> FitCriticism:
    """Test a fit's residual where the reference has no rate at each moment."""
    findings = findings_from_fit(fit)
    unexplained, test_count = findings.unexplained, len(findings.dependence_tests)
    if unexplained is None:
        return FitCriticism((), (), test_count)
    return FitCriticism((), (unexplained.leading, *unexplained.others), test_count)
