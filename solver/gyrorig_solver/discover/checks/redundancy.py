"""Rejects the names that the rest of the residual makes redundant.

If a part of the residual is unexplained, a named cause may be a part of that unknown effect.

 * It is a part if the residual still depends strongly on a covariate of the cause.
 * The cause is added to the fit without it, together with a smooth function of the unexplained
   covariate, in both orders. It is rejected if it explains nothing after the function is fitted,
   and the function explains clearly more. A true cause next to another effect explains a part of
   the residual that the function does not explain.

Source: non-nested models, each tested with the other; Davidson and MacKinnon, Econometrica 49
(1981) 781.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.checks.smooth_alternatives import smooth_families
from gyrorig_solver.discover.checks.specification_tests import is_better_than_functions
from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, ScoreTest
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector, WhitenedSignals, join_signals
from gyrorig_solver.model import recording_index_of
from gyrorig_solver.numerics import chi2_upper_tail

MIN_EXPLAINED_SHARE = 0.8  # minimum share of the dependences that the names must explain


class RedundancyCheck:
    """Rejects the names that the rest of the residual makes redundant."""

    removes_names = True

    def judge(self, model: JudgedModel[Space]) -> Verdict:
        """Return the redundant causes."""
        unexplained = model.unexplained
        if unexplained is None or not model.result.ranked_causes:
            return Verdict()
        dependences = (unexplained.leading, *unexplained.others)
        removed = dominated_by_nonparametric(model, dependences)
        if unexplained.named_share < MIN_EXPLAINED_SHARE:
            partial = find_partial_explanations(model, dependences)
            removed = [a or b for a, b in zip(removed, partial, strict=True)]
        removed = [
            out and not is_better_than_functions(model, k, ranked)
            for out, (k, ranked) in zip(removed, model.fitted_causes, strict=True)
        ]
        return Verdict(tuple(removed), unexplained=unexplained)


def find_partial_explanations(
    model: JudgedModel[Space], dependences: Sequence[DependenceTest]
) -> list[bool]:
    """Return which causes explain only a part of a larger effect of the same covariate.

    An effect in another recording is not a part of the effect of a cause of one recording.

    Args:
        model: the model at the end of the search.
        dependences: significant residual dependences of its fit.
    """
    partial = []
    for ranked in model.result.ranked_causes:
        term = ranked.candidate.extension.term
        recording = recording_index_of(term)
        excesses = [
            test.excess
            for test in dependences
            if term.covariates is None or test.covariate in term.covariates
            if recording is None or test.recording_index in (None, recording)
        ]
        both = ranked.statistic + max(excesses, default=0.0)
        partial.append(ranked.statistic < MIN_EXPLAINED_SHARE * both)
    return partial


def dominated_by_nonparametric(
    model: JudgedModel[Space], dependences: Iterable[DependenceTest]
) -> list[bool]:
    """Return which causes are made redundant by a smooth function of an unexplained covariate.

    Args:
        model: the model at the end of the search.
        dependences: significant residual dependences of its fit.
    """
    projection = model.result.projector
    covariates = {test.covariate for test in dependences}
    families = [f for f in smooth_families(projection.states) if f.covariate in covariates]
    dominated: list[bool] = []
    for k, ranked in model.fitted_causes:
        if model.space.changes_law(model.space.fitted_terms[k].term):
            dominated.append(False)  # a function of the rates does not explain the replies
            continue
        projector = model.space.projector_without(k)
        alpha = FALSE_ALARM_RATE / (ranked.effective_trials * model.tests)
        extension = model.space.fitted_terms[k]
        # One family at a time, because the signals of all families take hundreds of megabytes.
        dominated.append(
            any(
                _is_dominated(projector, extension, family.whitened(projection), alpha)
                for family in families
            )
        )
    return dominated


def _is_dominated(
    projector: NuisanceProjector, extension: FittedTerm, whitened: WhitenedSignals, alpha: float
) -> bool:
    """Return whether a smooth function makes a cause redundant; `projector`: without the cause."""
    cause_signals = projector.term_derivatives(
        extension.term, extension.values, range(extension.values.size)
    )
    statistics = projector.score_statistics(join_signals([whitened, cause_signals]))
    function_test = ScoreTest.of(statistics.subset(np.arange(whitened.count)))
    cause_test = ScoreTest.of(
        statistics.subset(np.arange(whitened.count, whitened.count + cause_signals.count))
    )
    joint_test = ScoreTest.of(statistics)
    if cause_test.excess >= MIN_EXPLAINED_SHARE * function_test.excess:
        return False
    added_statistic = joint_test.statistic - function_test.statistic
    added_degrees = joint_test.degrees_of_freedom - function_test.degrees_of_freedom
    return added_degrees <= 0 or chi2_upper_tail(max(added_statistic, 0.0), added_degrees) > alpha
