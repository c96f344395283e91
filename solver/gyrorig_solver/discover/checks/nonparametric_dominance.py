"""Rejects causes that a smooth function of an unexplained covariate makes redundant.

Where part of the residual is unexplained, a named cause may be a part of that effect, although it
does not depend on that covariate. Cause and smooth function are added to the fit without the
cause, in both orders. The cause is rejected if it explains nothing after the function is fitted,
and the function explains clearly more. A true cause next to another effect explains a part of the
residual that the function does not explain.

Source: non-nested models, each tested with the other; Davidson and MacKinnon, Econometrica 49
(1981) 781.
"""

from collections.abc import Iterable

import numpy as np

from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_search import FALSE_ALARM_RATE, SearchResult
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.discover.score_tests import ScoreTest
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.estimate.whitened_signals import WhitenedSignals, join_signals
from gyrorig_solver.numerics import chi2_upper_tail


def dominated_by_nonparametric(
    result: SearchResult, dependences: Iterable[DependenceTest], tests: int, min_share: float
) -> list[bool]:
    """Return which causes are made redundant by a smooth function of an unexplained covariate.

    Args:
        result: where the search ended.
        dependences: significant residual dependences of its fit.
        tests: how many share the false alarms.
        min_share: of what the free function explains that a name must explain.
    """
    covariates = {extension.covariate for extension in dependences}
    families_tested = [
        extension
        for extension in smooth_families(result.projector.states)
        if extension.covariate in covariates
    ]
    fitted = [
        extension for extension in result.solution.fitted_terms if extension.free_indices.size
    ]
    dominated = []
    for extension, ranked in zip(fitted, result.ranked_causes, strict=True):
        others = [other for other in result.solution.fitted_terms if other is not extension]
        projector = NuisanceProjector.at_fit(
            result.solution, followed_terms=others, restored_terms=[extension]
        )
        alpha = FALSE_ALARM_RATE / (ranked.effective_trials * tests)
        # One family at a time: the signals of all of them would be hundreds of megabytes.
        dominated.append(
            any(
                _is_dominated(
                    projector, extension, family.whitened(result.projector), alpha, min_share
                )
                for family in families_tested
            )
        )
    return dominated


def _is_dominated(
    projector: NuisanceProjector,
    extension: FittedTerm,
    whitened: WhitenedSignals,
    alpha: float,
    min_share: float,
) -> bool:
    """Return whether a smooth function makes a cause redundant, both added to a fit without it."""
    cause_signals = projector.term_derivatives(
        extension.term, extension.values, range(extension.values.size)
    )
    statistics = projector.score_statistics(join_signals([whitened, cause_signals]))
    function_test = ScoreTest.of(statistics.subset(np.arange(whitened.count)))
    cause_test = ScoreTest.of(
        statistics.subset(np.arange(whitened.count, whitened.count + cause_signals.count))
    )
    joint_test = ScoreTest.of(statistics)
    if _excess_statistic(cause_test) >= min_share * _excess_statistic(function_test):
        return False
    added_statistic = joint_test.statistic - function_test.statistic
    added_degrees = joint_test.degrees_of_freedom - function_test.degrees_of_freedom
    return added_degrees <= 0 or chi2_upper_tail(max(added_statistic, 0.0), added_degrees) > alpha


def _excess_statistic(test: ScoreTest) -> float:
    return test.statistic - test.degrees_of_freedom
